# SPDX-License-Identifier: Apache-2.0
"""Which effects that are missing go together, and how probable that is."""

from dataclasses import replace

import pytest

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.common_cause import going_together
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.words.motion_words import Said, causes_words


def cycle(name, body, period, u=5.0, p=0.99, law=0.9):
    """Return a cycle of a body with time, with a period and its u, s."""
    cause = Cause((), (body,), (('time',),), p, (((name,), law), ((), 1 - law)))
    return MissingEffect(name, Setting(period=period), cause=cause, parameters=(Parameter('period', period, u, 's'),))


PROBE = cycle('frame_cycle', 'frame', 600.0)
TABLE = cycle('axis_tilt_cycle', 'table axis tilting', 620.0, p=0.95, law=0.8)


def test_cycles_of_one_period_have_a_common_cause():
    """20 s apart, within four standard uncertainties of the difference, 28.3 s; its probability is the least one."""
    assert going_together([PROBE, TABLE]) == ((PROBE, TABLE),)
    words = causes_words([PROBE, TABLE], Said())
    assert '(95 %), most likely by one cause' in words and words.endswith('(80 %)')
    unsure = [replace(one, cause=replace(one.cause, variables=(('time', 'travel'),), laws=(((one.name,), 0.8),)))
              for one in (PROBE, TABLE)]
    assert ' the table axis tilts with time (table travel runs alike; 95 %), ' in causes_words(unsure, Said())


@pytest.mark.parametrize('other', [
    cycle('axis_tilt_cycle', 'table axis tilting', 630.0),
    cycle('frame_cycle', 'frame', 600.0),
    replace(TABLE, cause=replace(TABLE.cause, variables=(('temperature',),))),
    replace(TABLE, cause=replace(TABLE.cause, or_with=(('table angle',),))),
    replace(TABLE, cause=replace(TABLE.cause, law_certain=True)),
    replace(TABLE, name='axis_tilt_drift'), replace(TABLE, cause=None), replace(TABLE, parameters=())],
    ids=['another period', 'one body', 'another variable', 'or another variable', 'its law is known',
         'another course', 'nothing known', 'no period'])
def test_others_stand_alone(other):
    """In the order in which they are missing."""
    assert going_together([PROBE, other]) == ((PROBE,), (other,))

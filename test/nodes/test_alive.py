# SPDX-License-Identifier: Apache-2.0
"""Heartbeats as text: what a node says of itself and of whom it hears."""

from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time

from rosette_ros.nodes import names
from rosette_ros.nodes.alive import Beat, read_beat
from rosette_ros.nodes.company import Company


def beat_of(words, hears):
    """Return what a beat with such words says, read back."""
    said = []
    publisher = SimpleNamespace(publish=said.append)
    node = SimpleNamespace(get_name=lambda: 'recorder', create_publisher=lambda *_, **__: publisher,
                           now=lambda: SimpleNamespace(to_msg=Time))
    beat = Beat(node)
    beat.words, beat.hears = words, hears
    beat.beat_if_due(0.0)
    return read_beat(said[0].frame_id)


@pytest.mark.parametrize(('words', 'hears'), [
    ('', ()), ('no room', ()), ('', ('cmm 1a2b', 'a CMM, of its own')), ('two\nlines', ('cmm 1a2b',))])
def test_a_beat_says_what_it_was_given(words, hears):
    """Words are one line; whoever is heard may be called anything that a beat can say."""
    life, *said = beat_of(words, hears)
    assert life.startswith('recorder ')
    assert said == [' '.join(words.split()), hears]


@pytest.mark.parametrize(('text', 'wanted'), [
    ('', ('', '', ())), ('my CMM', ('my CMM', '', ())), ('my CMM\nis cold', ('my CMM', 'is cold', ()))])
def test_a_beat_may_say_less(text, wanted):
    """A real CMM needs to say no more than a name."""
    assert read_beat(text) == wanted


@pytest.mark.parametrize(('cmm', 'recorder', 'hears', 'has_gone', 'settled'), [
    ('cmm 2', 'recorder 1', ('cmm 2', 'evaluator 1'), False, True),
    ('cmm 2', 'recorder 1', ('cmm 1', 'evaluator 1'), False, False),
    ('cmm 2', 'recorder 1', (), False, False),
    ('', 'recorder 1', (), False, True),
    ('cmm 2', '', (), False, True),
    ('cmm 2', 'recorder 1', (), True, True),
])
def test_a_run_waits_until_the_recorder_hears_the_cmm(cmm, recorder, hears, has_gone, settled):
    """Where both beat: that of a process before does not count; who does not beat is not waited for."""
    company = Company.__new__(Company)
    company._complete_since = 0.0
    company._watches = {names.CMM: SimpleNamespace(life=cmm),
                        names.RECORDER: SimpleNamespace(life=recorder, hears=hears, has_gone=has_gone)}
    assert company.is_settled(10.0) == settled
    assert not company.is_settled(0.5)

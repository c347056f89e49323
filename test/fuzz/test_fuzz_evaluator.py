# SPDX-License-Identifier: Apache-2.0
"""Every field of every message and request that the evaluator takes."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from made_up import TRICKS, bounded, dumped, mutated, trees, tried
from made_up_log import BALLS, RUN_ID
from made_up_messages import TEXTS, messages
from mute import FIELDS, RUN_IDS, SAID, Mute, check_words, defaults, heard
from rclpy.serialization import serialize_message
from rosette_msgs.msg import Diagnosis, ErrorMotions, Run, RunState
from rosette_msgs.srv import AddEffect, Diagnose, RemoveEffect

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import answer_of, target_of
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.nodes import conversions
from rosette_ros.nodes.evaluation import ModelInUse
from rosette_ros.nodes.evaluator import WANTED as EVALUATOR_WANTED
from rosette_ros.nodes.evaluator import Evaluator
from rosette_ros.simulation import Machine, MachineConfig

pytestmark = pytest.mark.long

# The evaluator ------------------------------------------------------------------------------------


class MuteEvaluator(Mute, Evaluator):
    """An evaluator without a graph."""

    def __init__(self, measured=None):
        """Have received nothing; measured: a run that was evaluated before."""
        Mute.__init__(
            self,
            parameters=defaults(EVALUATOR_WANTED, diagnose_after_run=False),
            _in_use=ModelInUse(Model().with_effect('frame_drift') if measured else Model()),
            _answers=None,
            _due=('', 0),
            _level=0,
            _last='',
            _model_out=self,
            _motions_out=self,
        )
        if measured:
            self._in_use.evaluate(measured)

    @property
    def motions(self):
        """What was published of error motions."""
        return [one for one in self.published if isinstance(one, ErrorMotions)]

    def _diagnose(self, run_id=''):
        """Find the run; a diagnosis takes its time, and says nothing of the request."""
        self._in_use.run(run_id)
        return None, Diagnosis()


def run_of(said):
    """Return the Run message of a sequencer that has said and received this."""
    answers, frames = RunAnswers(RUN_ID), []
    for topic, message in said:
        if topic == 'probe_target':
            answers.add_target(target_of(message))
        elif topic == 'ball_centre':
            answers.add_answer(answer_of(message))
        else:
            frames += message.transforms
    return conversions.run_message(answers, frames, Time())


SENT = st.one_of(heard('probe_target', 'ball_centre', 'tf_static').map(run_of), messages(Run, **FIELDS))


@tried(0.08)
@given(SENT, heard('run_state'))
def test_what_the_evaluator_hears(run, states):
    """A run, and states of it."""
    node = MuteEvaluator()
    with bounded():
        for _, state in states:
            node._on_state(state)
            node._on_run(run)
        node.clock += 100
        node.health()
    check_words([*node.words, node._last])
    for message in node.motions:
        assert np.isfinite([getattr(message, curve) for curve in CURVES]).all()


def test_the_evaluator_evaluates_what_is_sound():
    """Else nothing that is accepted would ever be met."""
    node = MuteEvaluator()
    node._on_run(run_of((topic, message) for topic, message, _ in SAID
                        if topic in ('probe_target', 'ball_centre', 'tf_static')))
    node._on_state(RunState(run_id=RUN_ID, phase=RunState.PHASE_EVALUATION, done=18))
    assert [(one.balls, one.completeness) for one in node.motions] == [(BALLS, 1.0)]


# Questions to the evaluator -----------------------------------------------------------------------

MEASURED = Machine(MachineConfig().changed(plate={'balls': 5})).run(plan(5, 'random'), run_id=RUN_ID)
EFFECT_NAMES = st.one_of(
    st.sampled_from([*EFFECTS, 'table_motions', 'plate_deviations', 'cmm_deviations', 'mine', 'own']), TEXTS
)
ENTRY = trees(
    st.sampled_from(['name', 'own', 'tau', 'direction', 'expression', 'per', 'harmonic', 'axis', 'ball', 'k'])
)
DEFINITIONS = st.one_of(
    st.just(''),
    TRICKS,
    TEXTS,
    ENTRY.map(lambda tree: dumped(tree).decode('utf-8', 'replace')),
    st.builds(
        lambda text, per, direction, name: dumped(
            {'own': name, 'direction': direction, 'expression': text, 'per': per}
        ).decode(),
        st.one_of(
            st.sampled_from(
                [
                    't', 't*cos(3*alpha)', 'T', 'phi**2', '1/0*t', 'sqrt(-1-t)', 'exp(1e3*t)', 'alpha-alpha',
                    '9**9**9*t', '1e308*10*t', '0*t',
                ]
            ),
            st.text(max_size=20),
        ),
        st.sampled_from(['ball', 'run', 'table_position', 'x', '']),
        st.sampled_from(['axial', 'radial', 'x', 'z', '']),
        st.sampled_from(['mine', 'frame_drift', '', 'a b', 'a\nb']),
    ),
    mutated(b'{own: mine, direction: axial, expression: t*cos(3*alpha), per: ball}').map(
        lambda data: data.decode('utf-8', 'replace').replace('\0', '')
    ),
)


ASKED = MuteEvaluator(MEASURED)


@tried(0.08)
@given(
    st.one_of(
        messages(AddEffect.Request, effect=EFFECT_NAMES, definition=DEFINITIONS, run_id=RUN_IDS),
        messages(RemoveEffect.Request, effect=EFFECT_NAMES, run_id=RUN_IDS),
    )
)
def test_effects_that_are_added_and_removed(request):
    """Refused in one line, and the model is as it was; or the model has changed and its curves are numbers."""
    asked = MuteEvaluator(MEASURED)
    before = asked._in_use.model
    adds = isinstance(request, AddEffect.Request)
    with bounded(4.0):
        if adds:
            response = asked._on_add(request, AddEffect.Response())
        else:
            response = asked._on_remove(request, RemoveEffect.Response())
    serialize_message(response.after)
    check_words([*asked.words, response.message])
    if not response.success:
        assert asked._in_use.model is before
        assert response.message
        return
    assert asked._in_use.model.hash == response.after.hash != before.hash
    assert len(response.after.effects) + len(response.after.base) == len(before.terms) + len(before.base) + (
        1 if adds else -1
    )
    assert np.isfinite(response.error_motions.ctx).all()
    assert np.isfinite(response.error_motions.crz).all()


@tried(0.2)
@given(messages(Diagnose.Request, run_id=TEXTS))
def test_runs_that_are_asked_for(request):
    """A run that is not there is refused in one line, and the runs that are there are named."""
    ASKED.words.clear()
    with bounded():
        response = ASKED._on_diagnose(request, Diagnose.Response())
    assert response.success == (request.run_id in ('', RUN_ID))
    check_words([*ASKED.words, response.message])

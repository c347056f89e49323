# SPDX-License-Identifier: Apache-2.0
"""Every field of every message and request that the evaluator takes."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from made_up import TRICKS, bounded, dumped, mutated, trees, tried
from made_up_log import BALLS, RUN_ID
from made_up_messages import TEXTS, messages
from mute import FIELDS, RUN_IDS, SAID, Mute, check_words, defaults, heard
from rclpy.serialization import serialize_message
from rosette_msgs.msg import RunState
from rosette_msgs.srv import AddEffect, Diagnose, Recall, RemoveEffect

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model import Model
from rosette_ros.core.scheme import plan
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.nodes import convert
from rosette_ros.nodes.analyst import Analyst
from rosette_ros.nodes.evaluator import WANTED as EVALUATOR_WANTED
from rosette_ros.nodes.evaluator import Evaluator
from rosette_ros.nodes.gathering import Gathering
from rosette_ros.nodes.questions import Questions

# The evaluator ------------------------------------------------------------------------------------


class MuteEvaluator(Mute, Evaluator):
    """An evaluator without a graph."""

    def __init__(self):
        """Have heard nothing."""
        Mute.__init__(
            self,
            parameters=defaults(EVALUATOR_WANTED, diagnose_after_run=False),
            _analyst=Analyst(Model()),
            _gathering=Gathering(),
            _level=0,
            _last='',
            _complained=set(),
            _is_busy=False,
            _recalled={},
            reports=[],
            _recorder=SimpleNamespace(is_there=False, tick=lambda now: None),
        )
        self._results = SimpleNamespace(tell=self.reports.append)


@tried(0.08)
@given(heard('probe_target', 'ball_centre', 'run_state', 'tf_static'), messages(Recall.Response, **FIELDS))
def test_what_the_evaluator_hears(said, recalled):
    """Targets, answers, frames, states, and what is recalled of a run."""
    node = MuteEvaluator()
    handlers = {
        'probe_target': node._on_target,
        'ball_centre': node._on_answer,
        'run_state': node._on_state,
        'tf_static': node._on_frames,
    }
    with bounded():
        for topic, message in said:
            handlers[topic](message)
            node._evaluate_ready()
        node._on_recalled(recalled)
        node.wake()
        node.clock += 100
        node.wake()
        node.health()
    check_words([*node.words, node._last])
    for report in node.reports:
        assert np.isfinite(report.error_motions.values).all()
        serialize_message(convert.error_motions_message(report.run, report, node.now().to_msg(), 'table'))


def test_the_evaluator_evaluates_what_is_sound():
    """Else nothing that is accepted would ever be met."""
    node = MuteEvaluator()
    for topic, message, _ in SAID:
        if topic == 'probe_target':
            node._on_target(message)
        elif topic == 'ball_centre':
            node._on_answer(message)
        elif topic == 'tf_static':
            node._on_frames(message)
    node._on_state(RunState(run_id=RUN_ID, phase=RunState.PHASE_EVALUATION, done=18))
    node._evaluate_ready()
    assert [report.run.size for report in node.reports] == [BALLS**2]


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


def questions():
    """Return Questions without a graph, about one run, and the words that are logged."""
    made, node = object.__new__(Questions), Mute()
    made._node, made._analyst = node, Analyst(Model().with_effect('frame_drift'))
    made._analyst.evaluate(MEASURED)
    made._results = SimpleNamespace(
        tell=lambda report: convert.error_motions_message(report.run, report, node.now().to_msg(), 'table')
    )
    made.diagnose = lambda run_id='': None  # takes its time, and says nothing of the request
    return made, node


QUESTIONS = questions()


@tried(0.08)
@given(
    st.one_of(
        messages(AddEffect.Request, effect=EFFECT_NAMES, definition=DEFINITIONS, run_id=RUN_IDS),
        messages(RemoveEffect.Request, effect=EFFECT_NAMES, run_id=RUN_IDS),
    )
)
def test_effects_that_are_added_and_removed(request):
    """Refused in one line, and the model is as it was; or the model has changed and its curves are numbers."""
    asked, node = questions()
    before = asked._analyst.model
    adds = isinstance(request, AddEffect.Request)
    with bounded(4.0):
        if adds:
            response = asked._on_add(request, AddEffect.Response())
        else:
            response = asked._on_remove(request, RemoveEffect.Response())
    serialize_message(response.after)
    check_words([*node.words, response.message])
    if not response.success:
        assert asked._analyst.model is before
        assert response.message
        return
    assert asked._analyst.model.hash == response.after.hash != before.hash
    assert len(response.after.effects) + len(response.after.base) == len(before.terms) + len(before.base) + (
        1 if adds else -1
    )
    assert np.isfinite(response.error_motions.ctx).all()
    assert np.isfinite(response.error_motions.crz).all()


@tried(0.2)
@given(messages(Diagnose.Request, run_id=TEXTS))
def test_runs_that_are_asked_for(request):
    """A run that is not there is refused in one line, and the runs that are there are named."""
    asked, node = QUESTIONS
    node.words.clear()
    asked.diagnose = lambda run_id: asked._analyst.run(run_id) and Diagnose.Response().diagnosis
    with bounded():
        response = asked._on_diagnose(request, Diagnose.Response())
    assert response.success == (request.run_id in ('', RUN_ID))
    check_words([*node.words, response.message])

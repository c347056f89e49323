# SPDX-License-Identifier: Apache-2.0
"""Every field of every message, goal and recorded setting that the sequencer takes."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import TRICKS, WORDS, bounded, corpus, dumped, mutated, trees, tried
from made_up_log import BALLS, RADIUS, RUN_ID
from made_up_messages import TEXTS, changed, is_plain, messages
from mute import FIELDS, TAUGHT, Mute, check_words
from rclpy.time import Time
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, CalibrationEvent, ErrorMotions, ProbeTarget, RunState
from rosette_msgs.srv import Recall

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.calibration.goal import Job, Request, make_job
from rosette_ros.calibration.settings import (
    OPTIONS,
    PLANNED,
    PLATE,
    RUN,
    changed_settings,
    format_settings,
    goal_changes,
    limits_of,
    parse_settings,
    plan_of,
)
from rosette_ros.calibration.state_machine import Limits, Sequence
from rosette_ros.core.run.errors import RosetteError
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import Phase, answer_of
from rosette_ros.io.plan_file import MeasuringPlan, format_plan
from rosette_ros.nodes.run_control import RunControl
from rosette_ros.nodes.run_topics import RunTopics
from rosette_ros.nodes.sequencer import CALIBRATION, Sequencer

pytestmark = pytest.mark.long

# The sequencer ------------------------------------------------------------------------------------

PLAN = plan_calibration(plan(BALLS, 'diagonal'), RADIUS, TAUGHT, 2)


SETTINGS = {one.name: one.default for one in PLANNED} | {
    'plate.balls': BALLS,
    'plate.radius_m': RADIUS,
    'order': 'diagonal',
    'repeats': 2,
    'table.origin_m': (0.0, 0.0, 0.0),
}
VALUES = {one.name: one.default for one in CALIBRATION} | SETTINGS
ACTIVE = SimpleNamespace(is_activated=True)


class Parameters(dict):
    """The parameters of a node."""

    def values(self, wanted):
        """Return name to value for some of them."""
        return {one.name: self[one.name] for one in wanted}


class MuteSequencer(Mute, Sequencer):
    """A sequencer without a graph, in the middle of a run."""

    def __init__(self, sequence):
        """Have asked for the first target."""
        Mute.__init__(
            self,
            parameters=Parameters(VALUES, state_rate_hz=10.0, recorder_timeout_s=1.0, require_recorder=True),
            _taken=set(),
            _next_job=None,
            _active=ACTIVE,
        )
        self._topics = without_graph(
            RunTopics, _node=self, _targets=self, _frames=self, _states=self, _runs=self, _events=self)
        self._control = without_graph(
            RunControl,
            _node=self,
            _topics=self._topics,
            _on_end=lambda job, result: None,
            job=Job(sequence, Request('calibrate'), 'diagonal', opening=False),
            unfinished=None,
            _last='',
            _last_level=0,
            _published=0.0,
            recorder=SimpleNamespace(is_there=False),
            _cell=SimpleNamespace(busy=list, missing=lambda with_recorder: [], problems=lambda nodes: ''),
        )
        self._control._do(self._control.job, sequence.begin(0.0))

    def hear(self, answer):
        """Take an answer of the CMM."""
        self._control.answer(answer_of(answer))


def without_graph(kind, **attributes):
    """Return an object of a part of the node that makes nothing on the graph."""
    made = object.__new__(kind)
    made.__dict__.update(attributes)
    return made


@st.composite
def answers(draw, most=25):
    """Return what to do at each step: the right answer, or one of which fields are changed, or any."""
    return draw(
        st.lists(
            st.one_of(
                st.none(),
                st.none(),
                changed(BallCentre(), **FIELDS),
                messages(BallCentre, **FIELDS),
                st.sets(st.sampled_from([*BallCentre.get_fields_and_field_types()]), max_size=2).flatmap(
                    lambda names: st.tuples(st.just(names), messages(BallCentre, **FIELDS))
                ),
            ),
            max_size=most,
        )
    )


def right_answer(node):
    """Return the right answer to what was asked last."""
    target = next(one for one in reversed(node.published) if isinstance(one, ProbeTarget))
    answer = BallCentre(
        run_id=target.run_id,
        seq=target.seq,
        table_position=target.table_position,
        ball=target.ball,
        cmm_position=target.cmm_position,
        table_angle=target.table_angle,
        centre=target.centre,
    )
    answer.header.frame_id, answer.header.stamp = target.header.frame_id, target.header.stamp
    return answer


@tried(0.1)
@given(answers(), st.one_of(messages(ErrorMotions), messages(ErrorMotions, run_id=st.just(RUN_ID))))
def test_what_the_sequencer_hears(steps, motions):
    """Answers and error motions: what is asked can be sent, and what is not used has no consequence."""
    node = MuteSequencer(Sequence(RUN_ID, PLAN, Limits(attempts=3)))
    job = node._control.job
    with bounded():
        for step in steps:
            answer, done, stamp = right_answer(node), job.sequence.done, job.sequence._latest
            if isinstance(step, BallCentre):
                answer = step
            elif step is not None:
                for name in step[0]:
                    setattr(answer, name, getattr(step[1], name))
            node.hear(answer)
            if job.sequence.done > done:
                assert (answer.run_id, answer.status) == (RUN_ID, BallCentre.STATUS_OK)
                assert np.isfinite([answer.centre.x, answer.centre.y, answer.centre.z, answer.table_angle]).all()
            else:
                assert job.sequence._latest <= max(stamp, Time(seconds=100).nanoseconds)
        node._control.evaluated(motions)
        if node._control.job is not None:
            node.health()
    check_words([*node.words, node._control._last, job.sequence.text])
    for message in node.published:
        if isinstance(message, RunState):
            assert is_plain(message.text)


SETTINGS_TEXT = format_settings(SETTINGS).encode()
NAMES = st.sampled_from([one.name for one in CALIBRATION])
SETTINGS_TEXTS = st.one_of(
    st.just(SETTINGS_TEXT.decode()),
    TEXTS,
    TRICKS,
    mutated(SETTINGS_TEXT).map(lambda data: data.decode('utf-8', 'replace').replace('\0', '')),
    trees(NAMES).map(lambda tree: dumped(tree).decode('utf-8', 'replace')),
    st.tuples(NAMES, trees(NAMES)).map(lambda pair: dumped({**_plain_settings(), pair[0]: pair[1]}).decode()),
    st.tuples(NAMES, TRICKS).map(lambda pair: f'{SETTINGS_TEXT.decode()}\n{pair[0]}: {pair[1]}'),
)


def _plain_settings():
    return {name: list(value) if isinstance(value, tuple) else value for name, value in SETTINGS.items()}


def check_settings(values, wanted):
    """Every value is one that its setting allows."""
    for one in wanted:
        if one.name in values:
            assert one.check(values[one.name], 'again') == values[one.name]


@tried(0.5)
@given(SETTINGS_TEXTS)
def test_settings_of_a_recorded_run(text):
    """What an event says that a run was planned with."""
    try:
        with bounded():
            values = parse_settings(text, 'here')
    except RosetteError as error:
        assert str(error).startswith('here')
        check_words([str(error)])
        return
    check_settings(values, PLANNED)
    if values['plate.balls'] <= 12:
        with bounded():
            assert plan_of(values).total >= 9


OPTION_NAMES = st.sampled_from([*(one.name for one in OPTIONS), 'plate.balls', 'order'])
OPTION_TEXTS = st.one_of(
    TEXTS,
    TRICKS,
    st.just(''),
    trees(OPTION_NAMES).map(lambda tree: dumped(tree).decode('utf-8', 'replace')),
    st.builds('{}: {}'.format, OPTION_NAMES, st.one_of(WORDS, TRICKS)),
    st.dictionaries(
        OPTION_NAMES, st.one_of(st.integers(0, 5), st.floats(), st.booleans(), st.just('forward')), max_size=3
    ).map(lambda tree: dumped(tree).decode()),
)


PLANS = mutated(format_plan(MeasuringPlan(plan(3), 0.1)).encode()).map(lambda data: data.decode(errors='replace'))


@tried(0.4)
@given(
    messages(
        Calibrate.Goal,
        order=st.one_of(st.sampled_from(['', 'row', 'random', 'sensitive']), TEXTS),
        options=OPTION_TEXTS,
        plan=st.one_of(st.just(''), PLANS),
    )
)
def test_goals(goal):
    """What a goal asks for: every value allowed, or refused in one line."""
    try:
        with bounded():
            changes = goal_changes(Request.of_goal('calibrate', goal).goal)
    except RosetteError as error:
        check_words([str(error)])
        assert len(str(error)) < 2000
        return
    check_settings(changes, PLATE + RUN + OPTIONS)
    try:
        values = changed_settings(VALUES, changes)
    except RosetteError as error:  # a plan that is none
        check_words([str(error)])
        return
    if values['repeats'] <= 100 and values['plate.balls'] <= 12:
        with bounded():
            assert plan_of(values).total >= 9
            limits_of(values)


@pytest.mark.parametrize('text', [data.decode() for data in (*corpus('options'), *corpus('settings'))])
def test_settings_and_options_of_the_corpus(text):
    """What once caused a failure."""
    for read in (lambda: goal_changes({'options': text}), lambda: parse_settings(text, 'here')):
        with pytest.raises(RosetteError) as error, bounded():
            read()
        check_words([str(error.value)])


def recalled_calibration():
    """Return what a recorder recalls of the sound calibration."""
    response = Recall.Response(success=True, run_id=RUN_ID, log=RUN_ID)
    sequence = Sequence(RUN_ID, plan_of(VALUES), Limits())
    node = MuteSequencer(sequence)
    while sequence.phase is not Phase.EVALUATION:
        answer = right_answer(node)
        response.answers.append(answer)
        node.hear(answer)
    response.targets = [one for one in node.published if isinstance(one, ProbeTarget)]
    response.events = [CalibrationEvent(run_id=RUN_ID, kind=2, settings=SETTINGS_TEXT.decode())]
    return response


RECALLED = recalled_calibration()


@st.composite
def recalls(draw):
    """Return a recalled calibration in which messages are changed, left out, added."""
    made = Recall.Response(
        success=draw(st.integers(0, 9)) > 0,
        run_id=draw(st.one_of(st.just(RUN_ID), TEXTS)),
        message=draw(TEXTS),
        log=draw(TEXTS),
    )
    for name in ('targets', 'answers', 'events'):
        kept = list(getattr(RECALLED, name))
        kept = kept[: draw(st.integers(0, len(kept)))] if draw(st.booleans()) else kept
        for _ in range(draw(st.integers(0, 2))):
            fields = {**FIELDS, 'settings': SETTINGS_TEXTS}
            at = draw(st.integers(0, len(kept)))
            source = getattr(RECALLED, name)[0]
            kept[at : at + draw(st.integers(0, 1))] = [
                draw(changed(kept[min(at, len(kept) - 1)] if kept else source, **fields))
            ]
        setattr(made, name, kept)
    return made


@tried(0.12)
@given(recalls(), OPTION_TEXTS)
def test_what_is_recalled_of_a_run(recalled, options):
    """Gone on with, or refused in one line: what contradicts the plan is not measured on."""
    node = MuteSequencer(Sequence(RUN_ID, PLAN, Limits()))
    node._control.job = None
    with bounded():
        accepted, words = node._prepare(Request('calibrate', {'options': options}), recalled)
    check_words([*node.words, '' if accepted else words])
    if not accepted:
        return
    sequence = node._next_job.sequence
    assert recalled.success
    if sequence.plan.total > 2000:
        return
    node = MuteSequencer(sequence)
    with bounded():
        for _ in range(3):
            if node._control.job is not None and sequence.phase is not Phase.EVALUATION:
                node.hear(right_answer(node))
    check_words([*node.words, sequence.text])
    for target, answer in sequence.answers.counting():
        assert 1 <= target.seq <= sequence.plan.total
        assert np.isfinite(answer.centre).all()


def test_a_sound_recall_is_gone_on_with():
    """Else nothing that is accepted would ever be met."""
    job = make_job(Request('calibrate'), VALUES, (), RECALLED)
    assert job.sequence.answers.answered == PLAN.total

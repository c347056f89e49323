# SPDX-License-Identifier: Apache-2.0
"""A CMM is tried before a calibration: what its node does wrong is named, over DDS."""

import json
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosette_msgs.msg import BallCentre, ProbeTarget, RunState, Touches
from std_srvs.srv import Trigger

from rosette_ros.calibration.settings import LIMITS, PLANNED
from rosette_ros.cell import cmm_check
from rosette_ros.cell.cmm_check import CmmClient
from rosette_ros.cli.main import main
from rosette_ros.core.run.errors import CellError
from rosette_ros.nodes import names, qos

pytestmark = pytest.mark.long

BALLS, TURN = 6, 2 * np.pi
DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass
class Cmm:
    """A CMM in a thread of the test; wrong: changes every answer before it is published."""

    domain: int
    wrong: object = lambda answer, target: answer
    copies: int = 1
    points: object = None  # of a target: the points that are touched, (Q, 3), m; None: none are published
    travel: float = 0.0
    sense: int = 0
    askers: int = 0  # most publishers of targets that it has seen
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def __enter__(self):
        self._context = Context()
        self._context.init(domain_id=self.domain)
        self.node = Node('cmm', namespace='/rosette', context=self._context)
        self._answers = self.node.create_publisher(BallCentre, 'ball_centre', 100)
        self._touched = self.node.create_publisher(Touches, 'touches', 100)
        self.node.create_subscription(ProbeTarget, 'probe_target', self._on_target, 10)
        self.states = self.node.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _spin(self):
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=0.05)
            self.askers = max(self.askers, self.node.count_publishers(names.PROBE_TARGET))

    def _on_target(self, target):
        if target.approach:
            self.sense = target.approach
            self.travel += self.sense * ((self.sense * (target.table_angle - self.travel)) % TURN)
        answer = BallCentre(
            run_id=target.run_id, seq=target.seq, table_position=target.table_position, ball=target.ball,
            cmm_position=target.cmm_position, table_angle=self.travel % TURN, table_travel=self.travel,
            approach=self.sense, form_error=1e-7, temperature=20.0)
        answer.header.stamp = self.node.get_clock().now().to_msg()
        answer.header.frame_id = 'machine'
        noise = self.rng.normal(0, 1e-7, 3) + 1e-5
        answer.centre.x, answer.centre.y, answer.centre.z = (
            float(value) for value in np.array([target.centre.x, target.centre.y, target.centre.z]) + noise)
        if self.points is not None:
            x, y, z = self.points([answer.centre.x, answer.centre.y, answer.centre.z]).T.tolist()
            self._touched.publish(Touches(run_id=target.run_id, seq=target.seq, x=x, y=y, z=z))
        for _ in range(self.copies):
            self._answers.publish(self.wrong(answer, target))


@pytest.fixture(scope='module')
def cmm(module_domain_id):
    """Yield a CMM that makes no mistake unless a test makes it."""
    with Cmm(module_domain_id) as running:
        yield running


@pytest.fixture(autouse=True)
def no_long_search(request, monkeypatch):
    """Search no sequencer where there is none, but in the test of that search."""
    if 'late_sequencer' not in request.fixturenames:
        monkeypatch.setattr(cmm_check, 'SEQUENCER_SEARCH', 0.1)


@pytest.fixture
def late_sequencer(domain_id):
    """Yield the parameters of a sequencer that is on the graph 1.5 s after it was asked for."""
    context, values = Context(), {**{one.name: one.default for one in (*PLANNED, *LIMITS)}, 'plate.balls': BALLS,
                                  'table.origin_m': [0.1, 0.2, -0.3]}
    context.init(domain_id=domain_id)
    over = threading.Event()

    def live():
        time.sleep(1.5)
        node = Node('sequencer', namespace='/rosette', context=context)
        for name, value in values.items():
            node.declare_parameter(name, value)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        while not over.is_set():
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
        node.destroy_node()

    thread = threading.Thread(target=live)
    thread.start()
    yield values
    over.set()
    thread.join()
    context.try_shutdown()


@pytest.fixture
def check(cmm, module_domain_id):
    """Return a function that tries the CMM with a mistake and returns the report."""
    def run(wrong=None, copies=1, **given):
        cmm.wrong, cmm.copies = wrong or (lambda answer, target: answer), copies
        with CmmClient(module_domain_id) as client:
            return client.check(client.settings({'plate.balls': BALLS, **given}))
    yield run
    cmm.wrong, cmm.copies = lambda answer, target: answer, 1


def changed(**values):
    """Return a mistake: fields, dotted by two underscores, that become what a function of (answer, target) says."""
    def wrong(answer, target):
        for name, value in values.items():
            *path, last = name.split('__')
            owner = answer
            for part in path:
                owner = getattr(owner, part)
            setattr(owner, last, value(answer, target))
        return answer
    return wrong


def test_a_sound_cmm_passes_every_check(check):
    """Twelve balls; 5 readings of 0.1 µm tell the repeatability to a factor of two."""
    report = check()
    assert report.failed == ()
    texts = {one.name: one.text for one in report.checks}
    assert texts['answers'] == '12 of 12 as asked: ball, position, angle, place, units'
    assert texts['one CMM'] == 'ball_centre is published by 1, probe_target subscribed to by 1'
    assert set(texts) >= {'types', 'frame', 'stamps', 'travel', 'approach', 'places', 'resolution', 'clock',
                          'temperature', 'form error', 'status', 'quality of service', 'one answer'}
    assert 0.5e-7 < report.repeatability < 2e-7
    assert report.run_seconds == pytest.approx(report.seconds_per_ball * (10 + 2 * BALLS + BALLS**2 + 1))


@pytest.mark.parametrize('failed, words, mistake', [
    ('stamps', 'header.stamp is 0 in 12 of 12', changed(header__stamp__sec=lambda *_: 0,
                                                        header__stamp__nanosec=lambda *_: 0)),
    ('clock', 'header.stamp is +3', changed(header__stamp__sec=lambda answer, _: answer.header.stamp.sec + 3900)),
    ('travel', 'is not cumulative: it jumps by whole turns in 2 of 6', changed(
        table_travel=lambda answer, _: answer.table_travel % TURN)),
    ('approach', 'approach is always 0 after 6 of 6', changed(approach=lambda *_: 0)),
    ('places', '12 of 12 answers are exactly the place', changed(centre=lambda _, target: target.centre)),
    ('answers', 'that is degrees, give radians', changed(
        table_angle=lambda answer, _: float(np.rad2deg(answer.table_angle)))),
    ('answers', 'these are millimetres, give metres', changed(
        centre__x=lambda answer, _: 1e3 * answer.centre.x, centre__y=lambda answer, _: 1e3 * answer.centre.y,
        centre__z=lambda answer, _: 1e3 * answer.centre.z)),
    ('answers', "expected frame_id 'machine' or 'table', found 'base_link'", changed(
        header__frame_id=lambda *_: 'base_link')),
    ('resolution', 'readings are rounded to 10 µm; give every digit that the CMM has', changed(
        centre__x=lambda answer, _: round(answer.centre.x, 6), centre__y=lambda answer, _: round(answer.centre.y, 6),
        centre__z=lambda answer, _: round(answer.centre.z, 6))),
    ('form error', '100 to 100 µm', changed(form_error=lambda *_: 1e-4)),
    ('temperature', '293.15 to 293.15 °C; is it in °F or K?', changed(temperature=lambda *_: 293.15)),
    ('temperature', 'the temperature is 0 °C in ', changed(temperature=lambda *_: 0.0)),
])
def test_a_mistake_fails_its_check(check, failed, words, mistake):
    """In words that say what is wrong."""
    report = check(mistake)
    assert failed in report.failed
    assert words in next(one.text for one in report.checks if one.name == failed)


@pytest.mark.parametrize(('points', 'passed', 'words'), [
    (lambda centre: centre + 0.01 * DIRECTIONS, True, '6 a ball, spheres of radius 10.0000 to 10.0000 mm, centres '),
    (lambda centre: centre + 0.01 * DIRECTIONS + 1e-5, False, 'centres 17 µm from the answers; expected at most 1 µm'),
    (lambda centre: (centre + 0.01 * DIRECTIONS)[:3], False, 'less than 4 for 12 of 12 answers'),
    (lambda centre: np.tile(centre, (6, 1)), False, 'they lie on no sphere'),
])
def test_touches_are_those_of_the_answers(cmm, check, points, passed, words):
    """The spheres through them have the centres that were answered."""
    cmm.points = points
    try:
        report = check()
    finally:
        cmm.points = None
    [found] = [one for one in report.checks if one.name == 'touches']
    assert found.passed is passed
    assert words in found.text


def test_a_recovery_needs_no_sequencer(module_domain_id, cmm, monkeypatch):
    """Its answer is waited for, longer than a sequencer may be away: nothing else has to be there."""
    monkeypatch.setattr('rosette_ros.cell.client._DISCONNECTED', 0.1)
    answers = [Trigger.Response(success=True, message='the machine is ready'),
               Trigger.Response(success=False, message='expected a homed machine')]

    def late(request, response):
        time.sleep(0.5)
        return answers.pop(0)

    service = cmm.node.create_service(Trigger, names.RECOVER, late)
    try:
        with CmmClient(module_domain_id) as client:
            assert client.recover() == 'the machine is ready'
        with CmmClient(module_domain_id) as client, pytest.raises(CellError, match='expected a homed machine'):
            client.recover()
    finally:
        cmm.node.destroy_service(service)


def test_answers_that_come_twice(check):
    """Every target is answered by two messages."""
    report = check(copies=2)
    assert report.failed == ('one answer',)


def test_one_who_only_listens_is_no_cmm(check, module_domain_id):
    """The studio, a recorder of topics: they listen to targets, old ones included, and answer none."""
    context = Context()
    context.init(domain_id=module_domain_id)
    observer = Node('studio_1', namespace='/rosette', context=context)
    try:
        observer.create_subscription(ProbeTarget, 'probe_target', print, qos.COLLECT_LATCHED)
        assert check().failed == ()
    finally:
        observer.destroy_node()
        context.try_shutdown()


def test_an_answer_without_run_id_is_no_answer(check):
    """The first target ends it, after its time."""
    report = check(changed(run_id=lambda *_: ''), **{'limits.answer_timeout_s': 0.5})
    assert report.failed == ('answers',)
    text = next(one.text for one in report.checks if one.name == 'answers')
    assert "no answer within 0.5 s, but answers to run '': repeat run_id and seq" in text


def test_two_cmms_are_told(cmm, module_domain_id):
    """A second one with the same name, as soon as DDS has found it."""
    with Cmm(module_domain_id), CmmClient(module_domain_id) as client:
        assert client._spin_until(lambda: client._node.count_publishers(names.BALL_CENTRE) == 2, 60.0)
        report = client.check(client.settings({'plate.balls': BALLS}))
    assert 'one CMM' in report.failed  # and 'one answer', where it was found before it was asked


def test_the_verb_prints_ticks_and_json(cmm, module_domain_id, capsys):
    """Exit 0, and 2 with one line where a check fails; the table and the object are printed in both cases."""
    verb = ['check-cmm', '--balls', str(BALLS), '--domain', str(module_domain_id)]
    assert main(verb) == 0
    out = capsys.readouterr().out
    assert '✓  travel' in out and '–  status' in out and 'a calibration about' in out
    assert (f'{BALLS} balls, R = 182.5 mm, centre of the plate at 350 260 −300 mm; what was not given is by default.'
            in ' '.join(out.split()))
    cmm.wrong = changed(approach=lambda *_: 0)
    assert main([*verb, '--json']) == 2
    captured = capsys.readouterr()
    cmm.wrong = lambda answer, target: answer
    found = json.loads(captured.out)
    assert found['schema'] == 'rosette-cmm-check/1' and not found['passed']
    assert [one['name'] for one in found['checks'] if one['passed'] is False] == ['approach']
    assert captured.err.startswith('No sequencer was found. What was not given is by default: 6 balls, R = 182.5 mm, ')
    assert captured.err.endswith(f'\nrosette: check-cmm: 1 of {len(found["checks"])} checks are not passed: approach '
                            '(docs/real-cmm.md)\n')


def test_plate_and_table_are_those_of_a_sequencer_that_is_found_late(domain_id, late_sequencer):
    """On a busy computer DDS takes seconds to find it: the machine was sent to the default place."""
    with Cmm(domain_id), CmmClient(domain_id) as client:
        found = client.settings({})
        assert client.has_sequencer
        assert found['plate.balls'] == BALLS and list(found['table.origin_m']) == late_sequencer['table.origin_m']


def test_nothing_moves_where_no_answer_can_come(domain_id):
    """Answers that are published best effort do not reach a sequencer."""
    with Cmm(domain_id) as cmm, CmmClient(domain_id) as client:
        cmm.node.create_publisher(BallCentre, 'ball_centre', qos_profile_sensor_data)
        report = client.check(client.settings({}))
    assert 'quality of service' in report.failed and report.seconds_per_ball is None
    assert cmm.travel == 0


def test_nothing_moves_while_a_calibration_is_on(cmm, check):
    """The machine belongs to the sequencer then, whose run does not wait for us."""
    cmm.states.publish(RunState(run_id='run_a', process='sequencer 1', phase=RunState.PHASE_RUN))
    deadline = time.monotonic() + 60
    while cmm.node.count_publishers(names.PROBE_TARGET) and time.monotonic() < deadline:
        time.sleep(0.05)  # that of the test before
    cmm.askers = 0
    with pytest.raises(CellError, match='run run_a is running; wait for its end or cancel it'):
        check()
    assert cmm.askers == 0
    cmm.states.publish(RunState(run_id='run_a', process='sequencer 1', phase=RunState.PHASE_DONE))


def test_no_cmm_is_told(domain_id):
    """After some seconds, in words."""
    with CmmClient(domain_id) as client, pytest.raises(CellError, match='no CMM: expected one that subscribes to'):
        client.check(client.settings({}))

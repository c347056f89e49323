# SPDX-License-Identifier: Apache-2.0
"""A program that has every topic and every service of a cell: nothing of it counts, and two of a kind are said."""

import re
import time

import numpy as np
import pytest
from rclpy.action import ActionServer
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, JointEvaluation
from rosette_msgs.srv import (
    CheckPlan,
    EvaluateJointly,
    NextReadings,
    Recall,
    Recorded,
    StartRecording,
    StopRecording,
)

from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import names, qos

pytestmark = pytest.mark.long

N = 4
FORGED = {
    names.START_RECORDING: (StartRecording, {'log': '/tmp/forged'}),
    names.STOP_RECORDING: (StopRecording, {'log': '/tmp/forged'}),
    names.RECORDED: (Recorded, {}),
    names.RECALL: (Recall, {}),
    names.NEXT_READINGS: (NextReadings, {'settled': True, 'text': 'settled by a stranger'}),
    names.EVALUATE_JOINTLY: (EvaluateJointly, {'message': 'perfect'}),
    names.CHECK_PLAN: (CheckPlan, {})}
UNTIL = {'until_probability': 0.95, 'until_uncertainty': 1e-9, 'most_readings': 4}
WAIT = 'limits.return_timeout_s: 60.0'


def test_every_service_of_a_run_is_tried():
    """Those that the sequencer asks."""
    assert {*FORGED} == {*names.SERVERS}


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell without noise that answers slowly enough to be disturbed."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('strangers'), N, silent=True,
                   groups={'table': {'positioning_urad': 0.0}}, params={'cmm': {'answer_s': 0.15}}) as made:
        yield made


@pytest.fixture
def client(cell, module_domain_id):
    """Yield a client of the cell."""
    with CellClient(module_domain_id) as made:
        yield made


@pytest.fixture(scope='module')
def undisturbed(cell, module_domain_id):
    """Return the outcome of a run in which nobody else was there."""
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(check=cell.check, **UNTIL)
    assert outcome.success, outcome.message
    return outcome


@pytest.fixture
def stranger(cell, module_domain_id, make_peer):
    """Yield a node in another namespace, without a status."""
    made = make_peer(module_domain_id, namespace='/elsewhere', name='stranger')
    made.start()
    yield made
    made.stop()


class Servers:
    """Offers services of the cell and says to every request that all is well."""

    def __init__(self, peer, *services):
        """Offer them; asked: the names of those that were asked."""
        self._node, self.asked, self._made = peer.node, [], []
        for name in services:
            kind, fields = FORGED[name]
            self._made.append(self._node.create_service(kind, f'/rosette/{name}', self._answer(name, kind, fields)))

    def _answer(self, name, kind, fields):
        def answer(request, response):
            self.asked.append(name)
            return kind.Response(success=True, **fields)
        return answer

    def leave(self):
        """Offer nothing more."""
        for one in self._made:
            self._node.destroy_service(one)
        self._made.clear()


def run_with(client, cell, join, leave=lambda told: None, **goal):
    """Calibrate; join in the middle; leave is called until the end, with what was told. Returns the Outcome."""
    told, joined = [], []

    def look(progress=None):
        if progress is not None:
            told.append(progress)
            if progress.done >= 4 and not joined:
                joined.append(progress.run_id)
                join(progress.run_id)
        if joined:
            leave(told)

    outcome = client.calibrate(on_progress=look, check=lambda: (cell.check(), look()), options=WAIT, **goal)
    assert joined
    return outcome


def same_curves(outcome, other):
    """Return whether two outcomes have the same curves, bit for bit."""
    return np.array_equal(outcome.error_motions.values, other.error_motions.values)


@pytest.mark.parametrize('service', [*FORGED])
def test_two_servers_of_a_service_are_refused_before_a_run(cell, client, stranger, wait_until, service):
    """In words that name both."""
    sequencer = cell.processes[names.SEQUENCER]
    said = len(sequencer.text())
    servers = Servers(stranger, service)
    wait_until(lambda: f'2 nodes offer /rosette/{service}' in sequencer.text()[said:])
    with pytest.raises(CellError, match=f'calibration refused: 2 nodes offer /rosette/{service} '
                       rf'\(/elsewhere/stranger and /rosette/{names.SERVERS[service]}\): expected one'):
        client.calibrate()
    assert servers.asked == []
    servers.leave()
    wait_until(lambda: names.COMPLETE in sequencer.text()[said:])


def test_nothing_is_asked_of_two_servers_during_a_run(cell, client, stranger, undisturbed):
    """A run ended with "settled by a stranger": it waits until one is left, and ends as if nothing had been."""
    servers, sequencer = [], cell.processes[names.SEQUENCER]
    begin = []

    def leave(told):
        if any('asking the evaluator' in one.text for one in told) and not begin:
            begin.append(time.monotonic())
        if begin and time.monotonic() - begin[0] > 2.0:  # the real one would have answered
            servers[0].leave()

    said = len(sequencer.text())
    outcome = run_with(client, cell, lambda _: servers.append(Servers(stranger, *FORGED)), leave, **UNTIL)
    assert '2 nodes offer /rosette/evaluator/next_readings' in sequencer.text()[said:]
    assert servers[0].asked == []
    assert outcome.success and outcome.message == undisturbed.message
    assert same_curves(outcome, undisturbed) and read_log(outcome.log).states[-1].phase == Phase.DONE


def test_a_second_evaluator_service_that_stays_ends_the_question(cell, client, stranger, undisturbed):
    """The results that were published are kept, and it is said why it is not settled."""
    options = f'{WAIT}\nlimits.evaluation_timeout_s: 3.0\nlimits.attempts: 1'
    servers = []

    def join(progress):
        if progress.done >= 4 and not servers:
            servers.append(Servers(stranger, names.NEXT_READINGS))

    outcome = client.calibrate(on_progress=join, check=cell.check, options=options, **UNTIL)
    servers[0].leave()
    assert outcome.success and servers[0].asked == []
    assert re.search(', not settled: the evaluator did not answer within 3 s .*: 2 nodes offer '
                     '/rosette/evaluator/next_readings ', outcome.message), outcome.message
    assert read_log(outcome.log).states[-1].phase == Phase.DONE


def test_what_a_stranger_requests_of_the_recorder_changes_no_run(cell, client, stranger, undisturbed, wait_until):
    """Closed by a request that was repeated, the log lost the rest of the run; a log of its own stopped the next."""
    clients = {kind: stranger.node.create_client(kind, f'/rosette/{name}') for name, (kind, _) in FORGED.items()}
    wait_until(lambda: all(one.service_is_ready() for one in clients.values()), 30)
    answers = []

    def ask(told):
        """Ask three times, and wait for the answers: they come while the run is measured."""
        if len(answers) >= 3 * len(clients):
            return
        run_id = told[-1].run_id
        futures = [clients[kind].call_async(kind.Request(**fields)) for kind, fields in (
            (StartRecording, {'run_id': 'other'}), (StopRecording, {'run_id': run_id}),
            (Recorded, {'run_id': run_id}), (Recall, {'run': run_id}))]
        wait_until(lambda: all(one.done() for one in futures), 30)
        answers.extend(one.result() for one in futures)

    outcome = run_with(client, cell, lambda _: None, ask, **UNTIL)
    assert outcome.success and outcome.message == undisturbed.message
    assert outcome.log.name == outcome.run_id and same_curves(outcome, undisturbed)
    refused = {one.message for one in answers if isinstance(one, StopRecording.Response)}
    assert f'close the log of run {outcome.run_id}: expected the end of the run, found that it is measured' in refused
    assert not [one for one in answers if isinstance(one, (StartRecording.Response, StopRecording.Response))
                and one.success]


def test_a_log_that_a_stranger_opens_does_not_stop_a_run(cell, client, stranger, undisturbed, wait_until):
    """It is closed as it is when a run begins."""
    opened = stranger.node.create_client(StartRecording, f'/rosette/{names.START_RECORDING}')
    wait_until(opened.service_is_ready)
    future = opened.call_async(StartRecording.Request(run_id='log_of_a_stranger'))
    wait_until(future.done)
    assert future.result().success
    outcome = client.calibrate(check=cell.check, **UNTIL)
    assert outcome.success and same_curves(outcome, undisturbed), outcome.message


def test_a_forged_event_counts_nowhere(cell, client, stranger, undisturbed):
    """Its sequencer has not said that the run ended in success: the run is held, and told, while two say events."""
    made = []

    def join(run_id):
        publisher = stranger.node.create_publisher(CalibrationEvent, '/rosette/calibration_event', qos.EVENT)
        made.append(publisher)
        publisher.publish(CalibrationEvent(run_id=run_id, kind=CalibrationEvent.SUCCEEDED, text='forged'))

    def leave(told):
        if any('2 nodes publish /rosette/calibration_event' in one.text for one in told) and made:
            stranger.node.destroy_publisher(made.pop())

    outcome = run_with(client, cell, join, leave, **UNTIL)
    assert outcome.success and same_curves(outcome, undisturbed)
    assert '2 nodes publish /rosette/calibration_event' in outcome.message
    assert b'forged' not in next(outcome.log.glob('*.mcap')).read_bytes()


def test_what_else_a_stranger_publishes_changes_nothing(cell, client, stranger, undisturbed):
    """A joint evaluation of its own is kept as what it is, a message of the graph."""
    def join(run_id):
        stranger.node.create_publisher(JointEvaluation, '/rosette/joint_evaluation', qos.RESULT).publish(
            JointEvaluation(run_ids=[run_id], verdict='perfect'))

    outcome = run_with(client, cell, join, **UNTIL)
    assert outcome.success and outcome.message == undisturbed.message and not outcome.is_joint
    assert same_curves(outcome, undisturbed)


def test_a_second_server_of_the_action_is_refused(cell, client, stranger, undisturbed, wait_until):
    """Either could take the goal and say how it ended."""
    server = ActionServer(stranger.node, Calibrate, '/rosette/calibrate', lambda handle: Calibrate.Result(success=True))
    wait_until(lambda: client._servers.refusal())
    with pytest.raises(CellError, match=r'2 nodes offer /rosette/calibrate/_action/send_goal '
                       r'\(/elsewhere/stranger and /rosette/sequencer\); end that one'):
        client.calibrate()
    server.destroy()
    wait_until(lambda: not client._servers.refusal())
    assert client.calibrate(check=cell.check).success

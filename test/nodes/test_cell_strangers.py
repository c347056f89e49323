# SPDX-License-Identifier: Apache-2.0
"""A program that has every topic and every service of a cell: nothing of it counts, and two of a kind are said."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from rclpy.action import ActionServer
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import (
    BallCentre,
    CalibrationEvent,
    Diagnosis,
    ErrorMotions,
    JointEvaluation,
    Model,
    ProbeTarget,
    Run,
    RunState,
    Touches,
)
from rosette_msgs.srv import (
    AddEffect,
    CheckPlan,
    Diagnose,
    EvaluateJointly,
    NextReadings,
    Recall,
    Recorded,
    RemoveEffect,
    StartRecording,
    StopRecording,
)
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

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
REQUESTS = {
    names.START_CALIBRATION: Trigger.Request(), names.DIAGNOSE: Diagnose.Request(),
    names.ADD_EFFECT: AddEffect.Request(effect='forged'),
    names.REMOVE_EFFECT: RemoveEffect.Request(effect='forged'),
    **{name: kind.Request() for name, (kind, _) in FORGED.items()}}
"""What is asked of the services of a cell in the middle of a run."""
FOR_A_PERSON = {names.CANCEL_CALIBRATION, names.RECOVER}
"""Who asks these wants what they do."""
PUBLISHED = {
    names.PROBE_TARGET: (qos.TARGET, lambda run_id: ProbeTarget(
        header=Header(frame_id='machine'), run_id=run_id, seq=9999, attempt=1, phase=ProbeTarget.PHASE_RUN, balls=N,
        radius=0.1825, table_position=1, ball=1, cmm_position=1)),
    names.BALL_CENTRE: (qos.ANSWER, lambda run_id: BallCentre(
        header=Header(frame_id='machine'), run_id=run_id, seq=8, table_position=1, ball=1, cmm_position=1)),
    names.TOUCHES: (qos.ANSWER, lambda run_id: Touches(
        header=Header(frame_id='machine'), run_id=run_id, seq=8, x=[0.0] * 4, y=[0.0] * 4, z=[0.0] * 4)),
    names.CALIBRATION_EVENT: (qos.EVENT, lambda run_id: CalibrationEvent(
        run_id=run_id, kind=CalibrationEvent.SUCCEEDED, text='forged')),
    names.RUN: (qos.RESULT, lambda run_id: Run(run_id=run_id)),
    names.RUN_STATE: (qos.STATE, lambda run_id: RunState(run_id=run_id, phase=RunState.PHASE_DONE, text='forged')),
    names.ERROR_MOTIONS: (qos.RESULT, lambda run_id: ErrorMotions(run_id=run_id, balls=N, angle=[0.0] * N)),
    names.MODEL: (qos.RESULT, lambda run_id: Model(run_id=run_id, name='forged', hash='0' * 64)),
    names.DIAGNOSIS: (qos.RESULT, lambda run_id: Diagnosis(run_id=run_id, outcome='fits', verdict='forged')),
    names.JOINT_EVALUATION: (qos.RESULT, lambda run_id: JointEvaluation(run_ids=[run_id], verdict='forged')),
    names.TF_STATIC: (qos.RESULT, lambda _: TFMessage(transforms=[TransformStamped(
        header=Header(frame_id='machine'), child_frame_id='table',
        transform=Transform(translation=Vector3(x=0.001)))])),
    names.DIAGNOSTICS: (qos.STATUS, lambda _: DiagnosticArray(status=[DiagnosticStatus(
        name='rosette/cmm', values=[KeyValue(key='process', value='cmm 1 deadbeef'),
                                    KeyValue(key='problem', value='forged trouble')])])),
    names.CALIBRATE_FEEDBACK: (qos.EVENT, lambda run_id: Calibrate.Impl.FeedbackMessage(
        feedback=Calibrate.Feedback(state=RunState(run_id='forged', phase=RunState.PHASE_RUN)))),
    names.CALIBRATE_STATUS: (qos.RESULT, lambda _: GoalStatusArray(
        status_list=[GoalStatus(status=GoalStatus.STATUS_ABORTED)]))}
"""A message of each topic of a cell: what its own node would not say."""
OF_THE_TIME = {names.CLOCK}
"""Of a whole domain, where it is simulated: who sets it sets the time of all programs."""
UNTIL = {'until_probability': 0.95, 'until_uncertainty': 1e-9, 'most_readings': 4}
WAIT = 'limits.return_timeout_s: 60.0'


def test_every_service_of_a_run_is_tried():
    """Those that the sequencer asks."""
    assert {*FORGED} == {*names.SERVERS}


def test_every_interface_is_tried():
    """All that the page of interfaces names, and all names of the graph."""
    page = (Path(__file__).parents[2] / 'docs' / 'interfaces.md').read_text()
    rows = [line.split('|')[1] for line in page.splitlines() if line.startswith('| `')]
    found = [name for row in rows for name in re.findall('`([^`]+)`', row)]
    own = {name.rpartition('/')[2] for name in (*PUBLISHED, *REQUESTS, *FOR_A_PERSON, *OF_THE_TIME, names.CALIBRATE)}
    assert {name.rpartition('/')[2] for name in found} - own == {
        *names.NODES, 'simulated_cmm', 'dme_cmm', names.TABLE_CORRECTOR, 'set_parameters'}
    assert {*PUBLISHED} >= {*names.PUBLISHERS, *names.SIGNED} and {*REQUESTS} >= {*names.SERVERS}


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
    wait_until(lambda: '/rosette/sequencer' in client._servers.refusal())  # names come later than servers
    with pytest.raises(CellError, match=r'2 nodes offer /rosette/calibrate/_action/send_goal '
                       r'\(/elsewhere/stranger and /rosette/sequencer\); end that one'):
        client.calibrate()
    server.destroy()
    wait_until(lambda: not client._servers.refusal())
    assert client.calibrate(check=cell.check).success


def test_a_program_with_every_interface_changes_no_run(cell, client, stranger, undisturbed, wait_until):
    """It publishes on all topics, offers all services and asks for all that they do, in the middle of a run."""
    node, made, servers, futures = stranger.node, [], [], []
    clients = {name: node.create_client(
        {names.START_CALIBRATION: Trigger, names.DIAGNOSE: Diagnose, names.ADD_EFFECT: AddEffect,
         names.REMOVE_EFFECT: RemoveEffect}.get(name) or FORGED[name][0], f'/rosette/{name}') for name in REQUESTS}
    wait_until(lambda: all(one.service_is_ready() for one in clients.values()), 30)

    def join(run_id):
        futures.extend(clients[name].call_async(request) for name, request in REQUESTS.items())
        for topic, (profile, message) in PUBLISHED.items():
            name = topic if topic.startswith('/') else f'/rosette/{topic}'
            made.append(node.create_publisher(type(message(run_id)), name, profile))
            made[-1].publish(message(run_id))
        servers.append(Servers(stranger, *FORGED))

    def leave(told):
        if made and all(one.done() for one in futures) and any('2 nodes publish' in one.text for one in told):
            servers[0].leave()
            while made:
                node.destroy_publisher(made.pop())

    outcome = run_with(client, cell, join, leave, **UNTIL)
    assert outcome.success, outcome.message
    assert servers[0].asked == []
    # an answer of a stranger to a target that was asked is a remark on what to do, whichever came first
    said, before = outcome.verdict, undisturbed.verdict
    assert same_curves(outcome, undisturbed) and (said.outcome, said.sentence) == (before.outcome, before.sentence)
    log = read_log(outcome.log)
    assert log.states[-1].phase == Phase.DONE and not [one for one in log.targets if one.seq == 9999]
    assert log.to_run().centre.tobytes() == read_log(undisturbed.log).to_run().centre.tobytes()
    assert client.calibrate(check=cell.check).success


def test_a_cmm_is_not_recovered_by_another_node(client, stranger, wait_until):
    """It said that the CMM goes on."""
    servers = [stranger.node.create_service(Trigger, f'/rosette/{names.RECOVER}', lambda _, answer: answer)]
    with pytest.raises(CellError, match=r'/elsewhere/stranger, which offers /rosette/cmm/recover, is not the cmm of '
                       'this cell; end that one'):
        client.recover()
    stranger.node.destroy_service(servers.pop())

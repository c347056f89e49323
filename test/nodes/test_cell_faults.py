# SPDX-License-Identifier: Apache-2.0
"""What a cell does when a part of it is missing, silent, wrong, or ended."""

import resource
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import BallCentre, ErrorMotions, ProbeTarget, Run
from rosette_msgs.srv import CheckPlan, StartRecording

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.recorder import Recorder
from rosette_ros.simulation import Machine, MachineConfig

pytestmark = pytest.mark.long

N = 3
OTHERS = ('recorder', 'evaluator', 'sequencer')


class PeerCmm:
    """A CMM on another node, in wall time, that may do wrong; see `wrong`."""

    def __init__(self, peer):
        """Listen to targets; wrong(target, answer) returns what is sent instead, or None."""
        self.machine = Machine(MachineConfig().changed(plate={'balls': N}))
        self.wrong = lambda target, answer: answer
        self.asked = []
        self._answers = peer.node.create_publisher(BallCentre, 'ball_centre', qos.ANSWER)
        self._node = peer.node
        peer.node.create_subscription(ProbeTarget, 'probe_target', self._on_target, qos.ORDER)

    def _on_target(self, target):
        self.asked.append((target.seq, target.attempt))
        reading = self.machine.measure(target.table_position, target.ball, target.approach,
                                       conversions.point_array(target.centre))
        answer = BallCentre(run_id=target.run_id, seq=target.seq, ball=target.ball,
                            table_position=target.table_position, cmm_position=target.cmm_position)
        conversions.fill_answer(answer, reading, self._node.get_clock().now().to_msg(), 'machine')
        answer = self.wrong(target, answer)
        if answer is not None:
            self.send(answer)

    def send(self, answer):
        """Publish an answer."""
        self._answers.publish(answer)


@pytest.fixture(scope='module')
def peer(module_domain_id, make_peer):
    """Yield the node that the CMM of this file stands on."""
    made = make_peer(module_domain_id)
    yield made
    made.stop()


@pytest.fixture(scope='module')
def shared_cell(peer, module_domain_id, make_cell, tmp_path_factory, wait_until):
    """Yield (cell, cmm): a cell in wall time whose CMM is a PeerCmm."""
    cmm = PeerCmm(peer)
    peer.start()
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, nodes=OTHERS,
                   simulated_time=False) as cell:
        wait_until(lambda: 'the cell is complete' in cell.processes['sequencer'].text())
        yield cell, cmm


@pytest.fixture
def cell_and_cmm(shared_cell):
    """Yield the shared cell with a CMM that does nothing wrong yet."""
    cell, cmm = shared_cell
    cmm.wrong = lambda target, answer: answer
    cmm.asked.clear()
    return cell, cmm


@pytest.fixture
def client(module_domain_id):
    """Yield a client of the shared cell."""
    with CellClient(module_domain_id) as made:
        yield made


def options(timeout, attempts):
    return f'{{limits.answer_timeout_s: {timeout}, limits.attempts: {attempts}}}'


def test_silent_cmm_ends_the_run_in_the_configured_time_and_the_log_is_kept(cell_and_cmm, client):
    """Asked three times, then FAILED in words; what was measured is in the log."""
    cell, cmm = cell_and_cmm
    cmm.wrong = lambda target, answer: answer if target.seq < 8 else None
    outcome = client.calibrate(options=options(0.3, 3), check=cell.check)
    assert not outcome.success
    assert not outcome.cancelled
    assert 'target 8 (table position ' in outcome.message
    assert 'asked 3 times, last: no answer within 0.3 s' in outcome.message
    log = read_log(outcome.log)
    asked = [(target.seq, target.attempt) for target in log.targets]  # an answer may be late: that one is asked again
    assert asked[-3:] == [(8, 1), (8, 2), (8, 3)]
    assert {seq for seq, _ in asked[:-3]} == {answer.seq for answer in log.answers} == set(range(1, 8))
    assert log.problems == ()
    assert log.states[-1].phase == Phase.FAILED
    assert [event.kind for event in log.events] == [1, 2, 7]


def test_cancel_ends_at_once_and_leaves_a_valid_log(cell_and_cmm, client):
    """Ctrl-C in the client cancels the goal while an answer is awaited; the log is closed and says so."""
    cell, cmm = cell_and_cmm
    cmm.wrong = lambda target, answer: answer if target.phase != Phase.RUN else None
    interrupted = []

    def interrupt(progress):
        if progress.phase == Phase.RUN and not interrupted:
            interrupted.append(progress.done)
            signal.raise_signal(signal.SIGINT)

    outcome = client.calibrate(on_progress=interrupt, check=cell.check)
    assert outcome.cancelled
    assert not outcome.success
    assert outcome.error_motions is None
    log = read_log(outcome.log)
    assert not log.truncated
    assert log.problems == ()
    assert [event.kind for event in log.events if event.run_id == outcome.run_id] == [1, 2, 4, 6]
    assert log.states[-1].phase == Phase.CANCELLED
    assert interrupted == [len(log.answers)]
    assert not log.error_motions
    cmm.wrong = lambda target, answer: answer
    assert client.calibrate(check=cell.check).success


def test_what_the_plain_service_started_another_one_cancels(cell_and_cmm, client, wait_until, trigger):
    """cancel_calibration ends whichever run is running, and says so where none is."""
    cell, cmm = cell_and_cmm
    cmm.wrong = lambda target, answer: None
    started, run_id = trigger(client, 'start_calibration')
    assert started
    assert trigger(client, 'cancel_calibration') == (True, run_id)
    wait_until(lambda: f'run {run_id}: cancelled' in cell.processes['sequencer'].text())
    refused = (False, 'expected a run to cancel, found none that is running')
    wait_until(lambda: trigger(client, 'cancel_calibration') == refused)
    wait_until(lambda: f'log of run {run_id}' in cell.processes['recorder'].text())


def test_faulty_cmm_is_asked_again_and_the_run_ends_well(cell_and_cmm, client):
    """Late, failed, not finite, of another run, twice: each is refused, the ball is repeated."""
    cell, cmm = cell_and_cmm
    sent_twice = []

    def wrong(target, answer):
        if target.attempt == 1 and target.seq == 4:
            return None
        if target.attempt == 1 and target.seq == 12:
            answer.status, answer.text = BallCentre.STATUS_FAILED, 'door open'
        elif target.attempt == 1 and target.seq == 13:
            answer.centre.x = float('nan')
        elif target.attempt == 1 and target.seq == 14:
            answer.run_id = 'another'
        elif target.seq == 15:
            cmm.send(answer)
            sent_twice.append(answer.seq)
        return answer

    cmm.wrong = wrong
    outcome = client.calibrate(options=options(0.5, 2), check=cell.check)
    assert outcome.success, outcome.message
    assert sent_twice == [15]
    said = cell.processes['sequencer'].text()
    again = {seq for seq, attempt in cmm.asked if attempt == 2}
    late = said.count('no answer within 0.5 s; asking again')
    assert again >= {4, 12, 13, 14}
    assert len(again) <= 3 + late  # a computer that is busy may be late with others
    for words in ('no answer within 0.5 s; asking again', 'the CMM reports: door open',
                  'expected finite numbers', "not used: answer to run 'another'",
                  'not used: answer to seq 15, waiting for seq 16'):
        assert words in said
    log = read_log(outcome.log)
    assert log.latest_error_motions().completeness == 1.0
    assert log.to_run().size == N * N
    offline = analyse(log.to_run()).error_motions
    assert np.array_equal(offline.values, outcome.error_motions.values)


def test_second_calibration_is_refused_by_service_and_action_while_one_is_on(cell_and_cmm, client,
                                                                                 module_domain_id, trigger):
    """In words, and the first one goes on to its end."""
    cell, cmm = cell_and_cmm
    refused, said = threading.Event(), []

    def wrong(target, answer):
        if target.seq == 12:
            assert refused.wait(60)
        return answer

    def intrude(progress):
        if progress.phase == Phase.RUN and not said:
            with CellClient(module_domain_id) as second:
                with pytest.raises(CellError) as refusal:
                    second.calibrate()
                said.append(str(refusal.value))
                said.append(trigger(second, 'start_calibration'))
            refused.set()

    cmm.wrong = wrong
    outcome = client.calibrate(on_progress=intrude, check=cell.check)
    assert outcome.success, outcome.message
    assert f'calibration refused: run {outcome.run_id} is running (run, 11 of 19 balls)' in said[0]
    assert 'wait for its end or cancel it' in said[0]
    started, words = said[1]
    assert not started
    assert f'run {outcome.run_id} is running' in words
    kinds = [event.kind for event in read_log(outcome.log).events]
    assert kinds[-7:] == [1, 2, 1, 3, 1, 3, 5]
    served = [entry for entry in iter_log(outcome.log)
              if entry.topic == '/rosette/start_calibration/_service_event']
    assert len(served) >= 2


@pytest.mark.parametrize(('node', 'name'), [
    ('recorder', 'log_dir'), ('sequencer', 'plan'), ('sequencer', 'plate.file'), ('sequencer', 'identity')])
def test_no_node_of_the_graph_names_a_file_of_this_computer(cell_and_cmm, peer, node, name):
    """A plan showed 80 characters of any file that the sequencer can read; logs went to any folder."""
    parameters = AsyncParameterClient(peer.node, node)
    assert parameters.wait_for_services(10.0)
    future = parameters.set_parameters([Parameter(name, value='/etc/passwd')])
    while not future.done():
        time.sleep(0.02)
    (result,) = future.result().results
    assert not result.successful and 'read-only' in result.reason


def test_recorder_that_dies_ends_the_run_in_words(cell_and_cmm, client, wait_until):
    """No ball is measured for nothing: the run ends when its log does. With a new recorder it is resumed."""
    cell, cmm = cell_and_cmm

    def wrong(target, answer):
        if target.seq == 9:
            cell.processes['recorder'].popen.send_signal(signal.SIGINT)
            return None
        return answer

    cmm.wrong = wrong
    outcome = client.calibrate(options='{limits.answer_timeout_s: 30, limits.return_timeout_s: 3}')
    assert 'the recorder is disconnected and did not come back within 3 s' in outcome.message
    assert not outcome.success
    assert cell.processes['recorder'].popen.wait(60) == 0
    log = read_log(outcome.log)
    assert not log.truncated
    assert len(log.answers) == 8
    cmm.wrong = lambda target, answer: answer
    cell.start_node('recorder')
    wait_until(lambda: cell.processes['sequencer'].text().strip().endswith('the cell is complete'))
    asked = len(cmm.asked)
    outcome = client.calibrate(check=cell.check, resume=outcome.run_id)
    assert outcome.success, outcome.message
    log = read_log(outcome.log)
    assert log.to_run().size == N * N
    assert min(seq for seq, _ in cmm.asked[asked:]) == 9, 'only what was missing'


def test_a_run_whose_log_lacks_a_result_is_no_success(cell_of, domain_id, make_peer, wait_until):
    """Error motions without their model: the recorder waits for it a bounded time, and the run fails in words."""
    peer = make_peer(domain_id)
    PeerCmm(peer)
    evaluator = peer.node.create_publisher(ErrorMotions, 'error_motions', qos.RESULT)

    def evaluate(run):
        evaluator.publish(ErrorMotions(
            header=run.header, run_id=run.run_id, process='evaluator 1', model_hash='of no model',
            readings_hash=conversions.answers_of(run).readings_hash))

    peer.node.create_subscription(Run, 'run', evaluate, qos.RESULT)
    peer.start()
    try:
        with cell_of(N, nodes=('recorder', 'sequencer'), simulated_time=False,
                     sequencer={'recorder_timeout_s': 1.5}) as cell, CellClient(domain_id) as client:
            wait_until(lambda: 'the cell is complete' in cell.processes['sequencer'].text())
            outcome = client.calibrate(check=cell.check)
    finally:
        peer.stop()
    assert not outcome.success
    assert outcome.message == (
        'the log lacks the model; evaluate it offline, or resume the run; what was measured is in '
        f'{outcome.log}; continue with: rosette calibrate --resume {outcome.log} --domain {domain_id}')
    log = read_log(outcome.log)
    assert log.states[-1].phase == Phase.FAILED
    assert [event.kind for event in log.events] == [1, 2, 7]
    assert log.to_run().size == N * N


def test_missing_parts_are_named_by_service_and_action(cell_of, domain_id, trigger):
    """A calibration does not start without a CMM, an evaluator and a recorder."""
    wanted = (
        'no CMM: expected one that subscribes to probe_target and publishes ball_centre, found none',
        'no evaluator: expected one that publishes error_motions, found none',
        'no recorder: expected its service recorder/start_recording, found none')
    with cell_of(N, nodes=('sequencer',)) as cell, CellClient(domain_id) as client:
        with pytest.raises(CellError, match='calibration refused: no CMM') as refusal:
            client.calibrate(check=cell.check)
        started, why = trigger(client, 'start_calibration')
        goal = client._await(client._action.send_goal_async(Calibrate.Goal()), 10.0, cell.check)
        result = client._await(goal.get_result_async(), 10.0, cell.check).result
    assert not started and not result.success and not result.run_id
    for words in wanted:
        assert words in why
        assert words in str(refusal.value)
        assert words in result.message


def test_a_disk_that_refuses_ends_the_run_at_once_and_it_is_resumed(cell_of, domain_id):
    """The recorder may write no further byte: nothing is measured for nothing. With room again it goes on."""
    with cell_of(N, params={'cmm': {'answer_s': 0.1}}) as cell, CellClient(domain_id) as client:
        limits = resource.prlimit(cell.processes['recorder'].popen.pid, resource.RLIMIT_FSIZE)
        done = []

        def look(progress):
            if not done and progress.phase != Phase.IDLE:
                size = (cell.log_dir / progress.run_id / f'{progress.run_id}_0.mcap').stat().st_size
                resource.prlimit(cell.processes['recorder'].popen.pid, resource.RLIMIT_FSIZE, (size + 100, limits[1]))
            done.append(progress)

        outcome = client.calibrate(check=cell.check, on_progress=look)
        assert not outcome.success
        assert 'cannot write the log: File too large' in outcome.message
        assert max(one.done for one in done) < done[0].total
        resource.prlimit(cell.processes['recorder'].popen.pid, resource.RLIMIT_FSIZE, limits)
        outcome = client.calibrate(check=cell.check, resume=outcome.run_id)
        assert outcome.success, outcome.message
    assert read_log(outcome.log).to_run().size == N * N


def test_too_little_room_is_refused_before_a_ball_is_measured(ros, tmp_path, monkeypatch):
    """A log that would soon end is not begun."""
    monkeypatch.setattr('shutil.disk_usage', lambda _: SimpleNamespace(free=19e6))
    with ros('-p', f'log_dir:={tmp_path}'):
        node = Recorder()
        response = node._on_start(StartRecording.Request(run_id='a'), StartRecording.Response())
        node.destroy_node()
    assert not response.success
    assert 'expected 20 MB of room for the log (least_free_mb), found 19.0 MB' in response.message
    assert list(tmp_path.iterdir()) == []


def test_clean_end_on_sigint_and_sigterm_in_the_middle_of_a_run(cell_of, domain_id):
    """All nodes get Ctrl-C at once: exit code 0, no traceback, the log is closed and whole."""
    cell = cell_of(12)
    cell.start()
    interrupted = []

    def interrupt(progress):
        if progress.phase == Phase.RUN and not interrupted:
            interrupted.append(progress)
            cell.processes['cmm'].popen.send_signal(signal.SIGTERM)
            for name in ('recorder', 'evaluator', 'sequencer'):
                cell.processes[name].popen.send_signal(signal.SIGINT)

    with CellClient(domain_id) as client:
        try:
            outcome = client.calibrate(on_progress=interrupt)
        except CellError as error:
            assert 'the sequencer is disconnected' in str(error)
        else:
            assert not outcome.success
    codes = {name: cell.processes[name].popen.wait(60) for name in MODULES}
    assert codes == dict.fromkeys(MODULES, 0)
    for name in MODULES:
        assert 'Traceback' not in cell.processes[name].output.read_text(errors='replace')
    cell.stop()
    run_id = interrupted[0].run_id
    log = read_log(cell.log_dir / run_id)
    assert not log.truncated
    assert log.problems == ()
    assert len(log.answers) >= interrupted[0].done


@pytest.mark.parametrize('reason', ['', 'ball 3 cannot be reached'])
def test_a_cmm_may_take_its_time_to_judge_a_plan(domain_id, cell_of, make_peer, wait_until, reason):
    """Longer than an answer of the recorder may take: then the run begins, or fails in the words of the CMM."""
    peer = make_peer(domain_id)
    cmm = PeerCmm(peer)

    def judged(_, response):
        time.sleep(4.0)  # recorder_timeout_s and the time to discover all nodes are over
        response.success, response.message = not reason, reason
        return response

    peer.node.create_service(CheckPlan, names.CHECK_PLAN, judged)
    peer.start()
    with cell_of(N, nodes=OTHERS, simulated_time=False, sequencer={'recorder_timeout_s': 2.0}) as cell:
        wait_until(lambda: 'the cell is complete' in cell.processes['sequencer'].text())
        with CellClient(domain_id) as client:
            outcome = client.calibrate(check=cell.check)
    assert outcome.success == (not reason), outcome.message
    assert not reason or 'the CMM cannot measure this plan: ball 3 cannot be reached' in outcome.message
    assert bool(cmm.asked) == outcome.success
    peer.stop()

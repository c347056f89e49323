# SPDX-License-Identifier: Apache-2.0
"""Statuses and lifecycle: who has gone is noticed and told, and calibrations can be held back."""

import signal
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import names
from rosette_ros.nodes.qos import STATUS_LOST
from rosette_ros.nodes.sequencer import Sequencer

pytestmark = pytest.mark.long

N = 4


class Integrator:
    """Changes the state of the sequencer, hears health: what a lifecycle manager or a person does."""

    def __init__(self, domain):
        """Join the graph."""
        self._context = Context()
        self._context.init(domain_id=domain)
        self._node = Node('integrator', namespace='/rosette', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._change = self._node.create_client(ChangeState, 'sequencer/change_state')
        self._get = self._node.create_client(GetState, 'sequencer/get_state')
        self._health = {}
        self._node.create_subscription(DiagnosticArray, names.DIAGNOSTICS, self._on_health, 50)
        assert self._change.wait_for_service(20)
        assert self._get.wait_for_service(20)

    def _on_health(self, message):
        for status in message.status:
            self._health[status.name] = status.message

    def close(self):
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def change(self, transition):
        """Return whether a transition succeeded."""
        return self._ask(self._change, ChangeState.Request(transition=Transition(id=transition))).success

    @property
    def state(self):
        """The label of the sequencer's state."""
        return self._ask(self._get, GetState.Request()).current_state.label

    def health(self, name):
        """Hear what was said and return the last words of a node about its health."""
        for _ in range(100):
            self._executor.spin_once(timeout_sec=0)
        return self._health.get(name, '')

    def _ask(self, client, request):
        future = client.call_async(request)
        self._executor.spin_until_future_complete(future, 20)
        return future.result()


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell that answers slowly enough to be disturbed."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('lifecycle'), N,
                   sequencer={'limits.return_timeout_s': 60.0}, params={'cmm': {'answer_s': 0.1}}) as made:
        yield made


@pytest.fixture(scope='module')
def integrator(cell, module_domain_id):
    """Yield an Integrator of the cell."""
    made = Integrator(module_domain_id)
    yield made
    made.close()


@pytest.fixture
def client(cell, module_domain_id):
    """Yield a client of the cell."""
    with CellClient(module_domain_id) as made:
        yield made


def test_an_inactive_sequencer_refuses_calibrations(cell, client, integrator, wait_until, trigger):
    """Deactivated for maintenance: refused by action and service, and reported; activated: it calibrates."""
    assert integrator.state == 'active'
    assert integrator.change(Transition.TRANSITION_DEACTIVATE)
    with pytest.raises(CellError, match='the sequencer is not active: no calibration starts until it is '
                                        r'activated \(ros2 lifecycle set /rosette/sequencer activate\)'):
        client.calibrate()
    started, words = trigger(client, 'start_calibration')
    assert not started
    assert 'the sequencer is not active' in words
    wait_until(lambda: 'not active: no calibration starts until' in integrator.health('rosette/sequencer'))
    assert integrator.change(Transition.TRANSITION_CLEANUP)
    assert integrator.state == 'unconfigured'
    assert integrator.change(Transition.TRANSITION_CONFIGURE)
    assert integrator.change(Transition.TRANSITION_ACTIVATE)


def test_a_busy_sequencer_is_not_deactivated(cell, client, integrator):
    """Nobody stops a run by a lifecycle transition: it is cancelled, or waited for."""
    refused = []

    def look(progress):
        if progress.done > 2 and not refused:
            refused.append(integrator.change(Transition.TRANSITION_DEACTIVATE))

    assert client.calibrate(check=cell.check, on_progress=look).success
    assert refused == [False]
    assert 'asked to deactivate: expected no calibration running, found: ' in cell.processes['sequencer'].text()
    assert integrator.state == 'active'


def test_without_autostart_a_manager_decides(ros):
    """autostart: false leaves the sequencer unconfigured, as a lifecycle manager expects it."""
    with ros('-p', 'autostart:=false'):
        node = Sequencer()
        assert not node.is_active
        assert node.health()[1] == 'not active: no calibration starts until the node is activated'
        node.trigger_configure()
        node.trigger_activate()
        assert node.is_active
        node.destroy_node()


def test_a_cmm_that_is_stopped_hangs_and_is_told(cell, client):
    """SIGSTOP: the process is there and does not speak; SIGCONT: the run goes on by itself, without a pause."""
    stopped = []

    def look(progress=None):
        if progress and progress.done > 2 and not stopped:
            cell.processes[names.CMM].popen.send_signal(signal.SIGSTOP)
            stopped.append(names.CMM)
        if stopped and 'the CMM is disconnected; the run waits for it' in cell.processes['sequencer'].text():
            cell.processes[names.CMM].popen.send_signal(signal.SIGCONT)

    try:
        outcome = client.calibrate(check=look, on_progress=look)
    finally:
        cell.processes[names.CMM].popen.send_signal(signal.SIGCONT)
    assert stopped
    assert outcome.success, outcome.message
    assert read_log(outcome.log).to_run().pauses == ()


def test_a_recorder_that_stands_still_for_a_moment_loses_nothing(cell_of, domain_id):
    """As where disk or processor is busy: what is sent meanwhile waits in the buffer, and nothing is asked again.

    In 0.2 MB of it, which is what Linux gives unless asked, 37 of 302 clocks were lost."""
    stopped = []
    with cell_of(16, sequencer={'repeats': 0}) as cell, CellClient(domain_id) as client:
        recorder = cell.processes[names.RECORDER]

        def look(progress):
            if progress.phase == Phase.RUN and progress.done > 40 and not stopped:
                recorder.popen.send_signal(signal.SIGSTOP)
                time.sleep(0.3)
                recorder.popen.send_signal(signal.SIGCONT)
                stopped.append(progress.done)

        outcome = client.calibrate(on_progress=look, check=cell.check)
        assert stopped
        assert outcome.success, outcome.message
        targets = read_log(outcome.log).targets
        assert len(targets) == len({target.seq for target in targets}) == 16 * 16 + 2 * 16 + 1
        if int(Path('/proc/sys/net/core/rmem_max').read_text()) >= 4 << 20:  # of a clock only the last ten are repeated
            assert sum(one.topic.endswith(names.CLOCK) for one in iter_log(outcome.log)) >= len(targets)


def test_a_recorder_that_stands_still_while_it_closes_the_log_is_waited_for(cell_of, domain_id):
    """Where disk or processor is busy for longer than a status may be late, the run ends in success."""
    stopped = []
    with cell_of(6) as cell, CellClient(domain_id) as client:
        recorder = cell.processes[names.RECORDER]

        def look(progress):
            if progress.phase == Phase.DONE and not stopped:
                recorder.popen.send_signal(signal.SIGSTOP)
                stopped.append(time.monotonic())

        def check():
            if stopped and time.monotonic() - stopped[0] > 2 * STATUS_LOST:
                recorder.popen.send_signal(signal.SIGCONT)

        outcome = client.calibrate(on_progress=look, check=check)
        assert stopped and time.monotonic() - stopped[0] > 2 * STATUS_LOST
        assert outcome.success, outcome.message
        assert read_log(outcome.log).to_run().size == 36


def killed_cmm(cell, client, integrator):
    """Kill the CMM in a run; return the Outcome, what the state and the health said, and how late it said so, s."""
    killed, told, words, noticed = [], [], [], []

    def look(progress=None):
        if progress:
            told.append(progress.text)
            if progress.done > 2 and not killed:
                cell.processes[names.CMM].popen.send_signal(signal.SIGKILL)
                killed.append(time.monotonic())
                cell.processes[names.CMM].popen.wait(60)
            if killed and not noticed and 'the CMM is disconnected' in progress.text:
                noticed.append(time.monotonic() - killed[0])
        if killed:
            words.append(integrator.health('rosette/sequencer'))

    outcome = client.calibrate(on_progress=look, check=look, options='limits.return_timeout_s: 3.0')
    return outcome, told, words, noticed[0]


def test_a_dead_cmm_is_noticed_long_before_its_answer_is_late(cell, client, integrator, wait_until):
    """Killed and not started again: told in the state and in the health at once; the run waits, then ends in words.

    An answer may take 120 s; statuses are missed after 1.25 s, which a busy computer exceeds.
    """
    outcome, told, words, noticed = killed_cmm(cell, client, integrator)
    assert noticed < 20.0
    assert any('the CMM is disconnected' in one for one in words), sorted(set(words))
    wait_until(lambda: 'no CMM' in integrator.health('rosette/sequencer'))
    assert not outcome.success
    assert outcome.message.startswith('the CMM is disconnected and did not come back within 3 s; resume the run when '
                                      f'it is connected; what was measured is in {outcome.log}; continue with: ')
    assert 'the CMM is disconnected; waiting for it' in told
    log = read_log(outcome.log)
    assert log.problems == ()
    assert log.runs[outcome.run_id].answered == log.states[-1].done >= 2  # the last one may have died with its sender


def test_presence_takes_little_of_a_log(cell_of, domain_id):
    """At 30 s a ball it was 360 messages a ball, at 0.3 s it was 4."""
    with cell_of(3, params={'cmm': {'answer_s': 0.3}}) as cell, CellClient(domain_id) as client:
        outcome = client.calibrate(check=cell.check)
        assert outcome.success, outcome.message
    log = read_log(outcome.log)
    presence = [one for one in iter_log(outcome.log) if one.topic == names.DIAGNOSTICS]
    assert 4 <= len(presence) < 2 * len(log.answers)

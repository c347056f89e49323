# SPDX-License-Identifier: Apache-2.0
"""A cell whose CMM is behind an I++ DME server: curves, plans, cancel, collision, a person, resume, the end."""

import contextlib
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from faulty_proxy import spoiling
from rosette_msgs.msg import ProbeTarget, RunState

from rosette_ros.cell.client import CellClient
from rosette_ros.cell.cmm_check import CmmClient
from rosette_ros.cell.supervisor import DME_CMM, cell_environment
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.dme.dme_server import serving
from rosette_ros.dme.dme_settings import load_dme_settings, sequencer_parameters
from rosette_ros.dme.stop_mark import StopMark
from rosette_ros.dme.virtual_cmm import MachineClock, VirtualCmm
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import STATUS_OK
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.base_node import ERROR
from rosette_ros.nodes.dme_cmm import main
from rosette_ros.simulation import Machine, MachineConfig

pytestmark = pytest.mark.long

N = 3
SETTINGS = {
    'schema': 'rosette-dme/1', 'simulated': True, 'table': {'balls': N}, 'timeouts': {'abort_s': 1.0},
    'tool': {'name': 'Probe1', 'change': True},
    'ball': {'radius_mm': 7.5, 'shaft_radius_mm': 2.7, 'shaft_length_mm': 30.0},
    'path': {'stand_off_mm': 8.0, 'clearance_mm': 40.0, 'box_low_mm': [-150, -240, -320],
             'box_high_mm': [850, 760, 200]},
}
NANOMETRE, NANORADIAN = 1e-9, 1e-9
SOON = 0.2
MOVE = r'< \d+ (GoTo|PtMeas|AlignPart|Home|ChangeTool)'


class Served:
    """A server without noise whose lines are kept, with their times."""

    def __init__(self, folder):
        self.lines = []
        self.config = MachineConfig(seed=3).changed(
            plate={'balls': N}, probing={'repeatability_um': 0.0},
            cmm={'scale_ppm': 0.0, 'squareness_urad': 0.0, 'straightness_um': 0.0})
        self._serving = serving(self.config, say=self._said)
        behind, self.server = self._serving.__enter__()
        self._spoiling = spoiling(behind, say=lambda line: self.lines.append((time.monotonic(), line)))
        port, self.proxy = self._spoiling.__enter__()
        self.settings = folder / 'dme.yaml'
        self.settings.write_text(yaml.safe_dump({**SETTINGS, 'server': {'port': port}}), encoding='utf-8')

    def _said(self, line):
        if line[0] not in '<>':  # lines are those of the proxy
            self.lines.append((time.monotonic(), line))

    def close(self):
        self._spoiling.__exit__(None, None, None)
        self._serving.__exit__(None, None, None)

    def strikes(self, *faults):
        """Have faults strike from now on."""
        self.proxy.strikes(*faults)

    @contextlib.contextmanager
    def slow(self):
        """Have moves take a tenth of real time."""
        cmm = self.server.commands.cmm
        fast, cmm.clock = cmm.clock, MachineClock(10.0)
        try:
            yield
        finally:
            cmm.clock = fast

    def when(self, words, since=0.0):
        """Return when a line with these words came last, None if none did since then."""
        times = [at for at, line in list(self.lines) if re.search(words, line) and at > since]
        return times[-1] if times else None


@pytest.fixture
def soon():
    """Yield a function of a time that returns SOON and how long this process, which looks, had to wait since then."""
    late, ended = [], threading.Event()

    def watch():
        began = time.monotonic()
        while not ended.wait(0.01):
            now = time.monotonic()
            late.append((now, max(now - began - 0.01, 0.0)))
            began = now

    thread = threading.Thread(target=watch)
    thread.start()
    yield lambda since: SOON + sum(wait for at, wait in list(late) if at > since)
    ended.set()
    thread.join()


@pytest.fixture(scope='module')
def served(tmp_path_factory):
    made = Served(tmp_path_factory.mktemp('served'))
    yield made
    made.close()


@pytest.fixture(scope='module')
def cell(served, module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell whose CMM is the node dme_cmm."""
    taught = sequencer_parameters(load_dme_settings(served.settings))
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, dme=served.settings, sequencer=taught) as made:
        yield made


@pytest.fixture
def client(cell, module_domain_id):
    """Yield a client of the cell."""
    with CellClient(module_domain_id) as made:
        yield made


def test_the_curves_are_those_of_the_machine(cell, client, served):
    """Touch by touch through the protocol: within 2 nm and 0.02 µrad of the truth; every touch is in the log."""
    outcome = client.calibrate('row', check=cell.check)
    assert outcome.success, outcome.message
    machine = Machine(served.config)
    true = remove_gauge(machine.table.error(2 * np.pi * np.arange(N) / N))
    found = remove_gauge(outcome.error_motions.values)
    assert np.abs(true[:, :3]).max() > 10 * NANOMETRE
    assert found[:, :3] == pytest.approx(true[:, :3], abs=2 * NANOMETRE)
    assert found[:, 3:] == pytest.approx(true[:, 3:], abs=20 * NANORADIAN)
    run, refit = open_refitted(outcome.log)
    assert run.simulated  # as the node says: nobody has told the recorder, and there is no simulated clock
    assert refit.residual.size == 20 * (3 + 2 * N + N * N + 1)
    assert run.size == N * N
    assert run.table_travel[-1] == pytest.approx(2 * np.pi * (run.table_position[-1] - 1) / N + 2 * np.pi, abs=1e-6)
    assert np.isnan(run.temperature).all()  # a server of 1.4
    assert served.when(r'< \d+ Home') is None


def test_a_run_goes_on_until_it_is_known(cell, client, served, monkeypatch):
    """Backlash is seen by touches alone, three balls, there and back; blocks are measured touch by touch, like a plan,
    and a U that no run reaches ends at the limit."""
    monkeypatch.setattr(served.server.commands, 'cmm', VirtualCmm(served.config.changed(
        probing={'repeatability_um': 0.2}, hidden=[{'kind': 'table_backlash', 'width_urad': 20.0}])))
    outcome = client.calibrate('there_and_back', until_uncertainty=1e-9, most_readings=N, check=cell.check)
    assert outcome.success, outcome.message
    assert 'not settled: ' in outcome.message
    assert outcome.verdict.outcome is Outcome.NAMED
    assert 'backlash of the table' in outcome.verdict.sentence
    log = read_log(outcome.log)
    run, refit = open_refitted(outcome.log)
    planned, *_ = log.asked[outcome.run_id][1]
    assert planned < run.size <= planned + N
    assert refit.residual.size == 20 * (3 + 2 * N + run.size + 1)


@pytest.mark.parametrize(('goal', 'words'), [
    ({'balls': 6}, 'table position 1, ball 1: expected a plan of 3 balls, as the settings have (table.balls), found '
                   'one of '
                   '6'),
    ({'radius': 0.3}, 'expected the ball within 20 mm of (532, 260, -300) mm, where the settings have it (table)'),
])
def test_a_plan_that_cannot_be_measured(cell, client, served, goal, words):
    """Before the run begins, for all its balls: nothing moves, there is no log."""
    began, logs = time.monotonic(), {*cell.log_dir.iterdir()}
    outcome = client.calibrate('row', **goal)
    assert not outcome.success
    assert 'the CMM cannot measure this plan: ' in outcome.message
    assert words in outcome.message
    assert outcome.log is None
    assert {*cell.log_dir.iterdir()} == logs
    assert served.when('<', began) is None


def test_a_cancelled_run_is_aborted_at_once(cell, client, served, module_domain_id, wait_until, trigger, soon):
    """AbortE within 0.2 s of the cancel, in the middle of a move; nothing is sent before the next run."""
    with served.slow(), CellClient(module_domain_id) as other:
        outcomes, began = [], time.monotonic()
        thread = threading.Thread(target=lambda: outcomes.append(client.calibrate('row')))
        thread.start()
        wait_until(lambda: served.when('< .* PtMeas', began))
        success, words = trigger(other, names.CANCEL_CALIBRATION)
        cancelled = time.monotonic()
        assert success, words
        wait_until(lambda: served.when('< E.* AbortE', began))
        assert served.when('< E.* AbortE', began) < cancelled + soon(cancelled)
        thread.join()
        assert outcomes[0].message.startswith('cancelled on request; ')
        assert served.when(MOVE, served.when('< E.* AbortE', began)) is None
        wait_until(lambda: 'nobody waits for ball' in cell.processes[names.CMM].text())
        assert 'error 0006' not in cell.processes[names.CMM].text()
        assert all(one.status == STATUS_OK for one in read_log(outcomes[0].log).answers)


def test_who_did_not_ask_aborts_nothing(cell, client, served, module_domain_id, make_peer, wait_until):
    """A node that publishes targets or states, and leaves: the ball is measured to its end, and the run too."""
    stranger, heard, outcomes = make_peer(module_domain_id), [], []
    stranger.start()
    with served.slow():
        began = time.monotonic()
        thread = threading.Thread(target=lambda: outcomes.append(client.calibrate(
            'row', on_progress=heard.append, options='limits.return_timeout_s: 60.0')))
        thread.start()
        wait_until(lambda: served.when('< .* PtMeas', began))
        targets = stranger.node.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET)
        states = stranger.node.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        states.publish(RunState(run_id=heard[-1].run_id, phase=RunState.PHASE_FAILED))
        wait_until(lambda: '2 nodes publish /rosette/probe_target' in cell.processes[names.CMM].text())
        for one in targets, states:
            stranger.node.destroy_publisher(one)
        time.sleep(1.0)
        assert served.when('AbortE', began) is None
        assert 'is disconnected; its measurement is aborted' not in cell.processes[names.CMM].text()
    thread.join()
    stranger.stop()
    assert outcomes[0].success, outcomes[0].message
    assert served.when('AbortE', began) is None


def test_a_collision_stops_the_run_until_a_person_has_looked(cell, client, served, wait_until, trigger):
    """The run fails in the server's words, which are on the screen and in /diagnostics; nothing moves, a new one is
    refused, also after a restart of the node.

    Then a person has looked: the run is resumed and complete."""
    served.strikes('collision:at=600')
    outcome = client.calibrate('row')
    assert not outcome.success
    assert 'error 2504 (severity 3): Collision; a person has to look at the machine' in outcome.message
    stopped = served.when('2504')
    heard = {}
    health = client._node.create_subscription(DiagnosticArray, names.DIAGNOSTICS, lambda array: heard.update(
        (one.message, one.level) for one in array.status), qos.STATUSES)
    assert client._spin_until(lambda: any('error 2504' in words and level == ERROR for words, level in heard.items()),
                              60.0), heard
    client._node.destroy_subscription(health)
    refused(client, 'error 2504 .*a person has to look .*--recover')
    cmm = cell.processes[names.CMM]
    assert 'error 2504 (severity 3): Collision; a person has to look at the machine' in cmm.text()  # on the screen
    cmm.end(signal.SIGINT)
    wait_until(lambda: cmm.has_ended)
    assert cmm.popen.returncode == 0
    cell.start_node(names.CMM)
    wait_until(lambda: 'error 2504' in cell.processes[names.CMM].text())
    refused(client, 'error 2504 .*a person has to look .*--recover')
    assert served.when(MOVE, stopped) is None
    assert StopMark(served.settings).path.exists()
    assert trigger(client, names.RECOVER)[0]
    assert not StopMark(served.settings).path.exists()
    whole = resumed(client, outcome)
    assert whole.success, whole.message
    assert read_log(whole.log).to_run().size == N * N


def test_a_server_that_is_restarted(cell, client, served, wait_until, trigger):
    """The run fails in words; nothing is connected anew before a person says so."""
    served.strikes('restart:at=200')
    sessions = served.server.sessions
    outcome = client.calibrate('row')
    assert not outcome.success
    assert 'the server closed the connection: it was ended or restarted; a person has to look' in outcome.message
    assert served.server.sessions == sessions
    assert trigger(client, names.RECOVER)[0]
    wait_until(lambda: served.server.sessions == sessions + 1)
    whole = resumed(client, outcome)
    assert whole.success, whole.message
    assert read_log(whole.log).to_run().size == N * N


def test_a_check_that_is_interrupted(cell, served, module_domain_id, wait_until, soon):
    """The node that requested the ball is disconnected: AbortE, nothing is sent after it."""
    class Interrupted(CmmClient):
        def _is_answered(self, target):
            if served.when('< .* PtMeas', began):
                raise KeyboardInterrupt
            return super()._is_answered(target)

    with served.slow():
        with pytest.raises(KeyboardInterrupt), Interrupted(module_domain_id) as asking:
            settings, began = asking.settings({}), time.monotonic()
            asking.check(settings, 2)
        gone = time.monotonic()
        wait_until(lambda: served.when('< E.* AbortE', began))
        assert served.when('< E.* AbortE', began) < gone + 0.8 + soon(gone)
        wait_until(lambda: 'requested ball 1 is disconnected' in cell.processes[names.CMM].text())
        assert served.when(MOVE, served.when('< E.* AbortE', began)) is None


def test_a_node_that_crashed(cell, client, served, module_domain_id, wait_until, trigger, soon):
    """While it measured: it connects when a person has looked, and says what is wrong; a tool is changed for a target.
    """
    began, sessions = time.monotonic(), served.server.sessions
    with served.slow():
        thread = threading.Thread(target=quietly, args=(client.calibrate, 'row'))
        thread.start()
        wait_until(lambda: served.when('< .* PtMeas', began))
        cell.processes[names.CMM].end(signal.SIGKILL)
        wait_until(lambda: cell.processes[names.CMM].has_ended)
        wait_until(lambda: served.when('disconnected', began))  # what the node had sent has been read
        began = time.monotonic()
        cell.restart_failed()
        thread.join()
    said = cell.processes[names.CMM].text()
    assert 'the node ended while it measured ball 1 at table position 1: the machine may have been moving' in said
    assert f'check-cmm --recover --domain {module_domain_id}\n' in said
    commands = served.server.commands
    commands.tool, commands.cmm.is_homed = 'RefTool', False
    success, words = trigger(client, names.RECOVER)
    assert not success
    assert 'expected a homed machine' in words
    commands.cmm.is_homed = True
    assert trigger(client, names.RECOVER) == (
        True, 'errors are cleared, or the server is connected anew: the machine is ready')
    assert served.server.sessions == sessions + 2  # one for each time that a person has looked
    wait_until(lambda: "expected the tool 'Probe1' in use, found \"RefTool\"" in cell.processes[names.CMM].text())
    assert served.when(MOVE, began) is None
    with served.slow(), CellClient(module_domain_id) as other:
        def insist():
            while served.when('< .* ChangeTool', began) is None:  # refused until all have heard that it is well again
                quietly(client.calibrate, 'row')

        thread = threading.Thread(target=insist)
        thread.start()
        wait_until(lambda: served.when('< .* ChangeTool', began))
        assert trigger(other, names.CANCEL_CALIBRATION)[0]
        cancelled = time.monotonic()
        wait_until(lambda: served.when('< E.* AbortE', began))
        assert served.when('< E.* AbortE', began) < cancelled + soon(cancelled)
        thread.join()
        assert served.when(MOVE, served.when('< E.* AbortE', began)) is None
    assert client.calibrate('row').success
    assert commands.tool == 'Probe1'


def test_the_end_of_the_node_aborts(cell, client, served, wait_until, soon):
    """AbortE within 0.2 s of SIGINT, EndSession after it, exit code 0."""
    with served.slow():
        began = time.monotonic()
        threading.Thread(target=quietly, args=(client.calibrate, 'row'), daemon=True).start()
        wait_until(lambda: served.when('< .* PtMeas', began))
        ended = time.monotonic()
        cell.processes[names.CMM].end(signal.SIGINT)
        wait_until(lambda: cell.processes[names.CMM].has_ended)
        aborted = served.when('< E.* AbortE', ended)
        assert aborted < ended + soon(ended)
        assert served.when('< .* EndSession', aborted)
        assert served.when(MOVE, aborted) is None
        assert cell.processes[names.CMM].popen.returncode == 0


def test_a_node_whose_parent_has_ended(served, domain_id, cell, wait_until, tmp_path, soon):
    """AbortE within 0.2 s of the end of the process that started the node, however it ended; EndSession after it."""
    cell.processes[names.CMM].end(signal.SIGINT)  # the server has room for one client
    wait_until(lambda: cell.processes[names.CMM].has_ended)
    parent = subprocess.Popen(
        [sys.executable, '-c', 'import os, subprocess, sys, time\n'
         f'os.environ[{names.PARENT_PID!r}] = str(os.getpid())\n'
         'subprocess.Popen(sys.argv[1:])\ntime.sleep(600)', sys.executable, '-m', DME_CMM, '--ros-args', '-r',
         f'__ns:=/{names.NAMESPACE}', '-p', f'settings:={served.settings}'], env=cell_environment(domain_id))

    class Interrupted(CmmClient):
        def _is_answered(self, target):
            if served.when('< .* PtMeas', began):
                raise KeyboardInterrupt
            return super()._is_answered(target)

    with served.slow(), Interrupted(domain_id) as asking:
        began = time.monotonic()
        wait_until(asking._is_there)
        with contextlib.suppress(KeyboardInterrupt):
            asking.check(asking.settings({'plate.balls': N}), 2)
        ended = time.monotonic()
        parent.kill()
        parent.wait()
        wait_until(lambda: served.when('< E.* AbortE', began))
        assert ended < served.when('< E.* AbortE', began) < ended + soon(ended)
        wait_until(lambda: served.when('< .* EndSession', ended))
        assert served.when(MOVE, served.when('< E.* AbortE', began)) is None
    assert not StopMark(served.settings).read()


def quietly(call, *arguments):
    """Call what may fail because the cell ends."""
    with contextlib.suppress(Exception):
        call(*arguments)


def refused(client, words):
    """Ask until it is refused in these words: of a node that was restarted the sequencer hears a little later."""
    while True:
        try:
            assert not client.calibrate('row').success
        except CellError as error:
            if re.search(f'calibration refused: .*{words}', str(error)):
                return


def resumed(client, outcome):
    """Resume a run when the sequencer has heard that a person has looked."""
    while True:
        try:
            return client.calibrate(resume=str(outcome.log))
        except CellError as error:
            assert 'a person has to look' in str(error)


@pytest.mark.parametrize(('changes', 'words'), [
    ({}, 'settings: expected the path of a settings file (rosette-dme/1), found none'),
    ({'path': {'stand_off_mm': 8.0, 'clearance_mm': 40.0, 'box_low_mm': [0, 0, 0], 'box_high_mm': [1, 1, 1]}},
     'table position 1, ball 1: above the ball: expected a tip within the box')])
def test_nodes_that_cannot_run(ros, tmp_path, changes, words, capfd):
    """No settings, or paths that are not safe: one line, exit code 2, nothing is connected."""
    path = tmp_path / 'dme.yaml'
    path.write_text(yaml.safe_dump({**SETTINGS, **changes}), encoding='utf-8')
    assert main(['--ros-args', *(['-p', f'settings:={path}'] if changes else [])]) == 2
    assert words in capfd.readouterr().err

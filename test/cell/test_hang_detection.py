# SPDX-License-Identifier: Apache-2.0
"""Nodes whose processes live and publish no status: found, ended, restarted; a run goes on."""

import signal
import time
from types import SimpleNamespace

import pytest

from rosette_ros.cell.client import _DISCONNECTED as DISCONNECTED
from rosette_ros.cell.client import CellClient, HangDetector
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.nodes import names, qos

pytestmark = pytest.mark.long

N, SILENT = 4, 20
LONG, SHORT = qos.STATUS_HANGS + 0.1, qos.STATUS_LOST - 0.1


@pytest.mark.parametrize(('recorder', 'cmm', 'hanging'), [
    (('recorder 71 ab', SHORT), ('cmm 72 cd', LONG), [names.CMM]),
    (('recorder 71 ab', SHORT), ('cmm 72 cd', qos.STATUS_HANGS - 0.1), []),
    (('recorder 71 ab', SHORT), ('cmm 7 cd', LONG), []),  # the one before: this one is still loading its modules
    (('recorder 71 ab', SHORT), ('', LONG), []),
])
def test_a_node_hangs_that_was_heard_and_is_not_while_others_are(monkeypatch, recorder, cmm, hanging):
    """Only the process that was started here, and only while statuses of others are received."""
    now = 1000.0
    monkeypatch.setattr('rosette_ros.cell.client.time', SimpleNamespace(monotonic=lambda: now))
    detector = HangDetector.__new__(HangDetector)
    detector._processes = {name: SimpleNamespace(popen=SimpleNamespace(pid=pid))
                           for name, pid in (('recorder', 71), ('cmm', 72))}
    monitors = detector._monitors = [SimpleNamespace(peer=name, process=process, silence=silence) for name, (
        process, silence) in (('recorder', recorder), ('cmm', cmm))]
    detector._heard_none = now - LONG
    assert detector.hanging() == hanging
    monitors[0].silence = LONG  # this process receives nothing, or all stood still together
    assert detector.hanging() == []
    monitors[0].silence = SHORT  # the first that is heard again
    assert detector.hanging() == []
    now += LONG
    assert detector.hanging() == hanging


def test_a_run_goes_on_when_its_recorder_and_evaluator_hang(cell_of, domain_id, wait_until):
    """SIGSTOP in the middle: both are ended and restarted, in words, and the run ends with all its readings."""
    words = {}
    made = cell_of(N, sequencer={'state_rate_hz': 1e4}, groups={'faults': [{'kind': 'silent', 'at': [SILENT]}]})
    with made as cell, HangDetector(cell) as detector, CellClient(domain_id) as client:
        wait_until(lambda: all(monitor.process for monitor in detector._monitors))
        stopped = {name: cell.processes[name].popen for name in (names.RECORDER, names.EVALUATOR)}

        def look(progress):
            for popen in stopped.values() if progress.done == SILENT - 1 else ():  # here the CMM lets the run wait
                popen.send_signal(signal.SIGSTOP)

        outcome = client.calibrate(on_progress=look, options='limits.answer_timeout_s: 5.0',
                                   check=lambda: words.update(cell.restart_failed(detector.hanging())))
        assert outcome.success, outcome.message
        assert words == {name: f'node {name} was running (process {popen.pid}) but published no status for 20 s and '
                         'was ended by SIGKILL' for name, popen in stopped.items()}
        assert outcome.log.name.endswith('_part2')
        assert read_log(outcome.log).to_run().size == N * N


def test_a_run_of_a_cell_that_was_suspended_goes_on(cell_of, domain_id):
    """All nodes, until they have left the graph: their client gave up after 3 s, and advised to resume what runs."""
    stopped, gone = [], []
    with cell_of(N, params={'cmm': {'answer_s': 0.1}}) as cell, CellClient(domain_id) as client:

        def tell(number):
            for process in cell.processes.values():
                process.popen.send_signal(number)

        def look(progress):
            if progress.done >= SILENT and not stopped:
                stopped.append(True)
                tell(signal.SIGSTOP)

        def wake():
            if stopped and not gone and not client._action.server_is_ready():
                gone.append(time.monotonic())
            if gone and gone[0] and time.monotonic() - gone[0] > 2 * DISCONNECTED:
                gone[0] = 0.0
                tell(signal.SIGCONT)

        outcome = client.calibrate(on_progress=look, check=wake, options='limits.answer_timeout_s: 5.0')
        assert stopped and gone == [0.0]
    assert outcome.success, outcome.message
    assert read_log(outcome.log).to_run().size == N * N


def test_what_is_refused_names_nodes_that_hang(cell_of, domain_id, wait_until):
    """A node that has been there is not to be started: it has ended or hangs, and who restarts it is said."""
    restart = 'wait 30 s for rosette cell to restart it, or restart it'
    missing = '; '.join(f'{words}, found none; it has ended or hangs: {restart}' for words in (
        'no CMM: expected one that subscribes to probe_target and publishes ball_centre',
        'no evaluator: expected one that publishes error_motions',
        'no recorder: expected its service recorder/start_recording'))
    with cell_of(N) as cell:
        sequencer = cell.processes[names.SEQUENCER]
        others = [process.popen for process in cell.processes.values() if process is not sequencer]
        for popen in others:
            popen.send_signal(signal.SIGSTOP)
        wait_until(lambda: missing in sequencer.text())
        with CellClient(domain_id) as client, pytest.raises(CellError, match=f'calibration refused: {missing}'):
            client.calibrate()
        for popen in others:
            popen.send_signal(signal.SIGCONT)
        sequencer.popen.send_signal(signal.SIGSTOP)
        with CellClient(domain_id) as client, pytest.raises(CellError, match='found only cmm, evaluator, recorder: the '
                                                            f'sequencer is not started, has ended or hangs; {restart}'):
            client.wait()
        sequencer.popen.send_signal(signal.SIGCONT)

# SPDX-License-Identifier: Apache-2.0
"""A cell that is watched: what dies comes back, and nothing outlives the one who started it."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from rclpy.context import Context

from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES, MOST_FAILURES, Cell, NodeProcess
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.nodes import names

pytestmark = pytest.mark.long

N = 4


@pytest.mark.parametrize(('code', 'last', 'words'), [
    (-9, '[ERROR] [1.0] [rosette.recorder]: start_recording refused: no room', 'was ended by SIGKILL'),
    (-11, 'Fatal Python error: Segmentation fault', 'was ended by SIGSEGV: Fatal Python error: Segmentation fault'),
    (2, '[ERROR] [1.0] [rosette.cmm]: no file', 'ended with exit code 2: [ERROR] [1.0] [rosette.cmm]: no file')])
def test_why_a_node_ended(tmp_path, code, last, words):
    """An error of an earlier run is not why a node was killed."""
    output = tmp_path / 'recorder.log'
    output.write_text(f'{last}\n[INFO] [2.0] [rosette.recorder]: log opened\n')
    assert NodeProcess('recorder', SimpleNamespace(returncode=code, pid=1), output, 0).failure() == (
        f'node recorder {words}')


def test_a_parameter_file_may_have_whole_numbers_beside_floats(tmp_path):
    """ROS itself takes no such list."""
    path = tmp_path / 'cell.yaml'
    for numbers, is_given in (('[0.35, 0.26, 0]', False), ('[0.35, 0.26, 0.0]', True)):
        path.write_text(f'/**/sequencer: {{ros__parameters: {{table: {{origin_m: {numbers}}}}}}}')
        with Cell(nodes=(), params_file=path, output_dir=tmp_path / 'output') as cell:
            cell.nodes, cell._params = [names.SEQUENCER], {names.SEQUENCER: {}}
            arguments = cell._command(names.SEQUENCER)
        assert (str(path) in arguments) == is_given
        context = Context()
        context.init(arguments)
        context.shutdown()


@pytest.fixture(scope='module')
def watched(module_domain_id, make_cell, tmp_path_factory):
    """Yield (cell, domain)."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('watched'), N) as cell:
        yield cell, module_domain_id


def kill(cell, name):
    """Kill a node and start it again; return the words for a person."""
    cell.processes[name].popen.send_signal(signal.SIGKILL)
    cell.processes[name].popen.wait(60)
    return cell.restart_failed()


@pytest.mark.parametrize('name', MODULES)
def test_a_node_that_was_killed_comes_back_and_the_cell_calibrates(watched, wait_until, name):
    """Any of the four; its exit code is told."""
    cell, domain = watched
    assert cell.restart_failed() == {}
    words = kill(cell, name)
    assert list(words) == [name]
    assert f'node {name} was ended by SIGKILL' in words[name]
    wait_until(lambda: cell.processes[name].output.read_text(errors='replace').count(names.READY) == 2)
    with CellClient(domain) as client:
        outcome = _calibrated(client, cell, wait_until)
    assert read_log(outcome.log).to_run().size == N * N


def _calibrated(client, cell, wait_until):
    """Return the Outcome of the first calibration that succeeds: a node that has just come back may
    still be getting connected, and then the cell refuses, or says which answers it has missed."""
    outcomes = []

    def succeeded():
        with contextlib.suppress(CellError):
            outcomes.append(client.calibrate(check=cell.check,
                                             options='limits.evaluation_timeout_s: 5.0'))
        return outcomes and outcomes[-1].success

    wait_until(succeeded, 60)
    return outcomes[-1]


def test_a_node_that_dies_again_and_again_is_given_up_in_words(watched):
    """What kills it would only kill it again."""
    cell, _ = watched
    with pytest.raises(CellError, match=f'it failed {MOST_FAILURES} times within 60 s and is not restarted'):
        for _ in range(MOST_FAILURES):
            kill(cell, names.EVALUATOR)


def children(pid):
    """Return the processes that a process has started."""
    text = Path(f'/proc/{pid}/task/{pid}/children').read_text()
    return [int(one) for one in text.split()]


def is_alive(pid):
    """Return whether a process runs."""
    try:
        return 'State:\tZ' not in Path(f'/proc/{pid}/status').read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def cell_command(domain_id, tmp_path, wait_until):
    """Yield the process of `rosette cell` that is running, and the nodes' processes."""
    output = tmp_path / 'cell.log'
    with open(output, 'wb') as stream:
        process = subprocess.Popen(
            [sys.executable, '-m', 'rosette_ros.cli.main', 'cell', '--domain', str(domain_id), '-o',
             str(tmp_path / 'runs')], stdout=stream, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        wait_until(lambda: 'The cell is running' in output.read_text())
        yield process, output
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def test_no_node_outlives_a_cell_that_was_killed(cell_command, wait_until):
    """kill -9 of the command: its nodes end by themselves."""
    process, _ = cell_command
    nodes = children(process.pid)
    assert len(nodes) == len(MODULES)
    process.kill()
    wait_until(lambda: not any(map(is_alive, nodes)))


def test_no_node_outlives_a_cell_that_is_asked_to_end(cell_command):
    """Not even one that is suspended and takes no signal: the recorder was left behind."""
    process, output = cell_command
    nodes = children(process.pid)
    recorder = next(one for one in nodes if b'nodes.recorder' in Path(f'/proc/{one}/cmdline').read_bytes())
    os.kill(recorder, signal.SIGSTOP)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 128 + signal.SIGTERM, output.read_text()
    assert not any(map(is_alive, nodes))


def test_a_process_that_spins_ends_with_its_own_exit_code(domain_id):
    """Whatever ends it before it has left the graph: a thread that Python ended within rclpy aborted it."""
    code = ('import sys\nfrom rosette_ros.cell.client import GraphClient\n'
            'from rosette_ros.nodes.base_node import make_executor\n'
            f'GraphClient("left", {domain_id}, "rosette", make_executor).spin_beside("spin")\nsys.exit(3)')
    ended = subprocess.run([sys.executable, '-c', code], stderr=subprocess.PIPE, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (3, '')


def test_the_command_restarts_and_ends_in_order(cell_command, wait_until):
    """A killed node is told and comes back; SIGTERM ends all of it in order."""
    process, output = cell_command
    victim = children(process.pid)[0]
    os.kill(victim, signal.SIGKILL)
    wait_until(lambda: 'was ended by SIGKILL' in output.read_text())
    assert '; restarted' in output.read_text()
    wait_until(lambda: len(children(process.pid)) == len(MODULES))
    nodes = children(process.pid)
    process.send_signal(signal.SIGTERM)  # a shell may have told its children to ignore SIGINT
    assert process.wait(60) == 128 + signal.SIGTERM
    assert not any(map(is_alive, nodes))

# SPDX-License-Identifier: Apache-2.0
"""CMMs that are not ours: they speak probe_target and ball_centre, nothing else."""

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rosette_ros.calibration.settings import parse_settings
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import cell_environment
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.nodes import names

pytestmark = pytest.mark.long

pytest.importorskip('cyclonedds')

N = 3
SCRIPT = Path(__file__).parent / 'cyclone_cmm.py'
DOCUMENT = Path(__file__).parents[2] / 'docs' / 'real-cmm.md'
PROGRAMS = re.findall(r'```python\n(.*?)```', DOCUMENT.with_name('interfaces.md').read_text(encoding='utf-8'),
                      re.DOTALL)
OPTIONS = '{limits.answer_timeout_s: 2.0, limits.attempts: 10}'


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell without a CMM, in wall time."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, simulated_time=False,
                   nodes=('recorder', 'evaluator', 'sequencer')) as running:
        yield running


@contextlib.contextmanager
def process_of(cell, wait_until, *command, **settings):
    """Yield a CMM in a process of its own, once the sequencer finds the cell complete."""
    before = len(cell.processes['sequencer'].text())
    with subprocess.Popen([sys.executable, *map(str, command)], **settings) as process:
        try:
            wait_until(lambda: names.COMPLETE in cell.processes['sequencer'].text()[before:])
            yield process
        except BaseException:
            process.kill()
            raise


def run_with(cmm, cell, domain, wait_until, **goal):
    """Run calibrations until one succeeds; return its Outcome.

    A CMM without a status does not know whom it has found: those that have not found it yet miss its first answers.
    """
    outcomes = []

    def succeeded():
        with contextlib.suppress(CellError):
            outcomes.append(client.calibrate(options=OPTIONS, check=cell.check, **goal))
        assert cmm.poll() is None
        return outcomes and outcomes[-1].success

    with CellClient(domain) as client:
        wait_until(succeeded, 120)
    return outcomes[-1]


@pytest.fixture
def cyclone_cmm(cell, module_domain_id, wait_until):
    """Run a CMM on another DDS in a process without ROS."""
    settings = re.search('```xml\n(.*?)```', DOCUMENT.read_text(), re.DOTALL)[1]
    environment = {**os.environ, 'CYCLONEDDS_URI': settings}
    with process_of(cell, wait_until, SCRIPT, module_domain_id, 'rosette', stdin=subprocess.PIPE,
                    env=environment) as process:
        yield process
        process.stdin.close()
        assert process.wait(60) == 0


def test_cyclone_dds_takes_the_place_of_the_simulated_cmm(cyclone_cmm, cell, module_domain_id, wait_until):
    """A whole calibration with a CMM on Cyclone DDS: every ball is taken, logged and evaluated."""
    outcome = run_with(cyclone_cmm, cell, module_domain_id, wait_until)
    log = read_log(outcome.log)
    assert {answer.text for answer in log.answers} == {'cyclone'}
    assert log.to_run().is_complete
    # Every ball lies where it is expected once the table, 1 mm beside, is found: no deviations.
    assert np.abs(outcome.error_motions.values).max() < 1e-12
    frame = log.frames[-1].frame
    assert frame.origin == pytest.approx([0.351, 0.2595, -0.2998], abs=1e-12)


@pytest.fixture
def ten_lines(cell, module_domain_id, tmp_path, wait_until):
    """Run the first program of docs/interfaces.md as it stands there."""
    script = tmp_path / 'ten_lines.py'
    script.write_text(PROGRAMS[0], encoding='utf-8')
    with process_of(cell, wait_until, script, '--ros-args', '-r', '__ns:=/rosette',
                    env=cell_environment(module_domain_id)) as process:
        yield process
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_ten_lines_are_a_cmm_and_a_bridge_starts_it(ten_lines, cell, module_domain_id, wait_until, tmp_path):
    """Both programs of docs/interfaces.md: a calibration in the order and until what the bridge sets, and its result
    there; a parameter that is none is refused in words."""
    outcome = run_with(ten_lines, cell, module_domain_id, wait_until)
    run = read_log(outcome.log).to_run()
    assert run.is_complete and np.abs(outcome.error_motions.values).max() < 1e-12
    moved = np.diff(run.table_travel)
    assert np.any(moved) and np.all((np.sign(moved) == run.approach[1:]) | (moved == 0))
    script = tmp_path / 'bridge.py'
    script.write_text(PROGRAMS[1], encoding='utf-8')
    done = subprocess.run([sys.executable, script], env=cell_environment(module_domain_id), capture_output=True,
                          text=True, timeout=120, check=True)
    begun, ended, found = done.stdout.splitlines()
    run_id = begun.removeprefix('True ')
    assert begun.startswith('True ') and ended.startswith('True ') and found.startswith(run_id)
    log = read_log(cell.log_dir / run_id)
    assert log.to_run(run_id).is_complete and log.asked[run_id][0] == 0.95
    settings = next(event.settings for event in log.events if event.settings)
    assert {'order': 'diagonal', 'until.probability': 0.95, 'until.most_readings': 60}.items() <= parse_settings(
        settings, run_id).items()
    script.write_text(PROGRAMS[1].replace("'order': 'diagonal'", "'order': 'diagonl'"), encoding='utf-8')
    done = subprocess.run([sys.executable, script], env=cell_environment(module_domain_id), capture_output=True,
                          text=True, timeout=120, check=False)
    assert done.returncode == 1 and "order: expected one of" in done.stderr and 'diagonl' in done.stderr


def test_a_cmm_without_a_status_that_is_killed_and_started_again_was_restarted(cell, module_domain_id, tmp_path,
                                                                                wait_until):
    """Its process before is on the graph for a while: that is no second CMM, and the run goes on in a new session."""
    (code,) = re.findall(r'```python\n(.*?)```', DOCUMENT.read_text(encoding='utf-8'), re.DOTALL)
    script = tmp_path / 'my_cmm.py'
    script.write_text(code.replace('        step = (', '        __import__("time").sleep(0.3)\n        step = (', 1),
                      encoding='utf-8')
    command = [sys.executable, script, '--ros-args', '-r', '__ns:=/rosette']
    started, said = [], len(cell.processes['sequencer'].text())

    def strike(progress):
        if len(started) == 1 and progress.done >= 4:
            started[0].kill()
            started.append(subprocess.Popen(command, env=cell_environment(module_domain_id)))

    with process_of(cell, wait_until, *command[1:], env=cell_environment(module_domain_id)) as process, CellClient(
            module_domain_id) as client:
        started.append(process)
        outcome = client.calibrate(on_progress=strike, check=cell.check,
                                   options='{limits.answer_timeout_s: 30.0, limits.return_timeout_s: 60.0}')
        started[-1].send_signal(signal.SIGINT)
    told = cell.processes['sequencer'].text()[said:]
    assert outcome.success, outcome.message
    assert '/rosette/cmm was restarted, and its process before leaves the graph within 20 s' in told
    assert 'the CMM is disconnected; the run waits for it' in told and 'the run continues in session 2' in told
    assert 'nodes publish' not in told and 'nodes publish' not in outcome.message
    assert read_log(outcome.log).to_run().is_complete
    assert started[-1].wait(60) == 0


@pytest.fixture
def documented_cmm(cell, module_domain_id, tmp_path, wait_until):
    """Run the example of the document as it stands there."""
    (code,) = re.findall(r'```python\n(.*?)```', DOCUMENT.read_text(encoding='utf-8'), re.DOTALL)
    script = tmp_path / 'my_cmm.py'
    script.write_text(code, encoding='utf-8')
    with process_of(cell, wait_until, script, '--ros-args', '-r', '__ns:=/rosette',
                    env=cell_environment(module_domain_id)) as process:
        yield process
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def test_documented_example_takes_the_place_of_the_simulated_cmm(documented_cmm, cell, module_domain_id, wait_until):
    """What docs/real-cmm.md says is enough, for a run that goes on until nothing is open, too."""
    outcome = run_with(documented_cmm, cell, module_domain_id, wait_until, until_probability=0.95)
    assert 'settled: ' in outcome.message
    run = read_log(outcome.log).to_run()
    assert run.is_complete
    assert np.abs(outcome.error_motions.values).max() < 1e-12
    assert np.ptp(run.table_travel) > np.pi

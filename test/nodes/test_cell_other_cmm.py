# SPDX-License-Identifier: Apache-2.0
"""CMMs that are not ours: they speak probe_target and ball_centre, nothing else."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rosette_ros.core.errors import CellError
from rosette_ros.data.log_reader import read_log
from rosette_ros.nodes.cell import cell_environment
from rosette_ros.nodes.client import CellClient

pytest.importorskip('cyclonedds')

N = 3
SCRIPT = Path(__file__).parent / 'cyclone_cmm.py'
ONLY_THIS_COMPUTER = """
<CycloneDDS><Domain Id="any">
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
    <Peers><Peer Address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>
"""


DOCUMENT = Path(__file__).parents[2] / 'docs' / 'real-cmm.md'
OPTIONS = '{limits.answer_timeout_s: 2.0, limits.attempts: 10}'


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell without a CMM, in wall time."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, simulated_time=False,
                   nodes=('recorder', 'evaluator', 'sequencer')) as running:
        yield running


def run_with(cmm, cell, domain):
    """Run a calibration with a CMM in another process, once it is seen; return its Outcome."""
    with CellClient(domain) as client:
        for _ in range(30):
            with contextlib.suppress(CellError):
                outcome = client.calibrate(options=OPTIONS, check=cell.check)
                break
            time.sleep(1.0)
    assert outcome.success, outcome.message
    assert cmm.poll() is None
    return outcome


@pytest.fixture
def cyclone_cmm(module_domain_id):
    """Run a CMM on another DDS in a process without ROS."""
    environment = {**os.environ, 'CYCLONEDDS_URI': ONLY_THIS_COMPUTER}
    process = subprocess.Popen([sys.executable, str(SCRIPT), str(module_domain_id), 'rosette'],
                               stdin=subprocess.PIPE, env=environment)
    yield process
    process.stdin.close()
    assert process.wait(20) == 0


def test_cyclone_dds_takes_the_place_of_the_simulated_cmm(cyclone_cmm, cell, module_domain_id):
    """A whole calibration with a CMM on Cyclone DDS: every ball is taken, logged and evaluated."""
    outcome = run_with(cyclone_cmm, cell, module_domain_id)
    log = read_log(outcome.log)
    assert set(log.answers.text) == {'cyclone'}
    assert log.to_run().is_complete
    # Every ball lies where it is expected once the table, 1 mm beside, is found: no deviations.
    assert np.abs(outcome.error_motions.values).max() < 1e-12
    frame = log.frames[-1].frame
    assert frame.origin == pytest.approx([0.351, 0.2595, -0.2998], abs=1e-12)


@pytest.fixture
def documented_cmm(module_domain_id, tmp_path):
    """Run the example of the document as it stands there."""
    (code,) = re.findall(r'```python\n(.*?)```', DOCUMENT.read_text(encoding='utf-8'), re.DOTALL)
    script = tmp_path / 'my_cmm.py'
    script.write_text(code, encoding='utf-8')
    process = subprocess.Popen(
        [sys.executable, str(script), '--ros-args', '-r', '__ns:=/rosette'],
        env=cell_environment(module_domain_id))
    # It answers within a millisecond, so every part must have found it before the first target.
    time.sleep(5.0)
    yield process
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0


def test_documented_example_takes_the_place_of_the_simulated_cmm(documented_cmm, cell,
                                                                 module_domain_id):
    """What docs/real-cmm.md says is enough."""
    outcome = run_with(documented_cmm, cell, module_domain_id)
    run = read_log(outcome.log).to_run()
    assert run.is_complete
    assert np.abs(outcome.error_motions.values).max() < 1e-12
    assert run.table_travel[-1] > run.table_travel[0]

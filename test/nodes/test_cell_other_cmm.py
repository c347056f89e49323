# SPDX-License-Identifier: Apache-2.0
"""A CMM of another maker: it speaks probe_target and ball_centre over another DDS, nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rosette_ros.data.log_reader import read_log
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


@pytest.fixture
def cyclone_cmm(domain_id):
    """Run the other CMM in a process without ROS."""
    environment = {**os.environ, 'CYCLONEDDS_URI': ONLY_THIS_COMPUTER}
    process = subprocess.Popen([sys.executable, str(SCRIPT), str(domain_id), 'rosette'],
                               stdin=subprocess.PIPE, env=environment)
    yield process
    process.stdin.close()
    assert process.wait(20) == 0


def test_cyclone_dds_takes_the_place_of_the_simulated_cmm(cyclone_cmm, cell_of, domain_id,
                                                          wait_until):
    """A whole calibration with a CMM on Cyclone DDS: every ball is taken, logged and evaluated."""
    nodes = ('recorder', 'evaluator', 'sequencer')
    with cell_of(N, nodes=nodes, simulated_time=False) as cell, CellClient(domain_id) as client:
        wait_until(lambda: 'the cell is complete' in cell.output('sequencer'))
        outcome = client.calibrate(
            options='{limits.answer_timeout_s: 2.0, limits.attempts: 10}', check=cell.check)
    assert outcome.success, outcome.message
    assert cyclone_cmm.poll() is None
    log = read_log(outcome.log)
    assert set(log.answers.text) == {'cyclone'}
    run = log.to_run()
    assert run.is_complete
    # Every ball lies where it is expected once the table, 1 mm beside, is found: no deviations.
    assert np.abs(outcome.error_motions.values).max() < 1e-12
    frame = log.frames[-1].frame
    assert frame.origin == pytest.approx([0.351, 0.2595, -0.2998], abs=1e-12)

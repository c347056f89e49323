# SPDX-License-Identifier: Apache-2.0
"""Runs that have measured everything and are resumed, because recorder or sequencer ended before the log was closed."""

import numpy as np
import pytest

from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log

FOOT = 8  # bytes by which a closed log ends


def test_a_run_whose_log_was_not_closed_ends_in_success(domain_id, cell_of):
    """From its log: nothing is measured again. A run whose log was closed is refused."""
    with cell_of(3) as cell, CellClient(domain_id) as client:
        done = client.calibrate('row', check=cell.check)
        assert done.success, done.message
        with pytest.raises(CellError, match='lacks nothing: it ended in success and its log is closed'):
            client.calibrate(resume=done.run_id)
        file = done.log / f'{done.run_id}_0.mcap'
        file.write_bytes(file.read_bytes()[:-FOOT])
        resumed = client.calibrate(resume=done.run_id)
        assert resumed.success, resumed.message
    assert np.array_equal(resumed.error_motions.values, done.error_motions.values)
    log = read_log(resumed.log)
    assert log.path.name == f'{done.run_id}_part2' and log.problems == ()
    assert {target.session for target in log.runs[done.run_id].targets} == {1}

# SPDX-License-Identifier: Apache-2.0
"""RUN as a joint evaluation takes it: with the table frame of a log, and with the plate file of a table."""

from pathlib import Path

from rosette_ros.core.joint.readings import Readings
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import is_log, open_run


def open_readings(path: str | Path, run_id: str | None = None) -> Readings:
    """Return the Readings of a log directory, an .mcap file or a CSV table; raises InvalidData as open_run."""
    run = open_run(path, run_id)
    return Readings.of(run, read_log(path).frame_of(run.run_id) if is_log(path) else None)

# SPDX-License-Identifier: Apache-2.0
"""Many logs for an archive, made quickly: complete runs from the equation, every fourth with a drift of the frame."""

import os
import sys
from pathlib import Path

import numpy as np

from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.type_definitions import TypeLibrary

RADIUS, NOISE, DRIFT = 0.1825, 2e-7, 2e-6
SECONDS = 30.0  # from reading to reading


def made_run(number: int, n: int = 12) -> Run:
    """Return run `number`: errors of table, plate and CMM of some µm, noise of 0.2 µm, which is stated."""
    scheme, rng = plan(n, 'random', 1), np.random.default_rng(number)
    motion, plate, cmm = (1e-6 * rng.standard_normal((n, 3)) for _ in range(3))
    centre = (scheme.centres(RADIUS) + motion[scheme.table_position - 1]
              + rotate_z(scheme.table_angle, plate[scheme.ball - 1]) + cmm[scheme.cmm_position - 1]
              + NOISE * rng.standard_normal((n * n, 3)))
    time = SECONDS * np.arange(n * n)
    if number % 4 == 3:
        centre[:, 0] += DRIFT * time / time[-1]
    return Run(n, RADIUS, scheme.table_position, scheme.ball, centre, approach=scheme.approach, time=time,
               temperature=20 + 0.1 * rng.random(n * n), repeatability=NOISE, repeatability_dof=27,
               run_id=f'run_{number:06d}', simulated=True)


def make_logs(folder: Path, numbers: range, n: int = 12) -> list[Path]:
    """Write the logs (MCAP) of some runs, a directory each, and return their paths."""
    library = TypeLibrary((os.environ.get('AMENT_PREFIX_PATH') or sys.prefix).split(os.pathsep))
    return [write_log(made_run(number, n), folder / f'run_{number:06d}', library) for number in numbers]

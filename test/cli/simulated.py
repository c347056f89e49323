# SPDX-License-Identifier: Apache-2.0
"""Runs of the simulated machine as ball-centre tables, made once for all tests."""

import functools
import tempfile
from pathlib import Path

from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [2.5, 0.0, 1.5]}
WARP = {'kind': 'plate_warp', 'rate_um_per_h': 2.0}
SLIP = {'kind': 'ball_slip', 'ball': 4, 'shift_um': [1.5, 1.0, 0.5], 'at_h': 0.55}
WARM_UP = {'kind': 'frame_warmup', 'amplitude_um': [0.5, 0.0, -0.5], 'time_constant_h': 0.3}
HIDDEN = {'drift': [DRIFT], 'weak_warm_up': [WARM_UP], 'drift_and_warp': [DRIFT, WARP], 'slip': [SLIP], 'clean': []}
_FOLDER = tempfile.TemporaryDirectory(prefix='rosette_simulated_')


@functools.cache
def simulated_run(hidden='clean', n=6, order='random', seed=1, turning='forward'):
    """Return a run of a machine that hides the effects of HIDDEN[hidden]."""
    config = MachineConfig().changed(seed=seed, plate={'balls': n}, hidden=HIDDEN[hidden])
    return Machine(config).run(plan(n, order, seed, turning), run_id=f'{hidden}_{seed}')


@functools.cache
def simulated_table(hidden='clean', n=6, order='random', seed=1, turning='forward', **changes):
    """Return the path of the run as a table; changes: other values of the Run."""
    run = simulated_run(hidden, n, order, seed, turning).replace(**changes)
    name = '_'.join(map(str, (hidden, n, order, seed, turning, *changes)))
    path = Path(_FOLDER.name) / f'{name}.csv'
    write_csv(run, path, force=True)
    return path

# SPDX-License-Identifier: Apache-2.0
"""Summaries of simulated runs, made once for all tests."""

import functools

from rosette_ros.analysis import analyse, summarise
from rosette_ros.core.run.scheme import plan
from rosette_ros.presentation.report.provenance import Source
from rosette_ros.simulation import Machine, MachineConfig

HIDDEN = {'clean': [], 'drift': [{'kind': 'frame_drift', 'rate_um_per_h': [2.5, 0.0, 1.5]}],
          'three': [{'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]},
                    {'kind': 'plate_warp', 'rate_um_per_h': 6.0},
                    {'kind': 'ball_slip', 'ball': 5, 'shift_um': [2.0, 1.0, 0.0], 'at_h': 0.5}]}
OFF = {'cmm': {'correction': False}}
CONDITIONS = ({}, {'clamping': {'plate_turn_deg': 90.0}}, OFF, {**OFF, 'table': {'axial_correction': False}},
              {'table': {'angular_correction': False}}, {})
"""The runs of the paper's verification as changes of a machine."""


@functools.cache
def summary_of(hidden='clean', n=8, order='random'):
    """Return the Summary of a simulated run that hides the effects of HIDDEN[hidden]."""
    config = MachineConfig().changed(seed=2, plate={'balls': n}, hidden=HIDDEN[hidden])
    return summarise(Machine(config).run(plan(n, order), run_id=f'{hidden}_{n}'))


@functools.cache
def verification_runs(n=8, seed=4):
    """Return (machine, alignment, Fit, Source) of six runs; machine and noise go on from run to run."""
    out, state = [], None
    for place, changes in enumerate(CONDITIONS, 1):
        machine = Machine(MachineConfig().changed(seed=seed, plate={'balls': n}, **changes), state)
        run, alignment, _ = machine.calibrate(plan(n, 'diagonal'), run_id=f'run {place}')
        state = machine.state
        out.append((machine, alignment, analyse(run), Source(f'{place}.csv', ())))
    return tuple(out)

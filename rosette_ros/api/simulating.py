# SPDX-License-Identifier: Apache-2.0
"""A simulated machine that measures a plan; apart from plans, which start sooner without it."""

from pathlib import Path
from typing import Any

from rosette_ros.api.measurement import Measurement
from rosette_ros.api.plans import Plan
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import ErrorMotions, remove_gauge
from rosette_ros.core.run.scheme import plan as scheme_of
from rosette_ros.simulation import Machine, MachineConfig, load_machine
from rosette_ros.simulation.machine import machine_config


def simulate(machine: Any = None, plan: Any = 'interleaved', run_id: str = '') -> Measurement:
    """Return what a simulated machine measures; its `truth` has the true curves.

    machine: a MachineConfig, its file (docs/machine.md), or what differs from the default machine, such as {'seed': 3,
    'plate': {'balls': 8}, 'hidden': [{'kind': 'frame_drift', 'rate_um_per_h': [6, 0, 4]}]}; plan: a Plan or an order.
    The same machine and plan give the same readings. Raises InvalidConfig, InvalidPlan."""
    config = machine if isinstance(machine, MachineConfig) else (
        MachineConfig() if machine is None else load_machine(machine) if isinstance(machine, str | Path) else
        machine_config(dict(machine), 'machine'))
    scheme = plan.scheme if isinstance(plan, Plan) else scheme_of(config.plate.balls, str(plan), config.seed)
    made = Machine(config)
    run, alignment, _ = made.calibrate(scheme, run_id=run_id)
    run = run.replace(source=run_id or 'simulated machine')
    angle = nominal_angles(run.n) + run.table_offset
    truth = remove_gauge(made.table_truth(angle, alignment.frame))
    return Measurement(run, truth=ErrorMotions(angle, truth, 0.0 * truth, run.rotation))

# SPDX-License-Identifier: Apache-2.0
"""Runs whose truth is known: a machine that measures without noise, displacements of its readings, noise of a kind."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from benchmarks.blind.noise_kinds import Noise, Readings, draw_noise
from rosette_ros.core.geometry import Frame
from rosette_ros.core.records import Floats, Run
from rosette_ros.core.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig

SIGMA = 1e-7
"""Standard deviation of a ball-centre coordinate, m: the unit of all that is hidden."""
CHECK = 15
"""Readings of the repeatability check."""
ORDERS = ('row', 'diagonal', 'column', 'random', 'sensitive')


@dataclass(frozen=True)
class Plan:
    """What a run is made of: number of balls, order, sense of turning, seed of the machine and of all draws."""

    n: int
    order: str
    seed: int
    turning: str = 'forward'

    def generator(self, *what: str) -> np.random.Generator:
        """Return the generator of one part of this run, by its name: a change in one leaves the others."""
        return np.random.default_rng([self.seed, self.n, crc32(':'.join((self.order, self.turning, *what)).encode())])


def machine_config(seed: int, n: int) -> MachineConfig:
    """Return the configuration of a machine that repeats exactly."""
    return MachineConfig().changed(seed=seed, plate={'balls': n}, probing={'repeatability_um': 0.0})


def measure(machine: Machine, made: Plan) -> tuple[Run, Frame]:
    """Return what a machine measures by a plan, after its alignment, and the table frame that it found."""
    run, alignment, _ = machine.calibrate(plan(made.n, made.order, made.seed, made.turning))
    return run, alignment.frame


def noisy(clean: Run, made: Plan, kind: str, stated: bool, shift: Floats | float = 0.0, beside: str = ''
          ) -> tuple[Run, Noise]:
    """Return a run of displaced readings with noise of a kind, and the noise.

    shift: (N, 3), m; stated: whether a repeatability check of CHECK readings of ball 1 before the run is stated with
    it; beside: what is hidden, so that each has noise of its own. Readings of a kind that has a resolution are rounded,
    those of the check too.
    """
    pace = np.ptp(clean.time) / (clean.size - 1)
    one = np.ones(CHECK, dtype=int)
    at = Readings(clean.n, CHECK, np.concatenate([clean.time[0] - pace * np.arange(CHECK, 0, -1), clean.time]),
                  np.concatenate([one, clean.ball]), np.concatenate([one, clean.table_position]))
    noise = draw_noise(kind, at, made.generator('noise', kind, beside))
    first = np.flatnonzero((clean.ball == 1) & (clean.table_position == 1))[:1]
    centre = np.concatenate([np.broadcast_to(clean.centre[first[0] if first.size else 0], (CHECK, 3)),
                             clean.centre + shift]) + SIGMA * noise.offset
    if noise.resolution:
        step = noise.resolution * SIGMA
        centre = step * np.round(centre / step)
    run = clean.replace(centre=centre[CHECK:], repeatability=None, repeatability_dof=None)
    return (state_repeatability(run, centre[:CHECK]) if stated else run), noise


def state_repeatability(run: Run, check: Floats) -> Run:
    """Return the run with the repeatability of a check, (M, 3), m, stated; as it is where the check shows none."""
    if not np.ptp(check, axis=0).any():
        return run  # rounded to more than they scatter: nobody could state that as a repeatability
    square = np.sum((check - check.mean(axis=0))**2, axis=0)
    dof = 3 * (len(check) - 1)
    by_axis = np.sqrt(3 * square / dof).tolist()
    return run.replace(repeatability=float(np.sqrt(square.sum() / dof)), repeatability_dof=dof,
                       repeatability_axes=tuple(by_axis) if min(by_axis) > 0 else None)

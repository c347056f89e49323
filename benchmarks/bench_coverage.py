# SPDX-License-Identifier: Apache-2.0
"""Coverage of the uncertainty budget: how often U (k = 2) contains the true curves of simulated runs.

All contributions act in each run: scatter of touches and of positioning, unequal along the axes, lobed balls, a plate
that grows and a frame that moves with the temperature by coefficients that nobody knows exactly, a table that stands
off and tilted, scales and squareness of the CMM, a plate that was clamped off centre, and a drift that is in the model.
Truth is that of the machine, in its own frame, freed of what no three-rosette run can know.
"""

import numpy as np

from rosette_ros.analysis import analyse
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import CURVES, remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.uncertainty_budget import budget
from rosette_ros.simulation import Machine, machine_config

FORM = 0.25e-6
"""Form of a ball, m."""
INPUTS = BudgetInputs({
    'ball_form': {'form_um': FORM}, 'plate_expansion': {'u_um_per_m_K': 1e-6},
    'frame_expansion': {'u_um_per_K': 0.3e-6},
    'alignment': {'origin_um': 1e-6, 'tilt_urad': 10e-6, 'azimuth_urad': 300e-6}, 'radius': {'u_um': 1e-6}})
LOBES = (2, 3, 4, 5)


def hidden(rng, n):
    """Return what a run hides: contributions drawn as INPUTS state them, and the drift that the model knows."""
    height = 1e6 * FORM / np.sqrt(12) * np.sqrt(2 / len(LOBES))
    lobes = [{'kind': 'ball_lobes', 'ball': ball, 'order': order, 'height_um': float(height * rng.standard_normal()),
              'phase_deg': float(rng.uniform(0, 180))} for ball in range(1, n + 1) for order in LOBES]
    return [*lobes, {'kind': 'plate_expansion', 'coefficient_ppm_per_K': float(rng.standard_normal())},
            {'kind': 'frame_temperature', 'coefficient_um_per_K': (0.3 * rng.standard_normal(3)).tolist()},
            {'kind': 'frame_drift', 'rate_um_per_h': (1.0 * rng.standard_normal(3)).tolist()}]


def covered(n, seed):
    """Return the deviations of a run's curves from the true ones over their u, (n, 6), and its budget."""
    rng = np.random.default_rng([n, seed])
    config = machine_config({'seed': seed + 1, 'plate': {'balls': n},
                             'probing': {'touch_share': float(rng.uniform(0.5, 1))},
                             'climate': {'drift_K_per_h': float(rng.uniform(-0.3, 0.3))}, 'hidden': hidden(rng, n)})
    machine = Machine(config)
    run = machine.run(plan(n, 'random', seed))
    made = budget(analyse(run, Model().with_effect('frame_drift')), INPUTS)
    motions = made.fit.error_motions
    off = motions.values - remove_gauge(machine.table_truth(motions.angle), motions.angle)
    return off / made.combined(), made


def coverage(n, runs):
    """Return the ratios of deviations to standard uncertainties of `runs` runs, (runs, n, 6)."""
    return np.array([covered(n, seed)[0] for seed in range(runs)])


def main():
    """Print coverage by curve for plates of 6 and 12 balls, 200 runs each."""
    for n in (6, 12):
        ratio = coverage(n, 200)
        inside = np.abs(ratio) <= 2
        print(f'{n} balls, {len(ratio)} runs: U (k = 2) contains {100 * inside.mean():.1f} % of the true points; '
              + ', '.join(f'{curve} {100 * share:.1f} %' for curve, share in zip(CURVES, inside.mean(axis=(0, 1))))
              + f'; rms of deviation / u {np.sqrt(np.mean(ratio**2)):.3f}')

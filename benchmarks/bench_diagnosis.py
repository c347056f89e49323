# SPDX-License-Identifier: Apache-2.0
"""Diagnosis with the whole library against a dense least squares per candidate, and of a run that lacks readings."""

import time

import numpy as np

from benchmarks.bench_fit import MISSING, matrix
from rosette_ros.analysis import diagnose, judge
from rosette_ros.core.diagnosis.diagnosis import known_of
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.least_squares import mean_radius, observed
from rosette_ros.core.run.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig

SAMPLE = {12: 24, 36: 3, 72: 1}
"""How many candidates the dense way is timed on; all of them would take minutes to days."""


def hidden_run(n):
    """Return a run of n balls of a machine whose probe drifts."""
    drift = {'kind': 'frame_drift', 'rate_um_per_h': [2.0, 0.0, 1.0]}
    machine = Machine(MachineConfig().changed(plate={'balls': n}, hidden=[drift]))
    return machine.run(plan(n, 'random'))


def candidates(run):
    """Return every effect with every setting that the search tries."""
    return [(effect, setting) for effect in EFFECTS.values() if not effect.unavailable(run)
            for setting in effect.settings(run)]


def dense(run, chosen):
    """Return the square sums that plain least squares leaves with each candidate."""
    design, y = matrix(run, mean_radius(run)).toarray(), observed(run).reshape(-1)
    out = []
    for effect, setting in chosen:
        columns = effect.columns(run, setting).reshape(y.size, -1)
        full = np.hstack([design, columns / np.abs(columns).max()])
        solution = np.linalg.lstsq(full, y, rcond=1e-10)[0]
        out.append(np.sum((y - full @ solution)**2))
    return out


def seconds(function, run):
    """Return the time that a function of a run takes, s, and its result; nothing is known of the run before."""
    known_of.cache_clear()
    start = time.perf_counter()
    result = function(run)
    return time.perf_counter() - start, result


def main():
    """Print times and ratios."""
    print('diagnosis with the whole library and the search-wide probability')
    for n in (12, 36, 72):
        run = hidden_run(n)
        times, verdicts = [], []
        for _ in range(3 if n < 70 else 1):
            verdicts.append(seconds(judge, run)[0])
            taken, found = seconds(diagnose, run)
            times.append(taken)
        every = candidates(run)
        some = [every[k] for k in np.linspace(0, len(every) - 1, SAMPLE[n]).astype(int)]
        start = time.perf_counter()
        dense(run, some)
        plain = (time.perf_counter() - start) / len(some) * len(every)
        print(f'  n = {n:2d}: ours {min(times):.2f} s ({" and ".join(found.missing)}), the verdict alone '
              f'{min(verdicts):.2f} s; dense {plain:.0f} s for {len(every)} candidates ({len(some)} timed), without '
              f'probabilities ({plain / min(times):.0f}x)', flush=True)
    part = run.take(np.sort(np.random.default_rng(n).permutation(n * n)[:round((1 - MISSING) * n * n)]))
    lacking, found = seconds(diagnose, part)
    print(f'  n = {n:2d}, {100 * MISSING:.0f} % of the readings missing: {lacking:.2f} s '
          f'({" and ".join(found.missing)}), {lacking / min(times):.2f} times that of the complete run', flush=True)


if __name__ == '__main__':
    main()

# SPDX-License-Identifier: Apache-2.0
"""Full fit of complete runs and of runs that lack readings against scipy.sparse lsqr and dense lstsq.

The peers give the residual only, ours the uncertainties of the curves too. All use one thread.
"""

import time
import tracemalloc

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from rosette_ros.analysis import analyse
from rosette_ros.core.model.least_squares import fit, mean_radius, observed
from rosette_ros.core.model.model import Model
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan

RADIUS = 0.1825
MISSING = 0.1
"""Share of the readings that an incomplete run lacks."""
MOST_DENSE = 72
"""Larger plates are left out of the dense solution: at 180 balls its columns take 1.5 GB."""


def measured(n, order='diagonal', **reduced):
    """Return a run of n balls with white noise."""
    scheme = plan(n, order, **reduced)
    noise = 1e-7 * np.random.default_rng(n).standard_normal((scheme.ball.size, 3))
    return Run(n, RADIUS, scheme.table_position, scheme.ball, scheme.centres(RADIUS) + noise, approach=scheme.approach,
               repeats=order == 'there_and_back')


def matrix(run, lever):
    """Return the sparse design of table, plate and CMM, (3 N, 12 n), written out by columns."""
    n, size = run.n, run.size
    i, j, k = run.table_position - 1, run.ball - 1, run.cmm_position - 1
    row = 3 * np.arange(size)
    x, y = lever * np.cos(run.alpha), lever * np.sin(run.alpha)
    c, s, one = np.cos(run.phi), np.sin(run.phi), np.ones(size)
    entries = []
    for axis in range(3):
        entries += [(row + axis, 6 * i + axis, one), (row + axis, 9 * n + 3 * k + axis, one)]
    entries += [(row + 2, 6 * i + 3, y), (row + 2, 6 * i + 4, -x), (row, 6 * i + 5, -y),
                (row + 1, 6 * i + 5, x)]
    plate = 6 * n + 3 * j
    entries += [(row, plate, c), (row, plate + 1, -s), (row + 1, plate, s), (row + 1, plate + 1, c),
                (row + 2, plate + 2, one)]
    rows, columns, values = (np.concatenate(part) for part in zip(*entries))
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(3 * size, 12 * n))


def best_of(function, repeats):
    """Return the shortest time of a call, s, and its last result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return min(times), result


def curves_of(run):
    """Return the fit of the base model after its curves and their uncertainties are calculated."""
    fitted = fit(run, Model())
    if not np.isfinite(fitted.error_motions.u).all():
        raise ValueError('expected finite uncertainties')
    return fitted


def incomplete():
    """Print times, ratios and memory of fits of runs that lack a tenth of their readings."""
    print(f'fit with curve uncertainties, {100 * MISSING:.0f} % of the readings missing (seconds, ratio peer / ours)')
    for n in (36, 72, 180, 360):
        whole = measured(n)
        run = whole.take(np.sort(np.random.default_rng(n).permutation(n * n)[:round((1 - MISSING) * n * n)]))
        ours, fitted = best_of(lambda run=run: curves_of(run.replace()), 3)
        tracemalloc.start()
        curves_of(run.replace())
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        words, design, y = [], matrix(run, mean_radius(run)), observed(run).reshape(-1)
        for name, most, solve in (
                ('lsqr', n, lambda a, y: scipy.sparse.linalg.lsqr(a, y, atol=1e-14, btol=1e-14,
                                                                            iter_lim=5000)[0]),
                ('lstsq', MOST_DENSE, lambda a, y: np.linalg.lstsq(a.toarray(), y, rcond=1e-10)[0])):
            if n > most:
                words.append(f'{name} left out, too large')
                continue
            peer, x = best_of(lambda a=design, y=y, solve=solve: solve(a, y), 1)
            off = np.abs(y - design @ x - fitted.residual.reshape(-1)).max()
            words.append(f'{name} {peer:.3f} ({peer / ours:.2g}x, residuals differ by {off:.1e} m)')
        print(f'  n = {n:3d}: ours {ours:.4f}, peak {peak:.0f} MB; {", ".join(words)}', flush=True)


def unequal():
    """Print times and memory of fits where readings have weights, are repeated, or lack in reduced plans."""
    print('fit with curve uncertainties, 1 thread (milliseconds, peak MB)')
    for n in (36, 72, 144):
        whole, half, rng = measured(n), measured(n, cmm_positions=range(1, n // 2 + 1)), np.random.default_rng(n)
        back = measured(n, 'there_and_back')
        wander = np.full(3, 0.3)
        words = []
        for name, run, noise in (
                ('half plan, one lost', half.take(np.arange(1, half.size)), None),
                ('there and back, one lost', back.take(np.arange(1, back.size)), None),
                ('ten repeats', whole.replace(repeats=True).take(np.append(np.arange(n * n), np.arange(10))), None),
                ('weights', whole, Noise(tail='coordinate', tail_dof=4.0, weight=rng.uniform(0.1, 2, (n * n, 3)))),
                ('frame wanders', whole, Noise(phi=0.9, wander=wander))):
            took, _ = best_of(lambda run=run, noise=noise: fit(run.replace(), noise=noise), 2)
            tracemalloc.start()
            fit(run.replace(), noise=noise)
            words.append(f'{name} {1e3 * took:.0f} ({tracemalloc.get_traced_memory()[1] / 1e6:.0f} MB)')
            tracemalloc.stop()
        print(f'  n = {n:3d}: {", ".join(words)}', flush=True)


def main():
    """Print times, ratios and the agreement of the residuals."""
    print('full fit with uncertainties, complete run (seconds, ratio peer / ours)')
    for n in (12, 36, 72):
        run = measured(n)
        lever = mean_radius(run)
        design, y = matrix(run, lever), observed(run).reshape(-1)
        full = design.toarray()
        ours, fit = best_of(lambda run=run: analyse(run), 5)
        sparse, solution = best_of(lambda a=design, y=y: scipy.sparse.linalg.lsqr(
            a, y, atol=1e-14, btol=1e-14, iter_lim=5000)[0], 1 if n > 40 else 3)
        dense_time, dense = best_of(lambda a=full, y=y: np.linalg.lstsq(
            a, y, rcond=1e-10)[0], 1 if n > 20 else 3)
        difference = max(np.abs(y - design @ x - fit.residual.reshape(-1)).max()
                         for x in (solution, dense))
        print(f'  n = {n:3d}: ours {ours:.4f}, lsqr {sparse:.3f} ({sparse / ours:.0f}x), '
              f'lstsq {dense_time:.3f} ({dense_time / ours:.0f}x); '
              f'residuals differ by {difference:.1e} m')
    run = measured(360)
    ours, _ = best_of(lambda: analyse(run), 3)
    tracemalloc.start()
    analyse(run)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    print(f'  n = 360: ours {ours:.3f} s, peak {peak:.0f} MB (129 600 ball centres)')
    incomplete()
    unequal()


if __name__ == '__main__':
    main()

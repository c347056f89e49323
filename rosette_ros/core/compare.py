# SPDX-License-Identifier: Apache-2.0
"""Model against measurement: where it fails, and by how much of sigma."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import special

from rosette_ros.core.atoms import Projection

AXES = ('x', 'y', 'z')
SECTIONS = 12
DRAWS = 400


@dataclass(frozen=True, eq=False)
class Grouping:
    """Residuals grouped by one thing.

    label: what by; keys: (g,) group names; rms: (g, 3) root mean square per axis, m, freed of the
    model's own appetite (expected value sigma under the right model); mean: (g, 3), m; p: chance that
    noise spreads its groups as unevenly.
    """

    label: str
    keys: tuple[str, ...]
    rms: np.ndarray
    mean: np.ndarray
    p: float

    @property
    def worst(self):
        """Index of the group with the largest rms."""
        return int(np.argmax(np.sum(self.rms**2, axis=1)))


@dataclass(frozen=True)
class Reading:
    """One reading that fits badly: number, indices, residual (3,), m, and its size in sigma."""

    number: int
    table_position: int
    ball: int
    cmm_position: int
    residual: tuple[float, float, float]
    size: float
    p: float


@dataclass(frozen=True, eq=False)
class Harmonic:
    """A line of the residual's spectrum that stands out: p waves per turn of table, q of CMM."""

    axis: str
    table_waves: int
    cmm_waves: int
    amplitude: float
    share: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Where a model fails: by axis, table position, ball, CMM position, time and sequence.

    axis_rms: (3,) m; sizes: (N,) residual of each reading, rms over the axes, m, freed of the
    model's own appetite; groupings; neighbour_p: chance that noise leaves neighbours in time as alike;
    worst: readings, worst first; harmonics: strongest lines on complete runs; failing: whether
    anything is missing; summary: one sentence.
    """

    fit: object
    axis_rms: np.ndarray
    sizes: np.ndarray
    groupings: tuple[Grouping, ...]
    neighbour_correlation: float
    neighbour_p: float
    worst: tuple[Reading, ...]
    harmonics: tuple[Harmonic, ...]
    failing: bool
    summary: str


def compare(fit, seed=0):
    """Return the Comparison of a fitted model with its run.

    seed: of the simulated noise that the spreads are judged against; it goes through the same model.
    """
    run = fit.run
    project = Projection(fit.joint, run.size)
    noise = project(np.random.default_rng(seed).standard_normal((DRAWS, run.size, 3)))
    residual = fit.residual
    expected = np.mean(noise**2, axis=0)
    groupings = tuple(_grouping(label, index, keys, residual, noise, expected)
                      for label, index, keys in _indices(run))
    correlation, neighbour_p = _neighbours(residual, noise)
    worst = _worst(run, fit, residual, noise, expected)
    axis_rms = np.sqrt(np.sum(residual**2, axis=0) / np.sum(expected, axis=0))
    sizes = np.sqrt(np.mean(residual**2 / np.maximum(expected, 1e-12), axis=1))
    tests = [neighbour_p, *(grouping.p for grouping in groupings), worst[0].p]
    known = fit.lack_of_fit_p
    lowest = min(tests) * len(tests)
    if known is not None:
        lowest = min(lowest, known * 2)
    failing = bool(lowest < 0.01)
    return Comparison(fit, axis_rms, sizes, groupings, correlation, neighbour_p, worst,
                      _harmonics(fit), failing,
                      _summary(fit, failing, groupings, neighbour_p, axis_rms))


def _indices(run):
    yield 'table position', run.table_position - 1, [str(k + 1) for k in range(run.n)]
    yield 'ball', run.ball - 1, [str(k + 1) for k in range(run.n)]
    yield 'CMM position', run.cmm_position - 1, [str(k + 1) for k in range(run.n)]
    sections = min(SECTIONS, run.size // 3)
    time = run.time - run.time[0]
    edge = np.linspace(0, time[-1] or 1.0, sections + 1)
    section = np.clip(np.searchsorted(edge, time, side='right') - 1, 0, sections - 1)
    yield 'time', section, [f'{a / 60:.0f}-{b / 60:.0f} min' for a, b in pairwise(edge)]
    order = np.arange(run.size) * sections // run.size
    yield 'sequence', order, [f'{np.flatnonzero(order == s)[0] + 1}-'
                              f'{np.flatnonzero(order == s)[-1] + 1}' for s in range(sections)]


def _sums(index, count, values):
    """Return sums of values (m, N, 3) over groups, (m, count, 3)."""
    hot = np.zeros((count, index.size))
    hot[index, np.arange(index.size)] = 1.0
    return np.einsum('gn,mnc->mgc', hot, values, optimize=True)


def _grouping(label, index, keys, residual, noise, expected):
    count = len(keys)
    squares = _sums(index, count, residual[None]**2)[0]
    wanted = _sums(index, count, expected[None])[0]
    number = np.maximum(np.bincount(index, minlength=count), 1)[:, None]
    mean = _sums(index, count, residual[None])[0] / number
    with np.errstate(invalid='ignore', divide='ignore'):
        rms = np.where(wanted > 1e-12, np.sqrt(squares / np.maximum(wanted, 1e-300)), 0.0)
    every = np.concatenate([residual[None], noise])
    total = np.sum(every**2, axis=(1, 2))
    # the most uneven group, each draw in units of its own scatter
    uneven = (_sums(index, count, every**2) / np.maximum(wanted, 1e-12)
              / total[:, None, None] * total[1:].mean())
    statistic = uneven.max(axis=(1, 2))
    p = (1 + np.count_nonzero(statistic[1:] >= statistic[0])) / statistic.size
    return Grouping(label, tuple(keys), rms, mean, float(p))


def _neighbours(residual, noise):
    """Return the correlation of neighbours in the sequence and the chance of as much in noise."""
    every = np.concatenate([residual[None], noise])
    value = (np.sum(every[:, 1:] * every[:, :-1], axis=(1, 2)) / np.sum(every**2, axis=(1, 2)))
    centre = value[1:].mean()
    z = (value[0] - centre) / value[1:].std()
    return float(value[0] - centre), float(2 * special.ndtr(-abs(z)))


def _worst(run, fit, residual, noise, expected):
    scale = np.sqrt(np.maximum(expected, 1e-12))
    size = np.sqrt(np.sum((residual / scale)**2, axis=1)) / fit.rms
    total = np.sqrt(np.sum(noise**2, axis=(1, 2)) / fit.dof)
    largest = np.sqrt(np.sum((noise / scale)**2, axis=2)).max(axis=1) / total
    order = np.argsort(size)[::-1][:10]
    return tuple(
        Reading(int(k + 1), int(run.table_position[k]), int(run.ball[k]), int(run.cmm_position[k]),
                tuple(float(value) for value in residual[k]), float(size[k]),
                float((1 + np.count_nonzero(largest >= size[k])) / (largest.size + 1)))
        for k in order)


def _harmonics(fit):
    run = fit.run
    if not run.is_complete:
        return ()
    n = run.n
    grid = np.zeros((n, n, 3))
    grid[run.table_position - 1, run.cmm_position - 1] = fit.residual
    total = np.sum(fit.residual**2)
    lines = []
    for axis in range(3):
        spectrum = np.fft.fft2(grid[..., axis]) / n**2
        for p in range(n // 2 + 1):
            for q in range(n):
                mirror = spectrum[-p % n, -q % n]
                if (p, q) > ((-p) % n, (-q) % n):
                    continue
                single = (p, q) == ((-p) % n, (-q) % n)
                power = abs(spectrum[p, q])**2 * (1 if single else 2)
                amplitude = abs(spectrum[p, q]) * (1 if single else 2)
                assert np.isclose(abs(mirror), abs(spectrum[p, q]), atol=1e-12)
                waves = q if q <= n // 2 else q - n
                lines.append(Harmonic(AXES[axis], p, waves, float(amplitude),
                                      float(power * n**2 / total) if total else 0.0))
    return tuple(sorted(lines, key=lambda line: -line.share)[:10])


def _summary(fit, failing, groupings, neighbour_p, axis_rms):
    times = ''
    if fit.reduced_chi_square is not None:
        times = f', {np.sqrt(fit.reduced_chi_square):.2g} times the repeatability'
    start = f'The residual is {fit.rms * 1e6:.3g} um{times}'
    if not failing:
        return f'{start}: the model describes the run as far as it can tell.'
    axis = AXES[int(np.argmax(axis_rms))]
    places = sorted((g for g in groupings if g.p < 0.01), key=lambda g: g.p)
    where = [f'{g.label} {g.keys[g.worst]}' for g in places[:3]]
    text = '; most at ' + ', '.join(where) if where else ''
    if neighbour_p < 0.01:
        text += '; neighbours in the sequence are alike'
    return f'{start}: the model fails, most along {axis}{text}.'

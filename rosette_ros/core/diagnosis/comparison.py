# SPDX-License-Identifier: Apache-2.0
"""Model compared with measurement: where the residual is, and by how much of sigma."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rosette_ros.core.model.least_squares import Fit, fit
from rosette_ros.core.model.noise import places
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import UNLIKELY, Floats, Ints, remove_gauge
from rosette_ros.core.sight.bank import Reals

DRAWS = 400
"""Draws of noise that a comparison is made with."""


@dataclass(frozen=True, eq=False)
class Grouping:
    """Residuals grouped by one thing.

    label: what by; keys: (g,) group names; rms: (g, 3) root mean square per axis, m, scaled so that sigma is expected
    under the right model; mean: (g, 3), m; both NaN where nothing was measured; p: probability that noise spreads its
    groups as unevenly.
    """

    label: str
    keys: tuple[str, ...]
    rms: Floats
    mean: Floats
    p: float

    @property
    def worst(self) -> int:
        """Index of the group with the largest rms."""
        return int(np.nanargmax(np.sum(self.rms**2, axis=1)))


@dataclass(frozen=True)
class Reading:
    """One reading that fits badly: number, indices, residual (3,), m, its size in sigma, and p of as large a one.

    weight: least of its coordinates, over the largest of all; without: (6,) largest change of each curve by leaving it
    out, m and rad, None where it does not stand out or the others are too few.
    """

    number: int
    table_position: int
    ball: int
    cmm_position: int
    residual: tuple[float, ...]
    size: float
    p: float
    weight: float = 1.0
    without: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Where a model leaves a residual: by axis, table position, ball, CMM position, time and sequence.

    axis_rms: (3,) m; sizes: (N,) residual of each reading, rms over the axes, m, scaled as of Grouping; neighbour_p:
    probability that noise leaves neighbours in time as alike; worst: readings, worst first.
    """

    fit: Fit
    axis_rms: Floats
    sizes: Floats
    groupings: tuple[Grouping, ...]
    neighbour_correlation: float
    neighbour_p: float
    worst: tuple[Reading, ...]

    @property
    def distinct(self) -> tuple[Grouping, ...]:
        """The groupings, parts of the run in words; one of time and sequence where they differ by a reading at each
        boundary of parts at most."""
        parts = {label: index for label, index, _ in places(self.fit.run)}
        *others, time, sequence = self.groupings
        minutes = ' min' * (self.fit.run.time_unit == 's')
        times = [f'between {key.replace("-", f"{minutes} and ")}' for key in time.keys]
        readings = [f'readings {key.replace("-", " to ")}' for key in sequence.keys]
        if np.count_nonzero(parts['time'] != parts['sequence']) >= len(time.keys):
            return (*others, replace(time, keys=tuple(times)), replace(sequence, keys=tuple(readings)))
        both = tuple(f'{one} ({some})' for one, some in zip(times, readings, strict=True))
        return (*others, replace(time, keys=both))


def compare(fitted: Fit, seed: int = 0) -> Comparison:
    """Return the Comparison of a fit with its run; seed: of the noise through the same model to compare with."""
    run, residual = fitted.run, fitted.residual
    white, whitening = np.random.default_rng(seed).standard_normal((DRAWS, run.size, 3)), fitted.joint.whitening
    noise = whitening.inverse(fitted.joint.free(white))
    expected = np.mean(noise**2, axis=0)

    groupings = tuple(_grouping(label, index, keys, residual, noise, expected) for label, index, keys in places(run))
    axis_rms = np.sqrt(np.sum(residual**2, axis=0) / np.sum(expected, axis=0))
    if not whitening.is_plain:
        axis_rms = axis_rms * np.sqrt(np.mean(whitening.inverse(white)**2, axis=(0, 1)))
    sizes = np.sqrt(np.mean(residual**2 / np.maximum(expected, 1e-12), axis=1))
    return Comparison(fitted, axis_rms, sizes, groupings, *fitted.neighbours, _worst(fitted, noise, expected))


def _sums(index: Ints, count: int, values: Reals) -> Floats:
    """Return sums of values (m, N, 3) over groups, (m, count, 3)."""
    hot = np.zeros((count, index.size))
    hot[index, np.arange(index.size)] = 1.0
    return np.asarray(np.einsum('gn,mnc->mgc', hot, values, optimize=True))


def _grouping(label: str, index: Ints, keys: Sequence[str], residual: Floats, noise: Reals,
              expected: Reals) -> Grouping:
    count = len(keys)
    squares = _sums(index, count, residual[None]**2)[0]
    wanted = _sums(index, count, expected[None])[0]
    number = np.bincount(index, minlength=count)[:, None]

    mean = np.where(number, _sums(index, count, residual[None])[0] / np.maximum(number, 1), np.nan)
    rms = np.where(wanted > 1e-12, np.sqrt(squares / np.maximum(wanted, 1e-12)), np.where(number, 0.0, np.nan))

    every = np.concatenate([residual[None], noise])
    total = np.maximum(np.sum(every**2, axis=(1, 2)), np.finfo(float).tiny)
    # the most uneven group, each draw in units of its own scatter
    uneven = (_sums(index, count, every**2) / np.maximum(wanted, 1e-12) / total[:, None, None] * total[1:].mean())
    statistic = uneven.max(axis=(1, 2))
    p = (1 + np.count_nonzero(statistic[1:] >= statistic[0])) / statistic.size
    return Grouping(label, tuple(keys), rms, mean, float(p))


def _worst(fitted: Fit, noise: Reals, expected: Reals) -> tuple[Reading, ...]:
    run, weight = fitted.run, np.ones((fitted.run.size, 3)) if fitted.noise.weight is None else fitted.noise.weight
    scale = np.sqrt(np.maximum(expected * weight, 1e-12))  # what stands out is shown as large as it is
    size = np.sqrt(np.sum((fitted.residual / scale)**2, axis=1)) / max(fitted.rms, np.finfo(float).tiny)
    total = np.sqrt(np.sum(noise**2, axis=(1, 2)) / fitted.dof)
    largest = np.sqrt(np.sum((noise / scale)**2, axis=2)).max(axis=1) / total

    found = []
    for k in np.argsort(size)[::-1][:10]:
        p = float((1 + np.count_nonzero(largest >= size[k])) / (largest.size + 1))
        found.append(Reading(
            int(k + 1), int(run.table_position[k]), int(run.ball[k]), int(run.cmm_position[k]),
            tuple(fitted.residual[k].tolist()), float(size[k]), p, float(weight[k].min() / max(weight.max(), 1e-300)),
            _change_without(fitted, int(k)) if p < UNLIKELY else None))
    return tuple(found)


def _change_without(fitted: Fit, reading: int) -> tuple[float, ...] | None:
    """Return the largest change of each curve, (6,), by leaving out a reading; None where the others are too few."""
    others = np.delete(np.arange(fitted.run.size), reading)
    try:
        rest = fit(fitted.run.take(others), fitted.model, fitted.settings, fitted.noise.of_readings(fitted.run, others))
    except NotDeterminable:
        return None
    change = remove_gauge(rest.error_motions.values) - remove_gauge(fitted.error_motions.values)
    return tuple(np.abs(change).max(axis=0).tolist())

# SPDX-License-Identifier: Apache-2.0
"""Kinds of noise of ball centres, in units of σ, for a repeatability check and the run that follows it.

A kind is a function of the readings and a generator; to add one, write it and a line of KINDS.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from rosette_ros.core.run.geometry import nominal_angles, rotate_z
from rosette_ros.core.run.records import Floats, Ints

Generator = np.random.Generator


@dataclass(frozen=True, eq=False)
class Readings:
    """What the noise of N readings in measuring order may depend on: `check` readings of ball 1, then those of the run.

    n: number of balls; check: number of readings before the run; time: (N,) s; ball, table_position: (N,) one-based.
    """

    n: int
    check: int
    time: Floats
    ball: Ints
    table_position: Ints

    @property
    def size(self) -> int:
        """N, the number of readings, those of the check included."""
        return self.time.size

    @property
    def share(self) -> Floats:
        """(N,) share of the run that is done, 0 during the check."""
        return np.maximum(np.arange(self.size) - self.check, 0) / max(self.size - self.check - 1, 1)

    @property
    def azimuth(self) -> Floats:
        """(N,) nominal azimuth α of the CMM position, rad."""
        return nominal_angles(self.n)[(self.table_position + self.ball - 2) % self.n]


@dataclass(frozen=True, eq=False)
class Noise:
    """Drawn noise: offset (N, 3) in σ; outliers: readings of the run, one-based; resolution: step in σ, or 0."""

    offset: Floats
    outliers: tuple[int, ...] = ()
    resolution: float = 0.0


def white(at: Readings, rng: Generator) -> Floats:
    """Return independent normal numbers, (N, 3)."""
    return rng.standard_normal((at.size, 3))


def by_axis(at: Readings, rng: Generator, factors: tuple[float, float, float]) -> Floats:
    """Return white noise with a factor on each axis."""
    return white(at, rng) * factors


def by_direction(at: Readings, rng: Generator, radial: float) -> Floats:
    """Return white noise whose radial component is `radial` times the tangential one."""
    return rotate_z(at.azimuth, white(at, rng) * (radial, 1.0, 1.0))


def student(at: Readings, rng: Generator, dof: float, per_reading: bool, axes: tuple[float, ...] = (1, 1, 1)) -> Floats:
    """Return Student's t of unit variance: normal / √(χ²/dof) · √((dof − 2)/dof).

    per_reading: the three coordinates of a reading share their χ².
    """
    scale = np.sqrt(rng.chisquare(dof, (at.size, 1 if per_reading else 3)) / dof)
    return white(at, rng) / scale * np.sqrt((dof - 2) / dof) * axes


def laplace(at: Readings, rng: Generator) -> Floats:
    """Return double exponential noise of unit variance."""
    return rng.laplace(0.0, np.sqrt(0.5), (at.size, 3))


def contaminated(at: Readings, rng: Generator, share: float, factor: float) -> Floats:
    """Return white noise, a share of the readings with a factor on it."""
    return white(at, rng) * np.where(rng.random((at.size, 1)) < share, factor, 1.0)


def outliers(at: Readings, rng: Generator, count: int, size: float) -> Noise:
    """Return white noise and `count` readings of the run off by `size` in a drawn direction."""
    offset = white(at, rng)
    places = rng.choice(at.size - at.check, count, replace=False)
    direction = rng.standard_normal((count, 3))
    offset[at.check + places] += size * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return Noise(offset, tuple(sorted((places + 1).tolist())))


def by_group(at: Readings, rng: Generator, what: str) -> Floats:
    """Return white noise with a σ for each ball, table position or CMM position, drawn between 0.5 and 2 (log)."""
    factor = 2.0**rng.uniform(-1, 1, at.n)
    group = {'ball': at.ball - 1, 'table position': at.table_position - 1,
             'CMM position': (at.table_position + at.ball - 2) % at.n}[what]
    return white(at, rng) * factor[group, None]


def autoregressive(at: Readings, rng: Generator, rho: float, axes: tuple[float, ...] = (1, 1, 1)) -> Floats:
    """Return AR(1) noise of unit variance along the measuring order: e_k = ρ e_{k−1} + √(1 − ρ²) w_k.

    axes: share of each axis that is correlated (1 or 0), the rest is white.
    """
    drive, along = white(at, rng), np.asarray(axes) * rho
    out = drive.copy()
    for place in range(1, at.size):
        out[place] = along * out[place - 1] + np.sqrt(1 - along**2) * drive[place]
    return out


def slow_variance(at: Readings, rng: Generator) -> Floats:
    """Return white noise whose σ rises, falls, or rises and falls by a factor of 2 to 3 in the run; mean square 1."""
    course = [at.share, 1 - at.share, np.sin(np.pi * at.share)][rng.integers(3)]
    sigma = rng.uniform(2, 3)**(0.5 - 0.5 * np.cos(np.pi * course))
    return white(at, rng) * (sigma / np.sqrt(np.mean(sigma[at.check:]**2)))[:, None]


def rounded(at: Readings, rng: Generator, step: float) -> Noise:
    """Return white noise of readings that are rounded to `step`."""
    return Noise(white(at, rng), resolution=step)


def flicker(at: Readings, rng: Generator, size: float, beside: float = 1.0) -> Floats:
    """Return noise with a power spectrum ∝ 1/f, of standard deviation `size` over the run, beside white noise.

    The record is four times as long as the readings, so that its slowest part is slower than the run.
    """
    long = 4 * at.size
    frequency = np.fft.rfftfreq(long)
    filtered = np.fft.rfft(rng.standard_normal((long, 3)), axis=0)
    filtered /= np.sqrt(np.maximum(frequency, frequency[1]))[:, None]
    wander = np.fft.irfft(filtered, long, axis=0)[:at.size]
    wander -= wander[at.check:].mean(axis=0)
    return size * wander / wander[at.check:].std(axis=0) + beside * white(at, rng)


def random_walk(at: Readings, rng: Generator, end: float, axes: tuple[float, ...] = (1, 1, 1)) -> Floats:
    """Return the random walk of the frame beside white noise: variance ∝ time, standard deviation `end` at the end."""
    step = np.diff(at.time, prepend=at.time[:1])
    duration = at.time[-1] - at.time[at.check]
    walk = np.cumsum(np.sqrt(step / duration)[:, None] * white(at, rng), axis=0)
    return end * np.asarray(axes) * (walk - walk[at.check]) + white(at, rng)


Kind = Callable[[Readings, Generator], Floats | Noise]

KINDS: dict[str, Kind] = {
    'white': white,
    'z_1.5': partial(by_axis, factors=(1, 1, 1.5)),
    'z_2': partial(by_axis, factors=(1, 1, 2)),
    'z_3': partial(by_axis, factors=(1, 1, 3)),
    'x_2': partial(by_axis, factors=(2, 1, 1)),
    't3_coordinate': partial(student, dof=3, per_reading=False),
    't3_reading': partial(student, dof=3, per_reading=True),
    't4_coordinate': partial(student, dof=4, per_reading=False),
    't4_reading': partial(student, dof=4, per_reading=True),
    'outliers_1': partial(outliers, count=1, size=10),
    'outliers_2': partial(outliers, count=2, size=10),
    'outliers_3': partial(outliers, count=3, size=10),
    'sigma_by_ball': partial(by_group, what='ball'),
    'ar_0.3': partial(autoregressive, rho=0.3),
    'ar_0.6': partial(autoregressive, rho=0.6),
    'slow_variance': slow_variance,
    'rounded_1': partial(rounded, step=1),
    'rounded_5': partial(rounded, step=5),
    'flicker_1': partial(flicker, size=1),
    'walk_3': partial(random_walk, end=3),
    'walk_10': partial(random_walk, end=10),
    'x_3_y_2': partial(by_axis, factors=(3, 2, 1)),
    'radial_2': partial(by_direction, radial=2),
    'laplace': laplace,
    'contaminated': partial(contaminated, share=0.05, factor=3),
    'sigma_by_table_position': partial(by_group, what='table position'),
    'sigma_by_cmm_position': partial(by_group, what='CMM position'),
    'z_2_t4': partial(student, dof=4, per_reading=True, axes=(1, 1, 2)),
    'ar_0.6_z': partial(autoregressive, rho=0.6, axes=(0, 0, 1)),
    'ar_0.8': partial(autoregressive, rho=0.8),
    'flicker_alone': partial(flicker, size=1, beside=0),
    'walk_5_z': partial(random_walk, end=5, axes=(0, 0, 1)),
}
"""The kinds by name; all but the first are real noise."""


def draw_noise(kind: str, at: Readings, rng: Generator) -> Noise:
    """Return the Noise of a kind of KINDS."""
    drawn = KINDS[kind](at, rng)
    return drawn if isinstance(drawn, Noise) else Noise(drawn)

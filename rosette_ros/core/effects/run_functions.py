# SPDX-License-Identifier: Apache-2.0
"""Functions of the readings of a run, and directions in which they displace balls: what effects are made of."""

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np

from rosette_ros.core.run import axes
from rosette_ros.core.run.geometry import radial as radial
from rosette_ros.core.run.records import Bools, Floats, Run

COARSE = 4
"""Readings of one temperature in a row, on average, above which it is taken as rounded."""
LONG_GAP = 0.06
"""Share of the run without temperatures from which on it may have gone another way than straight."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """What effects do to the plate as a body: rotation vector (N, 3), rad, growth (N,), shift on the table (N, 3), m.

    beyond: what the shift is beyond first order in the amplitudes, (N, 3), m.
    """

    rotation: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    growth: Floats = field(default_factory=lambda: np.zeros(1))
    shift: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    beyond: Floats = field(default_factory=lambda: np.zeros((1, 3)))

    def __add__(self, other: 'BodyMotion') -> 'BodyMotion':
        return BodyMotion(self.rotation + other.rotation, self.growth + other.growth, self.shift + other.shift,
                          self.beyond + other.beyond)


def seconds(run: Run) -> Floats:
    """Return the time of each reading since the first, (N,), s."""
    return np.asarray(run.time - run.time[0])


def travel(run: Run) -> Floats:
    """Return the unwrapped table angle of each reading since the first, (N,), rad."""
    return np.asarray(run.table_travel - run.table_travel[0])


def duration(run: Run) -> float:
    """Return the time from the first reading to the last, s; 1 where no time passes."""
    return float(np.ptp(run.time)) or 1.0


@lru_cache(maxsize=4)
def temperature_waves(run: Run) -> Floats:
    """Return the temperature of each reading minus that of the first, K, and what is open of it, (m, N).

    A record of few values, each held for several readings, is taken as rounded: its course is the smoothest one that
    stays within the rounding. Readings without temperature are filled by what lies between; a gap that is long adds
    two waves that are zero outside of it, by which the temperature may have gone another way.
    """
    time, known = seconds(run), np.isfinite(run.temperature)
    if not known.any():
        return np.full((1, run.size), np.nan)
    at, change = time[known], run.temperature[known] - run.temperature[known][0]
    if np.all(np.diff(at) > 0) and (error := temperature_error(run)):
        change = _smoothest(at, change, error)
    waves = [np.interp(time, at, change - change[0])]
    edges = np.concatenate([time[:1], at, time[-1:]])
    for start, stop in pairwise(edges):
        if stop - start > LONG_GAP * duration(run):
            share = (time - start) / (stop - start)
            inside = (share > 0) & (share < 1) if at[0] <= start and stop <= at[-1] else (share >= 0) & (share <= 1)
            if stop > at[-1]:
                open_ways = [share, share**2]
            elif start < at[0]:
                open_ways = [1 - share, (1 - share)**2]
            else:
                open_ways = [np.sin(np.pi * share), np.sin(2 * np.pi * share)]
            waves += [inside * way for way in open_ways]
    return np.array(waves)


def _smoothest(time: Floats, values: Floats, error: float) -> Floats:
    """Return values (N,) as the fewest powers and cosines of time that leave an error (rms) of them."""
    u = (time - time[0]) / (time[-1] - time[0])
    for count in range(1, values.size // 2):
        some = np.array([np.ones_like(u), u, u**2, *(np.cos(np.pi * k * u) for k in range(1, count))]).T
        smooth = some @ np.linalg.lstsq(some, values, rcond=None)[0]
        if np.mean((values - smooth)**2) <= error**2:
            return np.asarray(smooth)
    return values


def temperature_change(run: Run) -> Floats:
    """Return the temperature of each reading minus that of the first, (N,), K, as far as it is known."""
    return np.asarray(temperature_waves(run)[0])


def temperature_step(run: Run) -> float:
    """Return the step of a coarse record of the temperature, each value of which is held for several readings, K, or 0.

    It is infinite where the record says nothing: there is none, or it never changes.
    """
    values = run.temperature[np.isfinite(run.temperature)]
    changes = np.count_nonzero(np.diff(values))
    if not changes:
        return np.inf
    return float(np.diff(np.unique(values)).min()) if changes < values.size / COARSE else 0.0


def temperature_error(run: Run) -> float:
    """Return the standard deviation of the errors of the recorded temperatures, K: rounding, and what scatters.

    What scatters from reading to reading shows in how far each is from the line between its neighbours: errors that are
    white make each of these go against the next one (correlation -2/3), a smooth course makes it go with it."""
    step, is_known = temperature_step(run), np.isfinite(run.temperature)
    known, time = run.temperature[is_known], run.time[is_known]
    if not np.isfinite(step) or known.size < 4:
        return 0.0
    if step:
        return float(step / np.sqrt(12))
    share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
    off = (known[1:-1] - (1 - share) * known[:-2] - share * known[2:]) / np.sqrt(1 + share**2 + (1 - share)**2)
    scatter, rounding = float(np.sqrt(np.mean(off**2))), np.spacing(np.abs(known).max())
    return scatter if off[1:] @ off[:-1] < 0 and scatter > rounding else 0.0


def lagged(time: Floats, driver: Floats, tau: float) -> Floats:
    """Return what follows a driver (N,), straight between readings, with the time constant tau: tau y' = x - y."""
    out = np.zeros_like(driver)
    for k, step in enumerate(np.diff(time)):
        share = step / tau
        left = np.exp(-share)
        mean = -np.expm1(-share) / share if share else 1.0
        out[k + 1] = left * out[k] + (mean - left) * driver[k] + (1 - mean) * driver[k + 1]
    return out


def unit(axis: int, size: int) -> Floats:
    """Return a unit displacement along axis 0, 1 or 2 for every reading, (size, 3)."""
    out = np.zeros((size, 3))
    out[:, axis] = 1.0
    return out


def tangential(angle: Floats) -> Floats:
    """Return the tangential unit vectors at azimuths (N,), shape (N, 3)."""
    return np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


@lru_cache(maxsize=4)
def plate_axes(run: Run) -> Floats:
    """Return unit vectors of the plate's x, y, z in the table frame, (N, 3, 3), last is the axis."""
    out = np.zeros((run.size, 3, 3))
    out[:, :, 0] = radial(run.phi)
    out[:, :, 1] = tangential(run.phi)
    out[:, 2, 2] = 1.0
    out.setflags(write=False)
    return out


def oval(run: Run) -> Floats:
    """Return how the balls move where the plate becomes oval along its x, and along its diagonal, (2, N, 3), 1/R."""
    x, y = plate_axes(run)[..., 0], plate_axes(run)[..., 1]
    cosine, sine = np.cos(run.beta)[:, None], np.sin(run.beta)[:, None]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y])


@lru_cache(maxsize=4)
def along_machine(run: Run) -> Floats:
    """Return unit displacements along the axes of the machine for every reading, (3, N, 3)."""
    return np.repeat(axes.cmm_axes(run.rotation)[:, None], run.size, axis=1)


def cmm_axes_names(run: Run) -> str:
    """Return the letters of the two axes of the CMM that go to and fro between the balls: xy for an upright table."""
    return ''.join(axes.LETTERS[axis] for axis in axes.moving_axes(run.rotation))


def cmm_axes(run: Run) -> Floats:
    """Return the directions of these two in the table frame, (2, 3)."""
    return np.asarray(axes.cmm_axes(run.rotation)[list(axes.moving_axes(run.rotation))])


def cmm_senses(run: Run) -> Floats:
    """Return the senses of the last move of these two, (2, N)."""
    return np.asarray(run.cmm_sense[:, list(axes.moving_axes(run.rotation))].T)


def axial_tilts(run: Run) -> Floats:
    """Return z per unit tilt about x and about y at the ball, (N, 3, 2), m/rad; zero on the axis of the tilt."""
    out = np.zeros((run.size, 3, 2))
    out[:, 2, 0] = run.radius * np.sin(run.alpha)
    out[:, 2, 1] = -run.radius * np.cos(run.alpha)
    return np.where(np.abs(out) > 1e-12 * run.radius, out, 0.0)


def leaky_sum(values: Floats, keep: float) -> Floats:
    """Return the sums of values (k, N) up to each reading of which a share `keep` stays to the next, of largest 1.

    Before the first reading the machine has stood still."""
    out = np.zeros_like(values)
    for k in range(1, values.shape[1]):
        out[:, k] = keep * out[:, k - 1] + values[:, k]
    return out / max(float(np.abs(out).max()), 1e-9)


def last_move(run: Run) -> tuple[Floats, Bools]:
    """Return the azimuth of the CMM's last move before each reading, (N,), rad, and if known, (N, 1).

    It is one in the table frame. A ball at the same place is reached by the move before.
    """
    move = np.diff(radial(run.alpha), axis=0, prepend=radial(run.alpha)[:1])
    moved = np.linalg.norm(move, axis=1) > 1e-9
    last = np.maximum.accumulate(np.where(moved, np.arange(run.size), 0))
    return np.arctan2(move[last, 1], move[last, 0]), np.logical_or.accumulate(moved)[:, None]


def thinned(values: Floats, most: int) -> Floats:
    """Return at most `most` of some values, evenly spread."""
    return values if values.size <= most else values[np.linspace(0, values.size - 1, most).round().astype(int)]


def midway(time: Floats) -> Floats:
    """Return the instants midway between different times, in rising order, s."""
    time = np.unique(time)
    return 0.5 * (time[1:] + time[:-1])


def beside(values: Floats, value: float, reach: float) -> Floats:
    """Return those of rising values that are at most `reach` places from one of them, and at least two to each side."""
    place, far = int(np.searchsorted(values, value)), max(2, int(np.ceil(reach)))
    return values[max(place - far, 0):place + far + 1]


def around(times: Floats, instant: float) -> tuple[float, float]:
    """Return the last of rising times up to an instant that lies between them, and the first after it."""
    later = int(np.searchsorted(times, instant, side='right'))
    return float(times[later - 1]), float(times[later])


def between_readings(run: Run, most: int = 120) -> Floats:
    """Return instants midway between readings, thinned to at most `most`, and in pauses, s since the first."""
    time = seconds(run)
    middle = thinned(midway(time), most)
    pauses = [0.5 * (time[first] + time[first - 1]) for first in run.pauses]
    return np.union1d(middle, pauses) if pauses else middle

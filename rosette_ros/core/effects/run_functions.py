# SPDX-License-Identifier: Apache-2.0
"""Functions of the readings of a run, and directions in which they displace balls: what effects are made of."""

import numpy as np

from rosette_ros.core.records import Floats, Run

COARSE = 4
"""Readings of one temperature in a row, on average, above which it is taken as rounded."""


def seconds(run: Run) -> Floats:
    """Return the time of each reading since the first, (N,), s."""
    return np.asarray(run.time - run.time[0])


def travel(run: Run) -> Floats:
    """Return the unwrapped table angle of each reading since the first, (N,), rad."""
    return np.asarray(run.table_travel - run.table_travel[0])


def duration(run: Run) -> float:
    """Return the time from the first reading to the last, s; 1 where no time passes."""
    return float(np.ptp(run.time)) or 1.0


def temperature_change(run: Run) -> Floats:
    """Return the temperature of each reading minus that of the first, (N,), K.

    A record of few values, each held for several readings, is taken as rounded: it passes halfway between two values
    where one follows the other, and is straight in between.
    """
    change = np.asarray(run.temperature - run.temperature[0])
    turns = np.flatnonzero(np.diff(change)) + 1
    if not 0 < turns.size < run.size / COARSE:
        return change
    time = seconds(run)
    at = 0.5 * (time[turns] + time[turns - 1])
    middle = 0.5 * (change[turns] + change[turns - 1])
    smooth = np.interp(time, [time[0], *at, time[-1]], [change[0], *middle, change[-1]])
    return np.asarray(smooth - smooth[0])


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


def radial(angle: Floats) -> Floats:
    """Return the radial unit vectors at azimuths (N,), shape (N, 3)."""
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def tangential(angle: Floats) -> Floats:
    """Return the tangential unit vectors at azimuths (N,), shape (N, 3)."""
    return np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def plate_axes(run: Run) -> Floats:
    """Return unit vectors of the plate's x, y, z in the table frame, (N, 3, 3), last is the axis."""
    out = np.zeros((run.size, 3, 3))
    out[:, :, 0] = radial(run.phi)
    out[:, :, 1] = tangential(run.phi)
    out[:, 2, 2] = 1.0
    return out


def axial_tilts(run: Run) -> Floats:
    """Return z per unit tilt about x and about y at the ball, (N, 3, 2), m/rad."""
    out = np.zeros((run.size, 3, 2))
    out[:, 2, 0] = run.radius * np.sin(run.alpha)
    out[:, 2, 1] = -run.radius * np.cos(run.alpha)
    return out


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


def between_readings(run: Run, most: int = 120) -> Floats:
    """Return instants midway between readings, thinned to at most `most`, and in pauses, s since the first."""
    time = seconds(run)
    middle = thinned(midway(time), most)
    pauses = [0.5 * (time[first] + time[first - 1]) for first in run.pauses]
    return np.union1d(middle, pauses) if pauses else middle

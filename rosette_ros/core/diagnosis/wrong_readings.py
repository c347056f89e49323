# SPDX-License-Identifier: Apache-2.0
"""Readings that are wrong: those that a fit has as effects, and those that are far off in the rest."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rosette_ros.core.run.records import Run

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.model.least_squares import Fit

WRONG = 30.0
"""Residual, over the scatter of all along its axis, beyond which a reading is wrong: no noise of a machine is so."""


@dataclass(frozen=True)
class WrongReading:
    """A reading that is wrong: its number, where it was, s after the first one (NaN where times only count readings),
    and by how much along which axis, m."""

    number: int
    table_position: int
    ball: int
    time: float
    size: float
    axis: str


def _reading(run: Run, row: int, size: float, axis: str) -> WrongReading:
    return WrongReading(row + 1, int(run.table_position[row]), int(run.ball[row]),
                        float(run.time[row] - run.time[0]) if run.time_unit == 's' else np.nan,
                        float(size), axis)


def outliers(final: 'Fit', known: int) -> tuple[WrongReading, ...]:
    """Return the wrong readings that a fit has as effects beyond the first ones, which are known."""
    found = []
    for effect in final.effects[known:]:
        if 'reading' in effect.setting:
            largest = max(effect.parameters, key=lambda one: abs(one.value))
            found.append(_reading(final.run, effect.setting.whole('reading') - 1, largest.value,
                                  largest.name.removeprefix('d_')))
    return tuple(found)


def wrong_readings(final: 'Fit') -> tuple[WrongReading, ...]:
    """Return the readings that are farther off than noise can be, the farthest first."""
    run, size = final.run, np.abs(final.residual)
    # 1.4826 times the median is the standard deviation of normal noise; readings that are rounded alike show none
    scatter = np.hypot(1.4826 * np.median(size, axis=0), np.sqrt(run.steps**2 / 12))
    if not np.all(scatter > 0):
        return ()
    off = size / scatter
    rows = np.flatnonzero(np.any(off > WRONG, axis=1))
    rows = rows[np.argsort(-off[rows].max(axis=1), kind='stable')]
    return tuple(_reading(run, row, size[row, axis], 'xyz'[axis])
                 for row, axis in zip(rows.tolist(), off[rows].argmax(axis=1).tolist()))



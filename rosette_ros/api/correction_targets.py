# SPDX-License-Identifier: Apache-2.0
"""The file of a correction for ROS, as a table or for a controller, and what is to be known of it."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from rosette_ros.core.run.number_words import SCALES
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.controller_tables import OF_A_TURN, TNC_UNIT, Axis, linuxcnc
from rosette_ros.io.correction_file import correction_csv, format_correction
from rosette_ros.words.effect_words import exact

ROS = 'ros'
"""The target that is no table: YAML (rosette-correction/1) for table_corrector, verify and the simulated machine."""
STEPS: Mapping[str, float] = MappingProxyType(
    {'csv': 5.0, 'linuxcnc': 2.0, **dict.fromkeys(OF_A_TURN, 5.0), 'heidenhain': 2**15 * TNC_UNIT})
"""The other targets, and the default distance of the lines of their tables, deg."""
TURN = (0.0, 360.0)
"""Angles of a table, deg."""


def is_controller(target: str) -> bool:
    """Return whether a target is a controller, which turns the table only: crz is what it takes."""
    return target not in (ROS, 'csv')


def correction_file(correction: Correction, target: str = ROS, serial: str = '', step: float = 0.0,
                    span: tuple[float, float] = TURN, axis: Axis | None = None) -> tuple[str, tuple[str, ...]]:
    """Return the text of a file for a target, and in sentences what is to be known of it.

    serial: of the table; step: distance of the lines of a table, deg, 0 for the default; span: the angles of csv and
    linuxcnc, deg; axis: of a controller. Raises InvalidConfig where a controller cannot take it."""
    step, axis, notes = step or STEPS.get(target, 0.0), axis or Axis(), list[str]()
    if target == 'linuxcnc':
        text, notes = linuxcnc(correction, *span, step, axis)
    elif is_controller(target):
        text, notes = OF_A_TURN[target](correction, step, axis)
    elif target == 'csv':
        text = correction_csv(correction, np.deg2rad(np.append(np.arange(span[0], span[1] - 1e-9, step), span[1])))
    else:
        text = format_correction(correction, serial)
    lines = [f'Harmonics: up to {correction.harmonics} of the table angle, those that the run determines.']
    if step:
        lines.append(_missed(correction, step))
    if is_controller(target):
        lines.append(f'Axis: {axis.name} = {axis.zero:g}° {"+" if axis.sign > 0 else "−"} table angle.')
    return text, (*lines, *notes)


def _missed(correction: Correction, step: float) -> str:
    """Return what straight lines between the lines of a table lose, in a sentence; step: of the table, deg."""
    bound = dict(zip(CURVES, correction.curvature() * np.deg2rad(step)**2 / 8))
    missed = [f'{exact(factor * max(sizes), 4)} {unit}' for kind, (factor, unit) in (
        ('ct', SCALES['m']), ('cr', SCALES['rad'])) if (sizes := [
            bound[one] for one in correction.corrected if one.startswith(kind)])]
    return (f'Straight lines between the angles of the table miss {", ".join(correction.corrected)} by at most '
            f'{" and ".join(missed)}.')

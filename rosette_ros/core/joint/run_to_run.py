# SPDX-License-Identifier: Apache-2.0
"""The six error motions of several runs in a line each: what they have in common, and how they scatter (ISO 230-7)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.joint_model import JointModel, TableSet
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.joint.sharing import Sharing
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import Floats, nominal_angles, same_angles
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import ErrorMotions, remove_gauge
from rosette_ros.core.uncertainty import error_summary as summary
from rosette_ros.core.uncertainty.error_summary import AxisError, SphereErrors, error_lines, extremes, four_axis_errors


def joint_lines(result: JointResult, tolerances: Mapping[str, Tolerance] | None = None,
                doubt: str = '') -> list[tuple[TableSet, ErrorMotions, tuple[AxisError, ...]]]:
    """Return the curves and AxisErrors of each set of table motions; tolerances, doubt: as of error_lines."""
    model, out = result.solution.model, []
    scale = np.array([1, 1, 1, *[1 / model.lever] * 3])
    alone = [_alone(result, place) for place in range(len(model.runs))]
    for one, motions in result.curves:
        high, low = extremes(motions)
        mix = result.of_set(one)[1]
        u_range = result.weighted_sigma * scale * np.linalg.norm(mix[high, range(6)] - mix[low, range(6)], axis=-1)
        same = [curves for table, curves in zip(model.sharing.table, alone, strict=True) if table == one.name]
        out.append((one, motions, error_lines(motions, u_range, tolerances, doubt, _widths(one, same))))
    return out


def joint_spheres(result: JointResult, radius: float, height: float
                  ) -> list[tuple[str, tuple[SphereErrors, SphereErrors], str]]:
    """Return the table, its four-axis errors and what they contain; radius, height: as of four_axis_errors.

    Both senses of a table are together where the runs tell how they differ, else each is by itself."""
    known = {one.table: all(one.is_known) for one in result.reversals}
    several = len({one.name for one, _ in result.curves}) > 1
    every = [(f'table {name}' if several else 'table', [motions for one, motions in result.curves if one.name == name],
              summary.WHOLE) for name, is_known in known.items() if is_known]
    every += [(one.words, [motions], summary.NO_MEAN if one.name in known else summary.ONE_SENSE)
              for one, motions in result.curves if not known.get(one.name)]
    return [(words, four_axis_errors(motions, radius, height), contained) for words, motions, contained in every]


def _alone(result: JointResult, place: int) -> tuple[tuple[TableSet, ErrorMotions], ...]:
    """Return the curves that one of the runs determines by itself, with the noise of all; () where it cannot."""
    model = result.solution.model
    try:
        single = JointSolution(JointModel([model.runs[place]], Sharing.of(1, by_sense=model.sharing.by_sense)),
                               result.solution.beside.alone(place))
    except NotDeterminable:
        return ()
    return replace(result, solution=single, environment=None).curves


def _widths(one: TableSet, runs: Sequence[tuple[tuple[TableSet, ErrorMotions], ...]]) -> tuple[Floats, Floats] | None:
    """Return the largest width of the curves of runs at an angle, and its u, (6,) each, m and rad.

    Each curve is freed of what one run cannot know. None where fewer than two were measured at all angles of a turn."""
    if not same_angles(one.angle, nominal_angles(one.angle.size)):
        return None
    found = [motions for curves in runs for other, motions in curves if other.sense == one.sense
             and same_angles(other.angle, one.angle)]
    if len(found) < 2:
        return None
    curves = np.array([remove_gauge(motions.values) for motions in found])
    largest = np.max([motions.u.max(axis=0) for motions in found], axis=0)
    return np.ptp(curves, axis=0).max(axis=0), np.sqrt(2) * largest

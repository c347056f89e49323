# SPDX-License-Identifier: Apache-2.0
"""Curves of a table from two sources: of a run, of a correction, or of a table of its maker."""

from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.api.evaluating import ErrorCurves, Evaluation, JointEvaluation, evaluate
from rosette_ros.api.measurement import read
from rosette_ros.api.result import Result
from rosette_ros.core.table.curve_comparison import CurveComparison, TableCurves
from rosette_ros.core.table.curve_comparison import compare_curves as compared
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.curve_table import holds_curves, read_curves
from rosette_ros.io.own_readers import Columns
from rosette_ros.presentation.curve_results import comparison_table, curves_json, difference_table, sentences
from rosette_ros.presentation.table_format import Table


class CurvesCompared(Result):
    """Curves of two sources without what no run can know, and their differences; made: as the core has them."""

    def __init__(self, made: CurveComparison) -> None:
        self.made = made

    def to_mapping(self) -> dict[str, Any]:
        return curves_json(self.made)

    def sentences(self) -> tuple[str, ...]:
        return sentences(self.made)

    def tables(self) -> tuple[Table, ...]:
        return comparison_table(self.made), difference_table(self.made)


def compare_curves(first: Any, second: Any, columns: Columns | str | None = None) -> CurvesCompared:
    """Return how the curves of two sources differ: offsets and clamping parts are taken off both.

    Each is a table of curves (CSV: table_angle_deg, ctz_um, crz_urad ..., with u_ or U_ columns), a correction (YAML),
    an Evaluation, curves, or a run, which is evaluated; columns: of tables of another program, as of `read`. Raises
    InvalidData."""
    return CurvesCompared(compared(curves_of(first, columns), curves_of(second, columns)))


def curves_of(source: Any, columns: Columns | str | None = None) -> TableCurves:
    """Return the curves of one source, as of `compare_curves`."""
    if isinstance(source, str | Path):
        if holds_curves(source):
            return read_curves(source)
        if Path(source).suffix.lower() in ('.yaml', '.yml'):
            correction = read_correction(source)[0]
            motions = correction.forward
            sense = ', turning forward' * (not np.array_equal(motions.values, correction.backward.values))
            return TableCurves(f'{Path(source).name}{sense}', motions.angle, motions.values, motions.u)
    made = source if isinstance(source, ErrorCurves | Evaluation | JointEvaluation) else evaluate(read(source, columns))
    motions = (made if isinstance(made, ErrorCurves) else made.curves).motions
    name = made.judged.measured.name if isinstance(made, Evaluation) else 'curves'
    return TableCurves(Path(name).name, motions.angle, np.array(motions.values), np.array(motions.u))

# SPDX-License-Identifier: Apache-2.0
"""Curves of two sources side by side, for people and programs."""

import numpy as np

from rosette_ros.core.run.number_words import UNKNOWN, significant
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.curve_comparison import CurveComparison
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.json_output import CURVE_KEYS, Json, plain
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.words.effect_words import exact, names

SCHEMA = 'rosette-curve-comparison/1'


def sentences(made: CurveComparison) -> tuple[str, ...]:
    """Return in words how the curves agree, and how they were compared."""
    said = [f'{lead} {names(curves)}.' for lead, curves in (
        ('Within U:', made.agreeing(True)), ('Differ by more than U:', made.agreeing(False)),
        ('No U is stated of', made.agreeing(None))) if curves]
    said.append('Taken off both: the means of all curves, and the once-per-turn parts of (ctx, cty) and (crx, cry), '
                'which are how a plate is clamped.')
    if made.alone:
        said.append(f'{names(made.alone)} alone: a once-per-turn part of the clamping stays in '
                    f'{"it" if len(made.alone) == 1 else "them"}.')
    if made.interpolated:
        said.append(f'{made.interpolated} is interpolated at the {made.angle.size} angles of the other.')
    return tuple(said)


def comparison_table(made: CurveComparison) -> Table:
    """Return ranges of both, the largest difference with its U and angle, a row for each curve."""
    shown = [CURVES.index(curve) for curve in made.compared]
    scales, difference = text.curve_scales(), np.abs(made.difference)
    worst = [int(difference[:, place].argmax()) for place in shown]
    ranges = [[scales[place].factor * float(np.ptp(side[:, place])) for place in shown]
              for side in (made.first, made.second)]
    largest = [scales[place].factor * float(difference[at, place]) for place, at in zip(shown, worst, strict=True)]
    expanded = [COVERAGE_FACTOR * scales[place].factor * float(made.u[at, place])
                for place, at in zip(shown, worst, strict=True)]
    within = [made.within(curve) for curve in made.compared]
    return Table('comparison', f'{made.names[0]} less {made.names[1]}', (
        words('curve', 'curve', made.compared), words('unit', 'unit', [scales[place].unit for place in shown]),
        column('range_first_in_unit', f'range of {made.names[0]}', ranges[0], significant),
        column('range_second_in_unit', f'range of {made.names[1]}', ranges[1], significant),
        column('largest_difference_in_unit', 'largest difference', largest, significant),
        column('U_in_unit', f'its U (k = {COVERAGE_FACTOR})', expanded,
               lambda value: significant(value) if np.isfinite(value) else UNKNOWN),
        column('angle_deg', 'at', [float(np.rad2deg(made.angle[at])) for at in worst],
               lambda value: exact(value, 4), '°'),
        column('within_U', 'points within U', within,
               lambda share: UNKNOWN if share is None else text.percent(share))))


def difference_table(made: CurveComparison) -> Table:
    """Return the differences of all curves at each angle, with their U."""
    shown, scales = [CURVES.index(curve) for curve in made.compared], text.curve_scales()
    return Table('differences', f'Differences, with U (k = {COVERAGE_FACTOR})', (
        column('table_angle_deg', 'angle', np.rad2deg(made.angle), lambda value: exact(value, 4), '°'),
        *(column(f'{CURVES[place]}_{text.file_unit(scales[place].unit)}', CURVES[place],
                 scales[place].factor * made.difference[:, place], significant, scales[place].unit)
          for place in shown),
        *(column(f'U_{CURVES[place]}_{text.file_unit(scales[place].unit)}', '',
                 COVERAGE_FACTOR * scales[place].factor * made.u[:, place]) for place in shown)))


def curves_json(made: CurveComparison) -> Json:
    """Return the comparison, SI, schema rosette-curve-comparison/1; u: standard uncertainties of the differences."""
    keys = dict(zip(CURVES, CURVE_KEYS, strict=True))
    return plain({'schema': SCHEMA, 'first': made.names[0], 'second': made.names[1], 'angle_rad': made.angle,
                  'interpolated': made.interpolated, 'alone': made.alone,
                  'curves': {keys[curve]: {
                      'first': made.first[:, place], 'second': made.second[:, place],
                      'difference': made.difference[:, place],
                      'u': made.u[:, place] if made.within(curve) is not None else None,
                      'within_U': made.within(curve)}
                      for curve in made.compared for place in [CURVES.index(curve)]}})

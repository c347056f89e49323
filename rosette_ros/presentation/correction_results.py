# SPDX-License-Identifier: Apache-2.0
"""Corrections and what became of them, for people and programs."""

import numpy as np

from rosette_ros.core.correction import Correction
from rosette_ros.core.correction_check import CorrectionCheck
from rosette_ros.core.error_summary import COVERAGE_FACTOR, error_lines
from rosette_ros.core.records import CURVES
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.json_output import Json, plain
from rosette_ros.presentation.table_format import Table, words


def correction_table(correction: Correction) -> Table:
    """Return what a correction takes off: peak to valley and U of each error."""
    lines = error_lines(correction.forward)
    values = [1e6 * line.range for line in lines]
    u = [COVERAGE_FACTOR * 1e6 * line.u_point for line in lines]
    places = [text.decimals(one) for one in u]
    return Table('correction', 'What is corrected', (
        words('error', 'error', CURVES), words('unit', 'unit', text.CURVE_UNITS),
        words('range', 'range', map(text.fixed, values, places)), words('U', 'U', map(text.fixed, u, places)),
        words('what', 'correction', [
            'not corrected' if curve not in correction.corrected else
            'corrected, although it may be noise' if value < 2 * one else 'corrected'
            for curve, value, one in zip(CURVES, values, u)])),
        note=f'Range: peak to valley; U (k = {COVERAGE_FACTOR}) of a point of the curve.')


def check_table(check: CorrectionCheck) -> Table:
    """Return the errors before and after a correction."""
    rows = check.errors
    places = [text.decimals(1e6 * one.expanded) for one in rows]
    shown = {name: [text.fixed(1e6 * getattr(one, name), digits) for one, digits in zip(rows, places)]
             for name in ('before', 'promised', 'after', 'expanded')}
    return Table('correction', 'The errors before and after the correction', (
        words('error', 'error', [one.curve for one in rows]), words('unit', 'unit', text.CURVE_UNITS),
        words('before', 'before', shown['before']), words('promised', 'expected', shown['promised']),
        words('after', 'after', shown['after']), words('U', 'U of a point', shown['expanded']),
        words('gain', 'corrected by', ['' if not np.isfinite(one.gain) else text.percent(one.gain) for one in rows]),
        words('result', 'result', [one.result for one in rows])), levels=tuple(one.level for one in rows),
        note=f'Peak to valley; U (k = {COVERAGE_FACTOR}) of a point of the curve after, with that of the correction: '
             'noise spreads a curve of 6 to 36 points over 1.3 to 2.1 U.')


def check_json(check: CorrectionCheck, run_ids: tuple[str, str]) -> Json:
    """Return a CorrectionCheck, SI units; run_ids: before and after."""
    moved = check.misplaced
    return plain({'before': run_ids[0], 'after': run_ids[1], 'level': check.level, 'verdict': check.sentence,
            'action': check.action, 'shift_rad': moved.shift if moved else None,
            'u_shift_rad': moved.u if moved else None, 'angle_reversed': moved.sense < 0 if moved else False,
            'p_of_table': check.p_of_table, 'errors': [{
                'curve': one.curve, 'before': one.before, 'expected': one.promised, 'after': one.after,
                'U': one.expanded, 'taken_off': one.gain, 'u_taken_off': one.u_gain, 'p': one.p, 'result': one.result,
                'level': one.level} for one in check.errors]})

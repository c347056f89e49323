# SPDX-License-Identifier: Apache-2.0
"""Corrections and what became of them, for people and programs."""

from operator import attrgetter

import numpy as np

from rosette_ros.core.run.records import CURVES, SI_UNITS
from rosette_ros.core.table.correction import Correction
from rosette_ros.core.table.correction_check import CorrectionCheck
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import error_lines
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.json_output import Json, plain
from rosette_ros.presentation.table_format import Field, Table, fields_json, fields_table, words
from rosette_ros.words.effect_words import decimals, fixed, scale_of


def correction_table(correction: Correction) -> Table:
    """Return what a correction takes off: range and U of each error."""
    lines = error_lines(correction.forward)
    factors = text.curve_factors()
    values = factors * [line.range for line in lines]
    u = COVERAGE_FACTOR * factors * [line.u_point for line in lines]
    places = [decimals(one) for one in u]
    return Table('correction', 'What is corrected', (
        words('error', 'error motion', CURVES), words('unit', 'unit', text.curve_units()),
        words('range', 'range', map(fixed, values, places)),
        words('U', 'U of a single value', map(fixed, u, places)),
        words('what', 'correction', [
            'not corrected' if curve not in correction.corrected else
            'corrected, although it may be noise' if value < 2 * one else 'corrected'
            for curve, value, one in zip(CURVES, values, u)])),
        note=f'Range: largest value less smallest; U: expanded uncertainty (k = {COVERAGE_FACTOR}).')


def check_table(check: CorrectionCheck) -> Table:
    """Return the errors before and after a correction."""
    return fields_table(
        'correction', 'Error motions before and after the correction', CHECKED_ERROR, check.errors,
        [one.level for one in check.errors],
        f'Ranges; U: expanded uncertainty (k = {COVERAGE_FACTOR}) of a single value after, that of the correction '
        'included: noise spreads a curve of 6 to 36 points over 1.3 to 2.1 U.')


def _sized(key: str, name: str, get: str = '') -> Field:
    """Return the Field of a size in the unit of its curve, with as many decimals as U has."""
    size = attrgetter(get or key)
    return Field(key, name, get, number=False, text=lambda one: fixed(
        (factor := scale_of(SI_UNITS[one.curve]).factor) * size(one), decimals(factor * one.expanded)))


CHECKED_ERROR = (
    Field('curve', 'error motion', number=False),
    Field('unit', 'unit', lambda one: SI_UNITS[one.curve], lambda unit: scale_of(unit).unit, number=False),
    _sized('before', 'before'), _sized('expected', 'expected', 'promised'), _sized('after', 'after'),
    _sized('U', 'U of a single value', 'expanded'),
    Field('taken_off', 'corrected by', 'gain', lambda gain: text.percent(gain) if np.isfinite(gain) else '',
          number=False),
    Field('u_taken_off', '', 'u_gain'), Field('p'), Field('result', 'result', number=False),
    Field('level', files='json'))


def check_json(check: CorrectionCheck, run_ids: tuple[str, str]) -> Json:
    """Return a CorrectionCheck, schema rosette-verification/1, SI units; run_ids: before and after."""
    return plain({'schema': 'rosette-verification/1', 'before': run_ids[0], 'after': run_ids[1], 'level': check.level,
                  'verdict': check.sentence, 'action': check.action,
                  'p_of_table': check.p_of_table, 'errors': [fields_json(CHECKED_ERROR, one) for one in check.errors]})

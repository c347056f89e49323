# SPDX-License-Identifier: Apache-2.0
"""The six error motions in a line each, for people and programs: the summary after ISO 230-7."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rosette_ros.analysis import Change, RunResult
from rosette_ros.core.run.number_words import UNKNOWN, Tolerance, significant
from rosette_ros.core.run.records import CURVES, SI_UNITS, ErrorMotions
from rosette_ros.core.uncertainty import error_summary as summary
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import DECISION_RULE, SURE, AxisError, Conformity, SphereErrors
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.table_format import Column, Table, column, words
from rosette_ros.words.effect_words import decimals, exact, fixed, scale_of, tolerance_words

FourAxis = Sequence[tuple[str, Sequence[SphereErrors], str]]
"""Of each table its words, the errors of its test spheres, and what they contain of its reversal."""
LACKS = {summary.WHOLE: '', summary.NO_MEAN: 'the mean of its reversal, which these runs do not tell',
         summary.ONE_SENSE: 'the reversal of the table, which runs in both senses tell (evaluate --joint)'}
LEVELS = {Conformity.CONFORMS: 'good', Conformity.FAILS: 'bad', Conformity.UNDECIDED: 'doubtful', None: ''}
TITLE = 'Error motions of the {} (ISO 230-7): synchronous error motion values'
WHAT_IS_WHAT = (f'Range: largest value less smallest; U: k = {COVERAGE_FACTOR}; residual synchronous error motion: '
                'without the fundamental one, once per revolution.')


def errors_of(result: RunResult, tolerances: Mapping[str, Tolerance] | None = None) -> tuple[Table, ...]:
    """Return the table of the errors of a result and, where the fit as modelled stands beside it, that of this one.

    tolerances: of ranges by curve, m and rad, about which the result decides."""
    title, lines = TITLE.format('rotary table'), result.curves.lines(tolerances)
    if result.beside is None:
        return (errors(lines, title),)
    which, beside = result.beside.which, errors(result.beside.lines(), title, 'errors_as_modelled')
    return (errors(lines, f'{title}, {result.curves.which}'),
            replace(beside, title=f'{title}, {which}', note=''))


def errors(lines: Sequence[AxisError], title: str = TITLE.format('rotary table'), name: str = 'errors') -> Table:
    """Return the table of AxisErrors: what is not stated of any of them has no column."""
    scales = [scale_of(SI_UNITS[line.curve]) for line in lines]

    def shown(value: float | None, line: AxisError) -> str:
        factor = scale_of(SI_UNITS[line.curve]).factor
        return '' if value is None else fixed(factor * value, decimals(factor * line.expanded))

    def micro(key: str, head: str, values: Sequence[float | None], sign: str = '') -> Column:
        return Column(key, head, tuple(None if value is None else one.factor * value
                                       for value, one in zip(values, scales, strict=True)),
                      tuple(f'{sign}{shown(value, line)}' for value, line in zip(values, lines, strict=True)))

    several = any(line.asynchronous is not None for line in lines)
    limited = any(line.tolerance is not None for line in lines)
    doubts = dict.fromkeys(line.doubt for line in lines if line.doubt and line.tolerance is not None)
    width = (' Asynchronous error motion value: the largest width of the curves of the runs at an angle, their noise '
             'included.' if several else '')
    return Table(name, title, (
        words('error', 'error motion', [f'{line.curve} ({line.name}) / {one.unit}'.replace('-', '−')
                                 for line, one in zip(lines, scales, strict=True)]),
        column('unit', '', [one.unit for one in scales]),
        micro('range_in_unit', 'range', [line.range for line in lines]),
        micro('U_range_in_unit', 'U of the range', [line.expanded for line in lines], '±'),
        micro('U_point_in_unit', 'largest U of the curve', [COVERAGE_FACTOR * line.u_point for line in lines], '±'),
        micro('once_per_turn_in_unit', 'fundamental error motion', [line.once_per_turn for line in lines]),
        micro('residual_in_unit', 'residual synchronous error motion', [line.residual for line in lines]),
        *((micro('asynchronous_in_unit', 'asynchronous error motion', [line.asynchronous for line in lines]),
           micro('U_asynchronous_in_unit', 'U of the width', [_expanded(line) for line in lines], '±')
           ) if several else ()),
        *((Column('tolerance_in_unit', 'tolerance', tuple(
            None if line.tolerance is None else one.factor * line.tolerance for line, one in zip(lines, scales)), tuple(
                '' if line.tolerance is None else tolerance_words(line.tolerance, one.unit)
                for line, one in zip(lines, scales))),
           words('conformity', 'ISO 14253-1', [conformity_words(line) for line in lines])) if limited else ())),
        levels=tuple(LEVELS[line.conformity] for line in lines),
        note=f'{WHAT_IS_WHAT}{_factors(lines)}{width}' + f' Decision rule: {DECISION_RULE}.' * limited
        + ''.join(f' Neither conformity nor non-conformity is stated: {doubt}.' for doubt in doubts))


def conformity_words(line: AxisError) -> str:
    """Return whether an error conforms to its tolerance, '' without one: as doubted, nothing is stated of it."""
    if line.tolerance is not None and line.doubt:
        return 'not stated'
    return line.conformity or ''


def _factors(lines: Sequence[AxisError]) -> str:
    """Return k of the ranges whose error is not normal, in a sentence, and how conformity is decided then."""
    span = dict.fromkeys(fixed(one, 2) for one in sorted(line.factor for line in lines if line.spread is not None))
    if not span.keys() - {fixed(COVERAGE_FACTOR, 2)}:
        return ''
    ends = ' to '.join(dict.fromkeys((min(span), max(span))))
    return (f' U of the range: half of the interval, k = {ends}, that holds 95.45 % of its distribution; conformity '
            f'is stated from a probability of {fixed(100 * SURE, 1)} % on (JCGM 106).')


def differences(every: Mapping[str, ErrorMotions]) -> Table:
    """Return by how much curves of runs differ, by name: the largest difference at an angle, beside its U."""
    columns = [words('run', 'run', every)]
    for place, (curve, (factor, unit)) in enumerate(zip(CURVES, text.curve_scales(), strict=True)):
        shown, worst, spread = [], [], []
        for one in every.values():
            at = int(np.argmax(np.abs(one.values[:, place])))
            worst.append(factor * float(one.values[at, place]))
            spread.append(factor * COVERAGE_FACTOR * float(one.u[at, place]))
            digits = decimals(spread[-1])
            shown.append(f'{text.signed(worst[-1], digits)} ±{fixed(spread[-1], digits)}')
        key = f'{curve}_{text.file_unit(unit)}'
        columns += [Column(key, curve, tuple(worst), tuple(shown), unit), Column(f'U_{key}', '', tuple(spread), None)]
    return Table('differences', 'Differences of the curves', tuple(columns),
                 note=f'The largest difference at an angle, with U (k = {COVERAGE_FACTOR}) of both runs at that angle. '
                 'Of many angles the largest is beyond U now and then by chance.')


def curve_changes(change: Change) -> Table:
    """Return what a change of the model does to each curve: its largest change, its uncertainties."""
    return Table('curve_changes', f'Change of the curves; U: expanded uncertainty (k = {COVERAGE_FACTOR})', (
        words('curve', 'curve', text.curve_names(change.before.run.rotation)),
        words('unit', 'unit', text.curve_units()),
        *(column(f'{key}_in_unit', name, text.curve_factors() * values, partial(fixed, places=3))
          for key, name, values in (
              ('change', 'largest change', change.curve_change),
              ('U_before', 'U before', COVERAGE_FACTOR * change.before.error_motions.u.max(axis=0)),
              ('U_after', 'U after', COVERAGE_FACTOR * change.after.error_motions.u.max(axis=0))))))


def change_errors(change: Change) -> Table:
    """Return the errors of a run before and after a change of the model."""
    fits = change.before, change.after
    errors = change.cross_validation_before, change.cross_validation_after
    rows: list[tuple[str, str, list[Any], Callable[[Any], str]]] = [
        ('residual', 'µm', [1e6 * fit.rms for fit in fits], partial(fixed, places=3)),
        ('reduced χ²', '', [fit.reduced_chi_square for fit in fits], chi_square_text),
        (text.CROSS_VALIDATION, 'µm', [1e6 * one for one in errors], partial(fixed, places=3)),
        ('degrees of freedom', '', [fit.dof for fit in fits], str)]
    return Table('change', 'Residual before and after', (
        words('quantity', 'quantity', [name for name, *_ in rows]), words('unit', 'unit', [row[1] for row in rows]),
        *(Column(key, key, tuple(values[side] for _, _, values, _ in rows),
                 tuple(show(values[side]) for _, _, values, show in rows))
          for side, key in enumerate(('before', 'after')))))


def chi_square_text(value: float | None) -> str:
    """Return a reduced chi-square for people."""
    return UNKNOWN if value is None else significant(value)


def four_axis_table(every: FourAxis, which: str = '') -> list[Table]:
    """Return the four-axis errors of each table (ISO 10360-3); which: model."""
    return [_spheres(made, f'Four-axis errors of the {who}{which} (ISO 10360-3), calculated from its error motions',
                     LACKS[of], f'test_spheres{place or ""}') for place, (who, made, of) in enumerate(every)]


def _spheres(made: Sequence[SphereErrors], title: str, lacks: str, name: str) -> Table:
    expanded = [COVERAGE_FACTOR * one.u for one in made]
    places = [decimals(1e6 * float(one.max())) for one in expanded]

    def micro(key: str, head: str, sign: str, values: Sequence[float]) -> Column:
        return Column(key, head, tuple(1e6 * value for value in values), tuple(
            f'{sign}{fixed(1e6 * value, digits)}' for value, digits in zip(values, places, strict=True)), 'µm')

    return Table(name, title, (
        words('sphere', 'sphere', [one.sphere for one in made]),
        *(column(f'{key}_mm', head, [1e3 * getattr(one, key) for one in made], partial(exact, places=3), 'mm')
          for key, head in (('radius', 'radius'), ('height', 'above the balls'))),
        *(part for at, kind in enumerate('RTA') for part in (
            micro(f'F{kind}_um', f'F{kind}', '', [float(one.ranges[at]) for one in made]),
            micro(f'U_F{kind}_um', f'U of F{kind}', '±', [float(one[at]) for one in expanded])))),
        note='FR, FT, FA: ranges of the radial, tangential and axial coordinate of the sphere, in coordinates that '
             f'turn with the table about its mean axis; U: k = {COVERAGE_FACTOR}. Other than in a test with spheres, '
             f'errors of the CMM are not in them{", nor " * bool(lacks)}{lacks}.')


def four_axis_json(every: FourAxis) -> dict[str, Any]:
    """Return four-axis errors, SI units, nothing where there are none."""
    return {'iso_10360_3': [{'table': who, 'not_contained': LACKS[of], 'coverage_factor': COVERAGE_FACTOR, 'spheres': [{
        'sphere': one.sphere, 'radius_m': one.radius, 'height_m': one.height, **{
            f'{key}F{kind}_m': float(values[at]) for at, kind in enumerate('RTA')
            for key, values in (('', one.ranges), ('U_', COVERAGE_FACTOR * one.u))}} for one in made]}
        for who, made, of in every]} if every else {}


def errors_json(lines: Sequence[AxisError]) -> dict[str, Any]:
    """Return AxisErrors, SI units; U: expanded uncertainties."""
    return {'coverage_factor': COVERAGE_FACTOR, 'decision_rule': DECISION_RULE, 'errors': [{
        'curve': line.curve, 'iso_name': line.name, 'unit': SI_UNITS[line.curve],
        'range': line.range, 'U_range': line.expanded, 'U_point': COVERAGE_FACTOR * line.u_point,
        'once_per_turn': line.once_per_turn, 'residual': line.residual, 'asynchronous': line.asynchronous,
        'k_range': line.factor, 'probability_of_conformity': line.within,
        'U_asynchronous': _expanded(line), 'tolerance': line.tolerance, 'conformity': line.conformity and str(
            line.conformity), 'doubt': line.doubt} for line in lines]}


def _expanded(line: AxisError) -> float | None:
    return None if line.u_asynchronous is None else COVERAGE_FACTOR * line.u_asynchronous

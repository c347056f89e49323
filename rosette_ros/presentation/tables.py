# SPDX-License-Identifier: Apache-2.0
"""Tables of a run, a diagnosis, orders and changes, built once for terminal, report, studio and CSV."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from rosette_ros.analysis import LadderStep, RunResult, Summary
from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.comparison import DRAWS, Comparison
from rosette_ros.core.diagnosis.second_run import CheckOutcome, CrossCheck
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.effects.custom import AMPLITUDE
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.run_functions import around
from rosette_ros.core.model.least_squares import Fit, Parameter
from rosette_ros.core.model.model import BASE_TERMS, Model
from rosette_ros.core.model.noise import AXES
from rosette_ros.core.planning.advice import Advice
from rosette_ros.core.run.errors import counted
from rosette_ros.core.run.number_words import UNKNOWN, Scale, Tolerance, multiple, p_value
from rosette_ros.core.run.records import CURVES, UNLIKELY, ErrorMotions, Floats, Run
from rosette_ros.core.sight.visibility import GOOD_SHARE, Visibility
from rosette_ros.core.uncertainty.clamped_plate import clamped_plate
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import AxisError, peak_to_valley
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.error_results import chi_square_text, errors_of
from rosette_ros.presentation.explanation_results import causes
from rosette_ros.presentation.table_format import (
    Column,
    Field,
    Table,
    column,
    fields_table,
    micrometre_column,
    parameters_json,
    verdict_json,
    words,
)
from rosette_ros.words.effect_words import MEANINGS, decimals, exact, fixed, scale_of, setting_words, title_of
from rosette_ros.words.result_words import reason_words
from rosette_ros.words.verdict_words import verdict_text

EXPANDED = f'U: expanded uncertainty (k = {COVERAGE_FACTOR})'
ABSORBED = ('Sensitivity: share of an effect that is not absorbed by table, plate and CMM deviations, but shows in the '
            'residual.')
CURVES_SCHEMA = 'rosette-curves/1'
STANDARD_U = f'columns u_: standard uncertainties (k = 1); U = {COVERAGE_FACTOR} u'
WORST = 6
NEGLIGIBLE = 0.05
"""Bias of the curves, µm or µrad per µm rms of an effect, below which plate and CMM deviations absorb it."""
LARGEST_LIMIT = 100.0
ANGLE_DECIMALS = 9
"""1e-9 degrees are 3 pm at 182.5 mm."""
ALIKE = 0.05
"""Relative range of uncertainties that are told once, by the largest."""
LEAST_NOISE = 1e-15
"""What stands for the noise of readings that have none, m: nothing is divided by zero."""
LEAST_P = 1 / (DRAWS + 1)
"""Smallest probability that the draws of a comparison can show."""
BARS, GAP, MOST_BARS = '▁▂▃▄▅▆▇█', '·', 40


def tables_of(summary: Summary, tolerances: Mapping[str, Tolerance] | None = None,
              result: RunResult | None = None) -> tuple[Table, ...]:
    """Return every table of a run, in the order of the report.

    tolerances: of ranges by curve, m and rad; result: with what is stated for U, None for that of the summary."""
    result = result or summary.result
    comparison, diagnosis, best = summary.comparison, summary.diagnosis, summary.advice.best if summary.advice else None
    fit = summary.fit
    return (*errors_of(result, tolerances), *curves_of(result),
            deviations(fit, result.modelled.which if result.beside else ''),
            axes(comparison), places(comparison), worst_readings(comparison),
            residuals(fit, summary.final), causes(summary.verdict),
            groups(comparison), nested_models(summary.ladder), candidates(diagnosis.candidates, summary.run),
            fitted_effects(summary.final, f'Effects {"found" if result.beside else "in the model"}'),
            visibility(summary.visibilities, best.visibilities if best else ()),
            bias(summary.visibilities, summary.run.rotation), *([orders(summary.advice)] if summary.advice else []))


def curves_of(result: RunResult) -> tuple[Table, ...]:
    """Return the six curves of a result and, where the fit as modelled stands beside it, those of this one."""
    if result.beside is None:
        return (curves(result.curves.motions),)
    return tuple(curves(one.motions, one.which, name) for one, name in (
        (result.curves, 'curves'), (result.beside, 'curves_as_modelled')))


def curves_csv(result: RunResult, tolerances: Mapping[str, Tolerance] | None = None) -> str:
    """Return the six curves of a result as CSV; above them in '#' lines the verdict, the model, ranges with U.

    tolerances: of ranges by curve, m and rad."""
    one, verdict = result.curves, verdict_json(verdict_text(result.verdict) if result.verdict else None)
    heading: list[tuple[str, Any]] = [
        ('schema', CURVES_SCHEMA), ('run_id', one.fit.run.run_id), ('result', one.which),
        ('model', ' + '.join(result.fit.model.names)), *verdict.items(),
        *([('missing', ', '.join(result.found.missing))] if result.found and result.found.missing else []),
        ('uncertainties', STANDARD_U)]
    return curves(one.motions).csv([*heading, *range_rows(one.lines(tolerances))])


def range_rows(lines: Iterable[AxisError]) -> list[tuple[str, Any]]:
    """Return ranges with U, and what is decided about tolerances, as (key, value) of a file."""
    out: list[tuple[str, Any]] = []
    for line, (factor, unit) in zip(lines, text.curve_scales(), strict=True):
        key = f'{line.curve}_{text.file_unit(unit)}'
        out += [(f'range_{key}', factor * line.range), (f'U_range_{key}', factor * line.expanded)]
        if line.tolerance is not None:
            out += [(f'tolerance_{key}', factor * line.tolerance), (f'conformity_{line.curve}', line.conformity)]
    return out


def curves(motions: ErrorMotions, which: str = '', name: str = 'curves') -> Table:
    """Return the six curves; for people with U, below the curve where it is the same at all angles; which: model."""
    factors, units = text.curve_factors(), text.curve_units()
    values, u = factors * motions.values, factors * motions.u
    expanded = COVERAGE_FACTOR * u
    alike, spans = _alike(u), peak_to_valley(values)
    columns = [column('table_position', 'table position', range(1, len(values) + 1), str, footer=('',) * (1 + alike)),
               column('table_angle_deg', 'angle', np.round(np.rad2deg(motions.angle), ANGLE_DECIMALS),
                      partial(exact, places=4), '°',
                      footer=(*[f'U (k = {COVERAGE_FACTOR}) of each point'] * alike, 'range'))]
    names = text.curve_names(motions.rotation)
    for place, (curve, unit) in enumerate(zip(CURVES, units, strict=True)):
        digits = decimals(float(np.median(expanded[:, place])))
        shown = _with_u(values[:, place], expanded[:, place], digits, alike)
        span, largest = float(spans[place]), float(expanded[:, place].max())
        footer = *[f'±{fixed(largest, digits)}'] * alike, fixed(span, digits)
        columns.append(Column(f'{curve}_{text.file_unit(unit)}', names[place], tuple(values[:, place].tolist()),
                              shown, unit, footer=footer))
    columns += [column(f'u_{curve}_{text.file_unit(unit)}', '', u[:, place])
                for place, (curve, unit) in enumerate(zip(CURVES, units, strict=True))]
    note = text.axis_note(motions.rotation)
    return Table(name, f'Six error motions of the table{f", {which}" * bool(which)}; {EXPANDED}', tuple(columns),
                 note=f'{note[:1].upper()}{note[1:]}.' if note else '')


def _alike(u: Floats) -> bool:
    """Return whether uncertainties (n, k) are practically the same in each column."""
    known = u[np.isfinite(u).all(axis=1)]
    return bool(len(known) and np.all(np.ptp(known, axis=0) <= ALIKE * known.max(axis=0)))


def _with_u(values: Floats, expanded: Floats, digits: int, alike: bool) -> tuple[str, ...]:
    """Return values as texts, each with its expanded uncertainty where these are not alike."""
    return tuple(text.signed(value, digits) + ('' if alike or np.isnan(value) else f'\n±{fixed(spread, digits)}')
                 for value, spread in zip(values, expanded, strict=True))


def deviations(fit: Fit, which: str = '') -> Table:
    """Return ball centre deviations, freed of the clamping, and CMM measurement errors, with U as `curves` has it.

    which: of the fit, where there are two."""
    plate = clamped_plate(fit)
    parts = (('plate', 'plate', plate.freed, plate.u_freed), ('cmm', 'CMM', fit.cmm, fit.deviation_u[1]))
    alike = _alike(np.hstack([u for *_, u in parts]))
    columns = [column('number', 'ball or CMM position', range(1, len(fit.plate) + 1), str,
                      footer=(f'U (k = {COVERAGE_FACTOR}) of each point',) * alike)]
    for key, name, values, u in parts:
        for place, axis in enumerate(AXES):
            expanded = 1e6 * COVERAGE_FACTOR * u[:, place]
            digits = decimals(float(np.nanmedian(expanded)))
            columns.append(Column(f'{key}_{axis}_um', f'{name} {axis}', tuple((1e6 * values[:, place]).tolist()),
                                  _with_u(1e6 * values[:, place], expanded, digits, alike), 'µm',
                                  footer=(f'±{fixed(float(np.nanmax(expanded)), digits)}',) * alike))
    columns += [column(f'u_{key}_{axis}_um', '', 1e6 * u[:, place])
                for key, _, _, u in parts for place, axis in enumerate(AXES)]
    clamping = text.clamping_words(plate.shift, plate.turn, plate.u)
    return Table('deviations', 'Ball centre deviations and CMM measurement errors at the probing positions'
                 f'{f", {which}" * bool(which)}; {EXPANDED}', tuple(columns),
                 note=f'Clamping of the plate, which is not in its deviations, with U: {clamping}.')


def effects(fitted: Iterable[tuple[str, Mapping[str, object], Sequence[Parameter]]], title: str,
            time: str) -> Table:
    """Return the parameters of (name, setting, parameters) of fitted effects; time: Run.time_unit."""
    rows = [(name, setting, one, [other.name for other in parameters])
            for name, setting, parameters in fitted for one in text.joined(parameters)]
    shown = [text.shown_parameter(one) for _, _, one, _ in rows]
    return Table('effects', f'{title}; {EXPANDED}', (
        words('effect', 'effect', [name for name, _, _, _ in rows]),
        words('parameter', 'parameter', [one.name for _, _, one, _ in rows]),
        *(column(f'{key}_si', '', [getattr(one, key.removesuffix('_si')) for _, _, one, _ in rows])
          for key in ('value', 'u', 'unit')),
        *(Column(key, name, tuple(text.sized_parameter(one)[place] for _, _, one, _ in rows),
                 tuple(one[place] for one in shown))
          for place, (key, name) in enumerate((('value', 'value'), ('expanded_uncertainty', 'U')))),
        words('unit', 'unit', [one[2] for one in shown]),
        words('setting', 'when and where',
              [setting_words(name, setting, known, time=time) for name, setting, _, known in rows])),
        note=' '.join(
            [*['Not determined: cannot be told from other parameters of the model.'] * any(
                not np.isfinite(one.u) for _, _, one, _ in rows),
             *[AMPLITUDE] * any(name.partition('(')[0] not in MEANINGS for name, _, _, _ in rows)]))


def fitted_effects(fit: Fit, title: str) -> Table:
    """Return the parameters of the effects of a model."""
    return effects([(one.name, one.setting, one.parameters) for one in fit.effects], title, fit.run.time_unit)


def noise_of(fit: Fit) -> tuple[float, str]:
    """Return what residuals are divided by, m, and its name: the repeatability where it is known."""
    if fit.run.repeatability is not None:
        return fit.run.repeatability, 'the repeatability'
    return max(fit.rms, LEAST_NOISE), 'the rms of all residuals; the repeatability is not known'


def axes(comparison: Comparison) -> Table:
    """Return the residual by axis."""
    sigma = noise_of(comparison.fit)[0]
    return Table('residual_axes', 'Residual by axis', (
        words('axis', 'axis', AXES), micrometre_column('rms_um', 'rms', comparison.axis_rms),
        column('rms_sigma', 'in σ', comparison.axis_rms / sigma, multiple)))


def places(comparison: Comparison) -> Table:
    """Return, for each grouping of the residuals, a bar for every group and the group with the largest residual."""
    sigma, every = noise_of(comparison.fit)[0], comparison.distinct
    sizes = [np.sqrt(np.mean(one.rms**2, axis=1)) / sigma for one in every]
    largest = [*(float(np.nanmax(size)) for size in sizes), float('nan')]
    top = max(largest[:-1])
    p = [*(one.p for one in every), comparison.neighbour_p]
    return Table('worst_places', f'Residual by group; a full bar is {text.sigmas(top)}', (
        words('by', 'grouped by', [*(one.label for one in every), 'autocorrelation']),
        words('profile', 'first to last group', [
            *(bars(size, top) for size in sizes), f'{text.signed(comparison.neighbour_correlation, 2)} (lag 1)']),
        words('worst', 'largest at', [*(one.keys[one.worst].removeprefix('between ').replace(' and ', ' to ')
                                        for one in every), '']),
        micrometre_column('rms_um', 'its rms', [size * sigma for size in largest]),
        column('rms_sigma', 'in σ', largest, lambda one: text.sigmas(one) if np.isfinite(one) else UNKNOWN),
        column('p', text.P_VALUE, p, _p_of_draws)), levels=_marked(p))


def _p_of_draws(p: float) -> str:
    return '<0.003' if p == LEAST_P else p_value(p)


def bars(sizes: Floats, top: float) -> str:
    """Return a row of bars, `top` being the highest, NaN a gap; more than MOST_BARS are joined by their largest."""
    if sizes.size > MOST_BARS:
        sizes = np.array([np.fmax.reduce(part) for part in np.array_split(sizes, MOST_BARS)])
    share = np.clip(sizes / top, 0, 1) if top > 0 else np.where(np.isnan(sizes), np.nan, 0.0)
    return ''.join(GAP if np.isnan(part) else BARS[min(int(part * len(BARS)), len(BARS) - 1)] for part in share)


def _marked(p: Iterable[float]) -> tuple[str, ...]:
    return tuple(Level.BAD if one < UNLIKELY else '' for one in p)


def worst_readings(comparison: Comparison) -> Table:
    """Return the readings with the largest residuals."""
    worst = comparison.worst[:WORST]
    return Table('worst_readings', 'Readings with the largest residuals', (
        *(column(key, name, [getattr(one, attribute) for one in worst], str) for key, name, attribute in (
            ('reading', 'reading', 'number'), ('table_position', 'table position', 'table_position'),
            ('ball', 'ball', 'ball'), ('cmm_position', 'CMM position', 'cmm_position'))),
        *(micrometre_column(f'{axis}_um', axis, [one.residual[place] for one in worst], sign=True)
          for place, axis in enumerate(AXES)),
        column('size_sigma', 'residual / rms', [one.size for one in worst], partial(fixed, places=1)),
        column('weight', 'weight', [one.weight for one in worst], partial(fixed, places=2)),
        *(column(f'without_{what}_{text.file_unit(unit)}', f'change of {what}', [
            np.nan if one.without is None else factor * max(one.without[part]) for one in worst], partial(
                fixed, places=2), unit) for what, part, (factor, unit) in _parts()),
        column('p', text.P_VALUE, [one.p for one in worst], _p_of_draws)), levels=_marked(one.p for one in worst),
        note='p-value: outlier test, Bonferroni; change: the largest of ctx, cty, ctz and of crx, cry, crz when the '
             'reading is omitted.')


def _parts() -> tuple[tuple[str, slice, Scale], ...]:
    """Return translations and rotations: name, which of the six curves, how they are shown."""
    return ('ct', slice(3), scale_of('m')), ('cr', slice(3, 6), scale_of('rad'))


def reading(fit: Fit, place: int) -> Table:
    """Return one reading with its residual; place: 0..N-1."""
    run, residual = fit.run, fit.residual[place]
    minutes, temperature = float(run.time[place] - run.time[0]) / 60, float(run.temperature[place])
    return Table('reading', f'Reading {place + 1}', (
        *(column(key, name, [int(value)], str) for key, name, value in (
            ('reading', 'reading', place + 1), ('table_position', 'table position', run.table_position[place]),
            ('ball', 'ball', run.ball[place]), ('cmm_position', 'CMM position', run.cmm_position[place]))),
        column('table_angle_deg', 'table angle', [float(np.rad2deg(run.table_angle[place] + run.table_offset))],
               partial(fixed, places=2), '°'),
        *[column('time_min', 'time', [minutes], partial(fixed, places=1), 'min')] * (run.time_unit == 's'),
        column('temperature_C', 'temperature', [temperature], partial(fixed, places=2), '°C'),
        *(micrometre_column(f'{axis}_um', axis, [size], sign=True) for axis, size in zip(AXES, residual)),
        column('size_sigma', 'residual / rms', [float(np.sqrt(np.mean(residual**2))) / noise_of(fit)[0]],
               partial(fixed, places=1))))


def residuals(before: Fit, after: Fit) -> Table:
    """Return every reading with its residual under two models: for the file alone."""
    run = before.run
    numbers = [('reading', np.arange(1, run.size + 1)), ('table_position', run.table_position),
               ('ball', run.ball), ('cmm_position', run.cmm_position), ('time_s', run.time),
               ('table_angle_deg', np.rad2deg(run.table_angle + run.table_offset)), ('temperature_C', run.temperature)]
    numbers += [(f'{when}_{axis}_um', 1e6 * fit.residual[:, place])
                for when, fit in (('before', before), ('after', after)) for place, axis in enumerate(AXES)]
    return Table('residuals', 'Residuals', tuple(column(key, key, values) for key, values in numbers))


def groups(comparison: Comparison) -> Table:
    """Return every group of residuals: for the file alone."""
    rows = [(one, place) for one in comparison.groupings for place in range(len(one.keys))]
    return Table('residual_groups', 'Residuals by group', (
        column('by', 'by', [one.label for one, _ in rows]),
        column('group', 'group', [one.keys[place] for one, place in rows]),
        *(column(f'{what}_{axis}_um', '', [1e6 * getattr(one, what)[place, k] for one, place in rows])
          for what in ('rms', 'mean') for k, axis in enumerate(AXES))))


def nested_models(steps: Sequence[LadderStep]) -> Table:
    """Return models, each with one effect more, and the residual of each in the fit and in cross-validation."""
    fits, errors = [step.fit for step in steps], [step.cross_validation for step in steps]
    change = [None, *(after / before - 1 for before, after in pairwise(errors))][:len(steps)]
    return Table('ladder', 'Nested models: the residual after each effect that is added', (
        words('model', 'model', nested_names(steps)),
        micrometre_column('rms_um', 'residual', [fit.rms for fit in fits]),
        column('reduced_chi_square', 'reduced χ²', [fit.reduced_chi_square for fit in fits], chi_square_text),
        column('rank', '', [fit.rank for fit in fits]),
        column('parameters', 'parameters', [3 * fit.run.size - fit.dof for fit in fits], str),
        column('dof', 'degrees of freedom', [fit.dof for fit in fits], str),
        micrometre_column('held_out_rms_um', text.CROSS_VALIDATION, errors),
        column('held_out_change', 'change', change,
               lambda one: '' if one is None else f'{text.signed(100 * one, 0)} %')))


def nested_names(steps: Sequence[LadderStep]) -> list[str]:
    """Return the names of nested models: the base, then what each adds."""
    return [f'+ {step.added}' if step.added else base_name(step.fit.model) for step in steps]


def base_name(model: Model) -> str:
    """Return what the base of a model is."""
    return 'base model' if model.base == BASE_TERMS else ' + '.join(model.base) or 'nothing'


def candidates(every: Sequence[MissingEffect], run: Run, title: str = 'Candidates, most significant first') -> Table:
    """Return candidates with probability, size and effects that they cannot be told from; run: of the diagnosis."""
    size = Field('size', 'size', lambda one: size_words(one.name, one.parameters, one.setting, run),
                 number=False)
    fields = [size if one.key == 'parameters' else one for one in CANDIDATE]
    return fields_table('candidates', f'{title}; each fitted together with the identified ones above it', fields, every)


def _both(key: str, name: str, without: str, present: str) -> tuple[Field, ...]:
    """Return a residual without and with an effect; people see both in one column."""
    return (Field(f'{key}_before_m', '', without, unit='µm'),
            Field(f'{key}_after_m', f'{name} without → with it', present, unit='µm',
                  text=partial(_before_after, attrgetter(without, present))))


def _before_after(both: Callable[[Any], tuple[float, float]], record: Any) -> str:
    return text.before_after(*both(record))


CANDIDATE = (
    Field('effect', 'effect', 'name', number=False), Field('claimed', 'identified', number=False),
    Field('probability', 'probability', 'is_there', show=text.percent), Field('p', text.P_VALUE, show=p_value),
    Field('parameters', get=lambda one: parameters_json(one.parameters), files='json'),
    Field('visible_fraction', text.SENSITIVITY, show=text.percent), *_both('rms', 'residual', 'before', 'after'),
    Field('look_alikes', 'cannot be told from', number=False,
          text=lambda one: ', '.join(map(title_of, one.look_alikes))), Field('setting', files='json'))


def size_words(effect: str, parameters: Sequence[Parameter], setting: Mapping[str, float | str],
               run: Run | None = None) -> str:
    """Return the parameters of an effect with expanded uncertainties, and when and where it is.

    run: in which it was found, where that places moments only between readings."""
    shown = [(one.name, *text.shown_parameter(one)) for one in text.joined(parameters)]
    parts = ', '.join(f'{name} {value} {spread} {unit}'.strip() for name, value, spread, unit in shown)
    times = MEANINGS[effect].moments(run, Setting(setting)) if run and effect in MEANINGS else {}
    moments = {name: around(some, float(setting[name])) for name, some in times.items()}
    searched = setting_words(effect, setting, [one.name for one in parameters], moments,
                                  run.time_unit if run else 's')
    return '; '.join(filter(None, (parts, searched)))


def cross_check(check: CrossCheck) -> Table:
    """Return what another run says of the effects that were learnt on a first one."""
    return fields_table(
        'cross_check', 'Effects checked on the other run', CHECKED, check.effects,
        ['' if one.outcome is CheckOutcome.CONFIRMED else Level.DOUBTFUL for one in check.effects],
        note=f'All together: {text.CROSS_VALIDATION} '
             f'{text.before_after(check.cross_validation_before, check.cross_validation_after)} µm; with the '
             f'amplitudes of the first run and nothing fitted: {text.micro(check.cross_validation_carried)} µm.')


CHECKED = (
    Field('effect', 'effect', 'name', number=False), Field('outcome', 'outcome', number=False),
    Field('visible_fraction', text.SENSITIVITY, show=text.percent), Field('p', text.P_VALUE, show=p_value),
    *_both('rms', 'residual', 'rms_without', 'rms_with'),
    *_both('held_out_rms', text.CROSS_VALIDATION, 'cross_validation_without', 'cross_validation_with'),
    Field('same_size', 'same size', text=lambda one: {True: 'yes', False: 'no', None: ''}[one.same_size], number=False),
    Field('reason', get=reason_words, files='json'), *(Field(name, files='json') for name in ('carries', 'setting')),
    *(Field(name, get=partial(lambda name, one: parameters_json(getattr(one, name)), name), files='json')
      for name in ('learnt', 'found')))


def visibility(every: Sequence[Visibility], recommended: Sequence[Visibility] = ()) -> Table:
    """Return the sensitivity of an order to every effect, beside that of the recommended one."""
    best = {one.name: one for one in recommended}
    beside = [best.get(one.name) for one in every]
    return Table('visibility', 'Sensitivity of the order of measurement to every effect', (
        words('effect', 'effect', [one.name for one in every]),
        words('title', 'effect', [title_of(one.name) for one in every]),
        words('meaning', 'meaning', [MEANINGS[one.name].meaning for one in every]),
        column('typical_visible_fraction', f'{text.SENSITIVITY}, typical', [one.typical_share for one in every],
               text.percent),
        column('visible_fraction', f'{text.SENSITIVITY}, at best', [one.share for one in every], text.percent),
        column('detectable_rms_um', f'{text.LIMIT}, rms', [1e6 * one.detectable for one in every], _limit, 'µm'),
        column('recommended_order_visible_fraction', 'recommended order: typical',
               [one.typical_share if one else None for one in beside],
               lambda one: '' if one is None else text.percent(one)),
        column('recommended_order_detectable_rms_um', f'recommended order: {text.LIMIT}, rms',
               [1e6 * one.detectable if one else None for one in beside], _limit, 'µm'),
        words('remark', 'remark', [_remark(one) for one in every])),
        levels=tuple('' if one.reason or one.typical_share >= GOOD_SHARE else
                     Level.BAD if one.hidden else Level.DOUBTFUL for one in every), note=ABSORBED)


def weak_effects(every: Table, most: int) -> Table:
    """Return of a table of `visibility` the effects to which the order has a low sensitivity, the lowest first."""
    shares = next(one.values for one in every.columns if one.key == 'typical_visible_fraction')
    weak = sorted((row for row in range(len(shares)) if every.level(row)),
                  key=lambda row: 0.0 if every.level(row) is Level.BAD else shares[row])
    more = f', the first {most}' * (len(weak) > most)
    return replace(every.only(weak[:most]), name='weak',
                   title=f'Low sensitivity of this order: {len(weak)} of {counted(len(shares), "effect")}{more}')


def _limit(value: float | None) -> str:
    """Return a detection limit, µm; above LARGEST_LIMIT the effect is practically hidden."""
    return '' if value is None else fixed(value, 2) if value < LARGEST_LIMIT else UNKNOWN


def _remark(entry: Visibility) -> str:
    if entry.reason:
        return f'not judged: {entry.reason}'
    if entry.hidden:
        return 'this order cannot show it'
    return f'cannot be told from {", ".join(entry.alike)}' if entry.alike else ''


def bias(visibilities: Sequence[Visibility], rotation: Floats | None = None) -> Table:
    """Return what 1 µm rms of each effect adds to the six curves where it is not in the model; rotation: as of Run."""
    names = text.curve_names(rotation)
    every = [one for one in visibilities if not one.reason]
    return Table('bias', 'How much 1 µm (rms) of a hidden effect would change each curve', (
        words('effect', 'effect', [one.name for one in every]),
        *(column(f'{curve}_{text.file_unit(unit)}_per_um', names[place], [
            1e-6 * factor * one.bias[place] for one in every], partial(fixed, places=2), unit)
          for place, (curve, (factor, unit)) in enumerate(zip(CURVES, text.curve_scales()))),
        words('remark', 'remark', ['negligible' if one.bias.max() <= NEGLIGIBLE else '' for one in every])))


def orders(advice: Advice) -> Table:
    """Return the orders that were compared for the next run; the largest smallest sensitivity first."""
    every = (advice.present, *sorted(advice.orders, key=lambda order: -order.worst))
    marks = ['present', *('recommended' if one.label == advice.best.label and advice.best is not advice.present else ''
                          for one in every[1:])]
    return Table('orders', 'Orders for the next run, by the sensitivity to the effects that this order shows least', (
        words('order', 'order', [one.label for one in every]), words('mark', '', marks),
        words('worst_effect', 'lowest sensitivity to', [one.worst_effect for one in every]),
        column('worst_share', text.SENSITIVITY, [one.worst for one in every], text.percent),
        *(column(f'U_{what}', f'U {what}', [COVERAGE_FACTOR * factor * float(np.linalg.norm(one.u[at]))
                                            for one in every if one.u is not None],
                 lambda value: f'{value:.2g}', unit) for what, at, (factor, unit) in _parts()
          if advice.present.environment),
        column('travel_time_s', 'time of moves', [one.travel_time for one in every], text.duration),
        column('duration_s', 'whole run', [one.duration for one in every], text.duration),
        *(column(f'visible_fraction_{name}', name, [one.share(name) for one in every], text.percent)
          for name in advice.wanted)), levels=tuple('strong' if mark == 'recommended' else '' for mark in marks))

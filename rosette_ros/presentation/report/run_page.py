# SPDX-License-Identifier: Apache-2.0
"""The page of one run: a Summary as one HTML file that needs nothing else."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from rosette_ros.analysis import RunResult, Summary
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.next_readings import SettlingStep, steps_of
from rosette_ros.core.planning.plan_comparison import Point
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import ErrorMotions, Run
from rosette_ros.core.run.reduced_sets import relative_uncertainty
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import difference
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.model_file import format_model
from rosette_ros.io.reading_checks import known_temperatures, remark_on_temperature
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.budget_results import beyond_words, budget_tables
from rosette_ros.presentation.identity_words import NOTHING, SIMULATED, identity_rows, signer, stated_days, who_words
from rosette_ros.presentation.plots import comparison_plots, plan_plots, residual_plots, touch_plots
from rosette_ros.presentation.plots.residual_plots import Residuals
from rosette_ros.presentation.plots.result_plots import (
    Series,
    deviations,
    polar_motions,
    six_curves,
    values_of_points,
)
from rosette_ros.presentation.report.page_parts import PAGES, inline_svgs
from rosette_ros.presentation.report.provenance import Source, order_of, software
from rosette_ros.presentation.table_format import Table
from rosette_ros.presentation.tables import base_name, tables_of, weak_effects
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.effect_words import capital, fixed, title_of
from rosette_ros.words.reading_words import notes_of, remark_words
from rosette_ros.words.result_words import comparison_words
from rosette_ros.words.verdict_words import HEADLINES, verdict_text

MOST_CANDIDATES, MOST_SHARES, MOST_WEAK = 8, 3, 5
COLUMNS = {'causes': ('probability', 'does', 'rms_after_um', 'check'),  # the sentence says what moves, by which law
           'candidates': ('effect', 'claimed', 'p', 'size', 'visible_fraction', 'rms_after_um', 'look_alikes'),
           'spheres': ('ball', 'readings', 'radius_mm', 'form_um', 'largest_form_um', 'systematic_um', 'p', 'moved_um'),
           'visibility': ('title', 'typical_visible_fraction', 'visible_fraction', 'detectable_rms_um',
                          'recommended_order_visible_fraction', 'recommended_order_detectable_rms_um', 'remark'),
           'errors': ('error', 'range_in_unit', 'U_range_in_unit', 'once_per_turn_in_unit', 'residual_in_unit',
                      'tolerance_in_unit', 'conformity'),
           'errors_as_modelled': ('error', 'range_in_unit', 'U_range_in_unit', 'once_per_turn_in_unit',
                                  'residual_in_unit'),
           'weak': ('title', 'typical_visible_fraction', 'detectable_rms_um', 'recommended_order_visible_fraction')}
"""Columns on the page of tables that are wider than paper; the others are in the files of `--tables`."""
METHOD = 'Three-rosette method (Kniel et al., Measurement 2019)'
NO_TOUCHES = 'Single touches are not recorded (topic touches): form of balls and lobing of the probe are not known.'


def report_html(summary: Summary, source: Source | None = None, command: str = '', overlays: Sequence[Series] = (),
                pictures: Mapping[str, Figure] | None = None, inputs: BudgetInputs | None = None,
                annexed: bool = False) -> str:
    """Return the report of a Summary as one HTML text: three pages on paper, and how to repeat it.

    pictures: of `pictures_of`, where they are drawn already; inputs: of the uncertainty budget; annexed: whether the
    annex with all other figures and tables is added, on paper, too."""
    refit, untouched = touches_of(source)
    result = result_of(summary, refit, inputs)
    pictures, made = pictures or pictures_of(summary, overlays, result, annexed, source), result.budget
    run, identity = summary.run, source.identity if source else Identity()
    return PAGES.get_template('report.html.j2').render(
        summary=summary, verdict=verdict_text(summary.verdict), source=source, iso=text.iso_range(run.rotation),
        headline=HEADLINES[summary.verdict.outcome], command=command,
        compared=comparison_words(summary.comparison), k=COVERAGE_FACTOR,
        pictures=inline_svgs(pictures, {'curves': values_of_points(series_of(summary, result, overlays))}),
        advised=advice_words(summary.advice) if summary.advice else '',
        result=result, cross_validation=text.CROSS_VALIDATION,
        tables=shown_tables(summary, identity, result), budget=made,
        not_considered=not_considered(made) if made else (), spheres=sphere_rows(refit) if refit else (),
        identity=identity_rows(identity, source.contradictions if source else ()), signer=signer(identity),
        who=who_words(identity),
        measured=conditions(summary, source), unknown=[
            *unknowns(summary, result), *untouched, *([] if identity.entries else [NOTHING])],
        judged=text.model_words(summary.model), simulated=SIMULATED * run.simulated,
        running=f'{run.run_id or run.source}{" (SIMULATED)" * run.simulated}', model=format_model(summary.final.model),
        numbers={name: place for place, name in enumerate(pictures, 1)}, software=software(), overlays=overlays,
        annexed=annexed, most_balls=MOST_BALLS,
        heading_fit='Where the model fails' if summary.verdict.model_fails else 'How well the model fits',
        elsewhere=[one.label for one in overlays if difference(one.motions, result.curves.motions) is None],
        others=[one.name for one in summary.diagnosis.candidates[MOST_CANDIDATES:]])


def touches_of(source: Source | None) -> tuple[SphereRefit | None, list[str]]:
    """Return the spheres fitted to the touches of a run, and in sentences why there are none."""
    try:
        found = source.spheres if source else None
    except InvalidData as error:
        return None, [f'Touches are not shown: {error}.']
    return found, [NO_TOUCHES] if source and not found else []


def result_of(summary: Summary, refit: SphereRefit | None = None, inputs: BudgetInputs | None = None) -> RunResult:
    """Return the result of a run; refit, inputs: as of RunResult, which count where there is a budget."""
    result = RunResult(summary.fit, summary.diagnosis, None, refit)
    return result if result.budget is None else RunResult(summary.fit, summary.diagnosis, inputs, refit)


def pictures_of(summary: Summary, overlays: Sequence[Series] = (), result: RunResult | None = None,
                annexed: bool = True, source: Source | None = None) -> dict[str, Figure]:
    """Return every figure of a summary by name, in the order of the page; their captions are in the template.

    result: of `result_of`, None for that of the summary; annexed: with those of the annex; source: of the run, with
    which the way is shown of one that was measured until it is known.
    """
    run, result = summary.run, result or summary.result
    fits, made, refit, main = fits_of(summary, result), result.budget, result.refit, result.curves.motions
    rows = [Residuals(label, run, fit.residual) for label, fit in fits]
    limits = source.identity.limits(run.rotation) if source else {}
    pages = {'curves': six_curves(series_of(summary, result, overlays), limits=limits),
             'residual_maps': residual_plots.residual_maps(rows)}
    if source and (steps := way_of(run, summary.model, source)):
        pages['way'] = plan_plots.way_to_the_cause(steps, source.until)
    if not annexed:
        return pages
    found = summary.diagnosis.candidates[:MOST_CANDIDATES]
    return pages | {
        'polar': polar_motions(main),
        **({'differences': six_curves(less)} if (less := _differences(main, overlays)) else {}),
        **({'budget': comparison_plots.budget_bars(made)} if made else {}),
        'deviations': deviations(summary.fit.plate, summary.fit.cmm, run.radius),
        'residuals_against': residual_plots.against(rows, run.repeatability),
        'histogram': residual_plots.histogram(rows, run.repeatability, [one.dof for _, one in fits]),
        'noise': residual_plots.noise(summary.final),
        **({'ladder': comparison_plots.ladder(ladder, run.repeatability, run.repeatability_dof)}
           if (ladder := summary.ladder) else {}),
        **({'candidates': comparison_plots.candidates(found, run.repeatability)} if found else {}),
        **({'shapes': residual_plots.shapes(shapes)} if (shapes := summary.diagnosis.recovered) else {}),
        'pairs': plan_plots.pairs_in_order(run),
        **({} if run.is_complete else {'uncertainty': plan_plots.uncertainty_by_share(run.n, [_point(run)])}),
        'visibility': _visibility(summary),
        **({'touch_residuals': touch_plots.touch_residuals(refit)} if refit else {})}


def series_of(summary: Summary, result: RunResult, overlays: Sequence[Series] = ()) -> list[Series]:
    """Return the curves that are drawn, the result first, with those of other runs."""
    every = [result.curves, *([result.beside] if result.beside else [])]
    fits = reversed(fits_of(summary, result))
    return [*(Series(label, one.motions) for (label, _), one in zip(fits, every)), *overlays]


def way_of(run: Run, model: Model, source: Source) -> tuple[SettlingStep, ...]:
    """Return what was known each time that it was asked whether a run is settled, where more was then measured."""
    return steps_of(run, model, source.asked) if len(source.asked) > 1 else ()


def _differences(motions: ErrorMotions, overlays: Sequence[Series]) -> list[Series]:
    """Return the curves of other runs less those of a run, of those at its table angles."""
    found = ((one.label, difference(one.motions, motions)) for one in overlays)
    return [Series(label, less) for label, less in found if less is not None]


def _point(run: Run) -> Point:
    """Return where a run stands beside a complete one: for noise that is white and equal."""
    variance = BaseSpace(run, run.radius).curve_cofactor()
    return 'this run', run.size / run.n**2, relative_uncertainty(variance, run.radius)


def shown_tables(summary: Summary, identity: Identity, result: RunResult) -> dict[str, Table]:
    """Return every table by name as it stands on the page: no wider than paper; identity: with tolerances."""
    tables = {table.name: table for table in every_table(summary, identity, result)}
    tables['weak'] = weak_effects(tables['visibility'], MOST_WEAK)
    for name in tables.keys() & COLUMNS:
        tables[name] = tables[name].select(*COLUMNS[name])
    tables['candidates'] = tables['candidates'].first(MOST_CANDIDATES)
    if summary.advice:
        shares = [f'visible_fraction_{name}' for name in summary.advice.wanted[:MOST_SHARES]]
        tables['orders'] = tables['orders'].select(
            'order', 'mark', 'duration_s', 'worst_effect', 'worst_share', *shares)
    return tables


def every_table(summary: Summary, identity: Identity, result: RunResult) -> tuple[Table, ...]:
    """Return every table of a run; where inputs of the budget are stated, errors and curves have its U."""
    made, refit = result.budget, result.refit
    return (*tables_of(summary, identity.limits(summary.run.rotation), result),
            *([sphere_table(refit)] if refit else []), *(budget_tables(made) if made else ()))


def unknowns(summary: Summary, result: RunResult) -> list[str]:
    """Return what the results of a run do not tell, in sentences."""
    run, every, made = summary.run, summary.visibilities, result.budget
    reasons = [f'{title_of(one.name)} ({one.reason})' for one in every if one.reason]
    what = ('what the uncertainty budget lists' if result.curves.budget else
            'the scatter of the readings and the uncertainty of the effects in the model')
    beyond = beyond_words(made.inputs.environment if made else None)
    return list(filter(None, (
        *text.not_known(run, summary.fit.gauge, map(remark_words, run.remarks)),
        f'Not judged: {"; ".join(reasons)}.' if reasons else '',
        'The temperature was not measured.' if not known_temperatures(run).size else '', *(
            f'{capital(note)}.' for note in notes_of(run)),
        'The asynchronous error motion needs several runs.',
        f'U contains {what}; it does not contain effects that are not in the model{beyond}.')))


def fits_of(summary: Summary, result: RunResult) -> list[tuple[str, Fit]]:
    """Return the fit of the model as it is, and that of the result where it is another, with their names."""
    if result.beside is None:
        return [(base_name(summary.model) if not summary.model.terms else 'model as given', summary.fit)]
    return [(one.which, one.fit) for one in (result.beside, result.curves)]


def _visibility(summary: Summary) -> Figure:
    advice = summary.advice
    best = advice.best if advice and advice.best.label != advice.present.label else None
    return comparison_plots.visibility(
        summary.visibilities, best.visibilities if best else (),
        (f'this order: {order_of(summary.run)}', f'recommended: {best.label}' if best else ''))


def conditions(summary: Summary, source: Source | None = None) -> list[tuple[str, str]]:
    """Return what was measured, when and how, as (name, text) rows."""
    run, fit, found = summary.run, summary.fit, summary.result.curves.fit
    rows = [('Run', run.run_id or run.source), ('Method', METHOD),
            ('Measured by', 'a simulated CMM' if run.simulated else
             'a CMM; nothing in the data says that it is simulated'),
            ('Readings', text.run_size(run)),
            ('Mean radius', f'{fixed(1e3 * fit.mean_radius, 6)} mm found, {text.millimetres(run.radius)} nominal'),
            ('Table axis', text.axis_words(run.rotation)), ('Sequence', text.sequence_words(order_of(run, source))),
            ('First reading', source.begun if source and source.begun else stated_days(source.identity if source else
                                                                                   Identity()) or 'not recorded'),
            ('Duration', text.run_duration(text.seconds_of(run))), ('Pauses', text.pauses(run)),
            ('Temperature', _temperature(run)),
            ('Repeatability', text.repeatability_words(
                run.repeatability, run.repeatability_dof, run.repeatability_axes)),
            ('Table angles', text.angle_words(run)),
            ('Uncertainties', text.uncertainty_words(found)), ('Model', text.model_words(fit.model)),
            ('Model found', text.model_words(found.model) if found is not fit else ''),
            *(('Data', f'{Path(file.path).name}, SHA-256 {file.sha256[:16]}…')
              for file in (source.files if source else ())),
            ('Software', ', '.join(f'{name} {version}' for name, version in software()[:2]))]
    return [row for row in rows if row[1]]


def _temperature(run: Run) -> str:
    known = known_temperatures(run)
    if not known.size:
        doubt = remark_on_temperature(run.temperature)
        return remark_words(doubt) if doubt else 'not recorded'
    first, last, low, high = (fixed(float(one), 3) for one in (known[0], known[-1], known.min(), known.max()))
    return f'{first} °C at the start, {last} °C at the end, between {low} and {high} °C'

# SPDX-License-Identifier: Apache-2.0
"""Results as JSON: evaluation, comparison, diagnosis, change, advice and effects, SI, the same for every interface.

What is not finite becomes None, so that the text is strict JSON. A key that stands in a schema stays.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.analysis import Change, LadderStep, RunResult
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.noise_facts import noise_facts
from rosette_ros.core.diagnosis.recovered_shape import Shape
from rosette_ros.core.diagnosis.second_run import CrossCheck
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.effects.effect import Effect, Quantity
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.planning.advice import Advice, OrderAdvice
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import SI_UNITS, ErrorMotions
from rosette_ros.core.sight.visibility import Visibility
from rosette_ros.core.uncertainty.clamped_plate import clamped_plate
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.error_results import errors_json
from rosette_ros.presentation.table_format import STANDARD, fields_json, parameters_json, verdict_json
from rosette_ros.presentation.tables import CANDIDATE, CHECKED
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.motion_words import missing_words, unnamed_words
from rosette_ros.words.result_words import check_words, comparison_words
from rosette_ros.words.verdict_words import noise_words, unexplained_words, verdict_text

EVALUATION, COMPARISON, DIAGNOSIS = 'rosette-evaluation/1', 'rosette-comparison/1', 'rosette-diagnosis/1'
ADVICE, EFFECTS, CHANGE = 'rosette-advice/1', 'rosette-effects/1', 'rosette-change/1'
CURVE_KEYS = tuple(f'{curve}_{unit}' for curve, unit in SI_UNITS.items())

Json = dict[str, Any]
"""An object of JSON: what stands in it depends on the schema."""


def plain(value: Any) -> Any:
    """Return nested values as lists, dicts, str, int, float, bool and None: strict JSON."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fit_json(fit: Fit) -> Json:
    """Return what was fitted and how well."""
    return {
        'rms_m': fit.rms, 'sigma_m': fit.sigma, 'sigma_source': fit.sigma_source, 'dof': fit.dof, 'rank': fit.rank,
        'model': fit.model.names, 'model_hash': fit.model.hash, 'repeatability_m': fit.run.repeatability,
        'repeatability_dof': fit.run.repeatability_dof, 'reduced_chi_square': fit.reduced_chi_square,
        'lack_of_fit_p': fit.lack_of_fit_p, 'noise': noise_json(fit)}


def noise_json(fit: Fit) -> Json:
    """Return what the noise is like; standard deviations and variances in units of sigma_m."""
    noise = fit.noise
    return {
        'is_white': noise.is_white and not fit.step, 'axes': noise.axes, 'by': noise.by,
        'factors': noise.factors, 'tail': noise.tail, 'tail_dof': noise.tail_dof, 'memory': noise.phi,
        'wander': noise.wander, 'resolution_m': fit.step,
        'words': noise_words(noise_facts(fit))}


def by_curve(values: Iterable[object]) -> Json:
    """Return six values, or six curves, by the key of the curve."""
    return dict(zip(CURVE_KEYS, values, strict=True))


def motions_json(motions: ErrorMotions) -> Json:
    """Return six curves with standard (u) and expanded (U) uncertainties."""
    return {'angle_rad': motions.angle, **by_curve(motions.values.T), 'u': by_curve(motions.u.T),
            'U': by_curve(COVERAGE_FACTOR * motions.u.T)}


def result_json(result: RunResult, tolerances: Mapping[str, Tolerance] | None = None) -> Json:
    """Return the result of a run, `result`, and the same curves as `with_cause_found`, null where no cause that has a
    name is missing; tolerances: of ranges by curve, m and rad."""
    one = result.curves
    curves = {'model': one.fit.model.names, **motions_json(one.motions)}
    named = result.found is not None and result.found.with_cause is not None
    return {
        'result': {'which': one.which, **curves, 'coverage_factor': COVERAGE_FACTOR,
                   'iso_230_7': errors_json(one.lines(tolerances))},
        'with_cause_found': {**curves, 'iso_230_7': errors_json(one.lines())} if named else None}


def evaluation_json(result: RunResult, tolerances: Mapping[str, Tolerance] | None = None) -> Json:
    """Return a report, schema rosette-evaluation/1: the fit as modelled, and the result; u holds standard
    uncertainties; tolerances: of ranges by curve, m and rad.

    An effect that stands twice in the model is named with its fixed parameters, or with all that were found.
    """
    fit, verdict, motions = result.fit, result.verdict, result.modelled.motions
    run, plate = fit.run, clamped_plate(fit)
    names, terms = [term.name for term in fit.model.terms], [str(term) for term in fit.model.terms]
    keys = [term.name if names.count(term.name) == 1 else str(term) if terms.count(str(term)) == 1 else
            str(Term(term.effect, one.setting)) for term, one in zip(fit.model.terms, fit.effects, strict=True)]
    return plain({
        'schema': EVALUATION, 'run_id': run.run_id, 'n': run.n, 'radius_m': run.radius,
        'mean_radius_m': fit.mean_radius, 'readings': run.size, 'completeness': run.completeness,
        **motions_json(motions), 'u_coverage_factor': STANDARD, 'U_coverage_factor': COVERAGE_FACTOR,
        'coverage_factor': COVERAGE_FACTOR, 'iso_names': motions.iso_names, 'plate_m': fit.plate, 'cmm_m': fit.cmm,
        'clamping_shift_m': plate.shift, 'clamping_rotation_rad': plate.turn, 'plate_freed_m': plate.freed,
        'clamping_U_shift_m': COVERAGE_FACTOR * plate.u[:3], 'clamping_U_rotation_rad': COVERAGE_FACTOR * plate.u[3:],
        'plate_freed_U_m': COVERAGE_FACTOR * plate.u_freed,
        'plate_U_m': COVERAGE_FACTOR * fit.deviation_u[0], 'cmm_U_m': COVERAGE_FACTOR * fit.deviation_u[1],
        'simulated': run.simulated, 'rotation': run.rotation,
        'table_axis': None if run.rotation is None else run.rotation[:, 2],
        'fit': fit_json(fit), 'gauge': fit.gauge, **verdict_json(verdict_text(verdict) if verdict else None),
        'iso_230_7': errors_json(result.modelled.lines(tolerances)),
        'effects': {key: parameters_json(one.parameters) for key, one in zip(keys, fit.effects, strict=True)},
        **result_json(result, tolerances)})


def comparison_json(comparison: Comparison, verdict: Verdict, steps: Sequence[LadderStep] = ()) -> Json:
    """Return a comparison, schema rosette-comparison/1; steps: of the nested models, the base model first."""
    fit = comparison.fit
    return plain({
        'schema': COMPARISON, 'run_id': fit.run.run_id, 'model': fit.model.names, 'fit': fit_json(fit),
        'failing': verdict.model_fails, **verdict_json(verdict_text(verdict)), 'summary': comparison_words(comparison),
        'axis_rms_m': comparison.axis_rms,
        'groups': {one.label: {'keys': one.keys, 'rms_m': one.rms, 'mean_m': one.mean, 'p': one.p,
                               'worst': one.keys[one.worst]} for one in comparison.groupings},
        'neighbours': {'correlation': comparison.neighbour_correlation, 'p': comparison.neighbour_p},
        'worst_readings': [{
            'reading': one.number, 'table_position': one.table_position, 'ball': one.ball,
            'cmm_position': one.cmm_position, 'residual_m': one.residual, 'size_sigma': one.size, 'p': one.p,
            'weight': one.weight, 'curves_without': None if one.without is None else by_curve(one.without),
        } for one in comparison.worst],
        **({'ladder': [{'added': step.added, 'fit': fit_json(step.fit), 'held_out_rms_m': step.cross_validation}
                       for step in steps]} if steps else {})})


def diagnosis_json(diagnosis: Diagnosis, visibilities: Sequence[Visibility] = (),
                   check: CrossCheck | None = None) -> Json:
    """Return a diagnosis, schema rosette-diagnosis/1; visibilities: of the effects that are not observable."""
    verdict, result = diagnosis.verdict, RunResult(diagnosis.fit, diagnosis)
    return plain({
        'schema': DIAGNOSIS, 'run_id': diagnosis.fit.run.run_id, 'model': diagnosis.model.names,
        'fit': fit_json(diagnosis.fit), **motions_json(result.modelled.motions),
        'iso_230_7': errors_json(result.modelled.lines()), **result_json(result),
        'missing': diagnosis.missing, 'unexplained': diagnosis.unexplained,
        'levels': levels_json(diagnosis),
        'explanations': [{'members': one.members, 'noise': one.noise, 'probability': one.probability}
                         for one in diagnosis.explanations],
        'probability_of_nothing': diagnosis.probability_of_nothing,
        'probability_of_unnamed': diagnosis.probability_of_unnamed,
        'unnamed': [{'variables': [sorted(each) for each in one.driven_by], 'motion': one.motion,
                     'probability': one.probability} for one in diagnosis.unnamed],
        'not_needed': diagnosis.not_needed,
        'candidates': [fields_json(CANDIDATE, entry) for entry in diagnosis.candidates],
        'invisible': diagnosis.invisible,
        **verdict_json(verdict_text(verdict)), 'unexplained_text': unexplained_words(verdict),
        'shapes': [_shape_json(entry) for entry in diagnosis.recovered],
        'final': fit_json(diagnosis.final), 'unavailable': dict(diagnosis.unavailable),
        'invisible_bias': {entry.name: by_curve(entry.bias) for entry in visibilities},
        **({'check': _check_json(check)} if check else {})})


def levels_json(diagnosis: Diagnosis) -> list[Json]:
    """Return what moves with what, and by which law, each with its probability; law: null without a name; text: what
    the verdict says of it."""
    out = []
    for cause in diagnosis.causes:
        numbers = {what: number for what in ('ball', 'reading') if (number := cause.number(what)) is not None}
        told = next(one for one in (*diagnosis.claimed, *diagnosis.unnamed) if one.cause == cause)
        out.append({
            'motion': cause.bodies[0], 'motions': cause.bodies,
            'variables': [sorted(some) for some in cause.alternatives],
            'probability': cause.probability, 'law': ' + '.join(cause.names) or None,
            'law_probability': cause.law_probability, 'law_certain': cause.law_certain,
            'laws': [{'effect': ' + '.join(law) or None, 'probability': p} for law, p in cause.laws], **numbers,
            'text': unnamed_words(told) if told in diagnosis.unnamed else missing_words(told)})
    return out


def _shape_json(shape: Shape) -> Json:
    """Return a recovered shape; claim: '' where no effect has it; u: standard uncertainties."""
    return {
        'form': shape.form, 'setting': shape.setting, 'text': shape.words, 'claim': shape.claim,
        'variable': shape.variable, 'unit': shape.unit, 'values': shape.values, 'u_coverage_factor': STANDARD,
        'curves': [{'axis': one.axis, 'carrier': one.carrier, 'shape_m': one.value, 'u_m': one.u,
                    'claimed_m': one.claimed} for one in shape.curves]}


def _check_json(check: CrossCheck) -> Json:
    return {
        'run_id': check.before.run.run_id, 'confirmed': check.confirmed, 'text': check_words(check),
        'before': fit_json(check.before), 'after': fit_json(check.after),
        'carried': fit_json(check.carried) if check.carried else None,
        'held_out_rms_before_m': check.cross_validation_before, 'held_out_rms_after_m': check.cross_validation_after,
        'held_out_rms_carried_m': check.cross_validation_carried,
        'effects': [fields_json(CHECKED, entry) for entry in check.effects]}


def change_json(action: str, effect: str, file: Path | str, models: tuple[Model, Model], change: Change | None = None,
                sentence: str = '') -> Json:
    """Return what `add` or `remove` did to a model file, schema rosette-change/1; change: on a run, if any."""
    on_run = {} if change is None else {
        'run_id': change.after.run.run_id, 'before': _side_json(change.before), 'after': _side_json(change.after),
        'held_out_rms_before_m': change.cross_validation_before, 'held_out_rms_after_m': change.cross_validation_after,
        'helps': change.helps, 'hurts': change.hurts, 'curve_change': by_curve(change.curve_change)}
    return plain({
        'schema': CHANGE, 'action': action, 'effect': effect, 'file': str(file), 'model_before': models[0].names,
        'model': models[1].to_mapping(), 'sentence': sentence, **on_run})


def _side_json(fit: Fit) -> Json:
    return {'fit': fit_json(fit), 'u_max': by_curve(fit.error_motions.u.max(axis=0)), 'u_coverage_factor': STANDARD,
            'effects': [{'effect': effect.name, 'setting': effect.setting,
                         'parameters': parameters_json(effect.parameters)} for effect in fit.effects]}


def advice_json(advice: Advice, n: int, radius: float, run_id: str = '') -> Json:
    """Return an advice, schema rosette-advice/1; n: balls; radius: m."""
    return plain({
        'schema': ADVICE, 'run_id': run_id, 'n': n, 'radius_m': radius, 'text': advice_words(advice),
        'present': _order_json(advice.present), 'recommended': _order_json(advice.best),
        'orders': [_order_json(order) for order in advice.orders], 'weak': advice.weak, 'wanted': advice.wanted})


def _order_json(order: OrderAdvice) -> Json:
    return {'order': order.order, 'turning': order.turning, 'seed': order.seed, 'worst_share': order.worst,
            'worst_effect': order.worst_effect, 'travel_time_s': order.travel_time, 'duration_s': order.duration,
            'effects': {entry.name: visibility_json(entry) for entry in order.visibilities}}


def visibility_json(entry: Visibility) -> Json:
    """Return what an order shows of an effect; bias: the largest change of each curve per metre rms."""
    return {'visible_fraction': entry.share, 'typical_visible_fraction': entry.typical_share, 'setting': entry.setting,
            'hidden': entry.hidden, 'detectable_rms_m': entry.detectable, 'look_alikes': entry.alike,
            'not_judged': entry.reason, 'bias_per_m_rms': by_curve(entry.bias)}


def effects_json(effects: Iterable[Effect], amplitudes: Mapping[str, Sequence[Quantity]]) -> Json:
    """Return effects, schema rosette-effects/1; amplitudes: by name what is fitted at one setting of the effect."""
    return plain({'schema': EFFECTS, 'effects': [
        {'effect': effect.name, 'meaning': effect.meaning, 'look': effect.look, 'formula': effect.formula,
         'source': effect.source, 'depends_on': effect.depends_on, 'carries': effect.carries,
         'amplitudes': [_quantity_json(one) for one in amplitudes.get(effect.name, ())],
         'searched': [{**_quantity_json(one), 'kind': one.kind} for one in effect.searched]}
        for effect in effects]})


def _quantity_json(quantity: Quantity) -> Json:
    return {'name': quantity.name, 'unit': quantity.unit, 'meaning': quantity.meaning}

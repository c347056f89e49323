# SPDX-License-Identifier: Apache-2.0
"""Comparison, diagnosis, change, advice and effects as lists and dicts: one place for every door.

All SI. What is not finite becomes None, so that the text is strict JSON.
"""

import numpy as np

from rosette_ros.core.records import CURVES
from rosette_ros.report_json import finite, fit_json

DIAGNOSIS, COMPARISON = 'rosette-diagnosis/1', 'rosette-comparison/1'
ADVICE, EFFECTS, CHANGE = 'rosette-advice/1', 'rosette-effects/1', 'rosette-change/1'
CURVE_KEYS = tuple(f'{curve}_{"m" if curve.startswith("ct") else "rad"}' for curve in CURVES)


def diagnosis_json(run, diagnosis, visibilities=(), check=None):
    """Return a Diagnosis as a mapping, schema rosette-diagnosis/1.

    visibilities: of the invisible effects, for the bias that each would put on the curves; check:
    CrossCheck on another run, or None.
    """
    out = {
        'schema': DIAGNOSIS, 'run_id': run.run_id, 'model': list(diagnosis.model.names),
        'fit': fit_json(diagnosis.fit), 'missing': list(diagnosis.missing),
        'unexplained': bool(diagnosis.unexplained),
        'candidates': [_candidate_json(entry) for entry in diagnosis.candidates],
        'invisible': list(diagnosis.invisible), 'verdict': diagnosis.verdict,
        'unexplained_text': diagnosis.unexplained_text, 'final': fit_json(diagnosis.final),
        'unavailable': dict(diagnosis.unavailable),
        'invisible_bias': {entry.name: _bias_json(entry) for entry in visibilities}}
    if check is not None:
        out['check'] = check_json(check)
    return plain(out)


def _candidate_json(entry):
    return {
        'effect': entry.effect, 'p': entry.p, 'visible_fraction': entry.visible_fraction,
        'rms_before_m': entry.rms_before, 'rms_after_m': entry.rms_after,
        'held_out_rms_before_m': entry.held_out_before,
        'held_out_rms_after_m': entry.held_out_after, 'delta_bic': entry.delta_bic,
        'parameters': parameters_json(entry.parameters), 'look_alikes': list(entry.look_alikes),
        'claimed': bool(entry.claimed), 'setting': dict(entry.setting)}


def parameters_json(parameters):
    """Return Parameters by name."""
    return {one.name: {'value': one.value, 'u': one.u, 'unit': one.unit} for one in parameters}


def check_json(check):
    """Return a CrossCheck as a mapping; carried: with the first run's amplitudes, unfitted."""
    carried = None if check.carried is None else fit_json(check.carried)
    return {
        'run_id': check.before.run.run_id, 'confirmed': check.confirmed, 'text': check.text,
        'before': fit_json(check.before), 'after': fit_json(check.after), 'carried': carried,
        'held_out_rms_before_m': check.held_out_before,
        'held_out_rms_after_m': check.held_out_after,
        'held_out_rms_carried_m': check.held_out_carried,
        'effects': [_checked_json(entry) for entry in check.effects]}


def _checked_json(entry):
    return {
        'effect': entry.name, 'outcome': entry.outcome, 'reason': entry.reason,
        'carries': entry.carries, 'setting': dict(entry.setting), 'p': entry.p,
        'visible_fraction': entry.visible_fraction, 'rms_before_m': entry.rms_without,
        'rms_after_m': entry.rms_with, 'held_out_rms_before_m': entry.held_out_without,
        'held_out_rms_after_m': entry.held_out_with, 'same_size': entry.same_size,
        'learnt': parameters_json(entry.learnt), 'found': parameters_json(entry.found)}


def comparison_json(comparison, rungs=()):
    """Return a Comparison as a mapping, schema rosette-comparison/1; rungs: of its ladder."""
    fit = comparison.fit
    out = {
        'schema': COMPARISON, 'run_id': fit.run.run_id, 'model': list(fit.model.names),
        'fit': fit_json(fit), 'failing': comparison.failing, 'summary': comparison.summary,
        'axis_rms_m': comparison.axis_rms,
        'groups': {grouping.label: {'keys': list(grouping.keys), 'rms_m': grouping.rms,
                                    'mean_m': grouping.mean, 'p': grouping.p,
                                    'worst': grouping.keys[grouping.worst]}
                   for grouping in comparison.groupings},
        'neighbours': {'correlation': comparison.neighbour_correlation,
                       'p': comparison.neighbour_p},
        'worst_readings': [
            {'reading': one.number, 'table_position': one.table_position, 'ball': one.ball,
             'cmm_position': one.cmm_position, 'residual_m': list(one.residual),
             'size_sigma': one.size, 'p': one.p} for one in comparison.worst],
        'harmonics': [
            {'axis': line.axis, 'table_waves': line.table_waves, 'cmm_waves': line.cmm_waves,
             'amplitude_m': line.amplitude, 'share': line.share} for line in comparison.harmonics]}
    if rungs:
        out['ladder'] = ladder_json(rungs)
    return plain(out)


def ladder_json(rungs):
    """Return the Rungs of a ladder, the base model first."""
    return plain([{'added': rung.added, 'fit': fit_json(rung.report.fit),
                   'held_out_rms_m': rung.held_out} for rung in rungs])


def change_json(action, effect, file, models, change=None, sentence=''):
    """Return what became of a model file as a mapping, schema rosette-change/1.

    action: `add` or `remove`; models: the Model before and after; change: the Change on a run, or
    None where none was given.
    """
    out = {'schema': CHANGE, 'action': action, 'effect': effect, 'file': str(file),
           'model_before': list(models[0].names), 'model': models[1].to_mapping(),
           'sentence': sentence}
    if change is not None:
        out |= {
            'run_id': change.after.run.run_id, 'before': _side_json(change.before),
            'after': _side_json(change.after), 'held_out_rms_before_m': change.held_out_before,
            'held_out_rms_after_m': change.held_out_after, 'helps': change.helps,
            'hurts': change.hurts,
            'curve_change': dict(zip(CURVE_KEYS, change.curve_change.tolist(), strict=True))}
    return plain(out)


def _side_json(report):
    largest = report.error_motions.u.max(axis=0).tolist()
    return {'fit': fit_json(report.fit), 'u_max': dict(zip(CURVE_KEYS, largest, strict=True)),
            'effects': [{'effect': effect.name, 'setting': dict(effect.setting),
                         'parameters': parameters_json(effect.parameters)}
                        for effect in report.effects]}


def advice_json(advice, n, radius, run_id=''):
    """Return an Advice as a mapping, schema rosette-advice/1; n: balls; radius: m."""
    return plain({
        'schema': ADVICE, 'run_id': run_id, 'n': n, 'radius_m': radius, 'text': advice.text,
        'present': _order_json(advice.present), 'recommended': _order_json(advice.best),
        'orders': [_order_json(order) for order in advice.orders], 'weak': list(advice.weak),
        'wanted': list(advice.wanted)})


def _order_json(order):
    return {'order': order.order, 'turning': order.turning, 'seed': order.seed,
            'worst_share': order.worst, 'worst_effect': order.worst_effect,
            'travel_time_s': order.travel_time, 'duration_s': order.duration,
            'effects': {entry.name: _visibility_json(entry) for entry in order.visibilities}}


def _visibility_json(entry):
    return {'visible_fraction': entry.share, 'typical_visible_fraction': entry.typical_share,
            'setting': dict(entry.setting), 'hidden': entry.hidden,
            'detectable_rms_m': entry.detectable, 'look_alikes': list(entry.alike),
            'not_judged': entry.reason, 'bias_per_m_rms': _bias_json(entry)}


def _bias_json(entry):
    """Return the largest change of each curve per metre rms of the effect."""
    return dict(zip(CURVE_KEYS, (float(value) for value in entry.bias), strict=True))


def effects_json(effects, amplitudes):
    """Return effects as a mapping, schema rosette-effects/1.

    amplitudes: by name the Quantities that are fitted at one setting of the effect.
    """
    return plain({'schema': EFFECTS, 'effects': [
        {'effect': effect.name, 'meaning': effect.meaning, 'look': effect.look,
         'formula': effect.formula, 'source': effect.source,
         'depends_on': list(effect.depends_on), 'carries': effect.carries,
         'amplitudes': [_quantity_json(one) for one in amplitudes.get(effect.name, ())],
         'searched': [{**_quantity_json(one), 'kind': one.kind} for one in effect.searched]}
        for effect in effects]})


def _quantity_json(quantity):
    return {'name': quantity.name, 'unit': quantity.unit, 'meaning': quantity.meaning}


def plain(value):
    """Return nested values as lists, dicts, str, int, float, bool and None: strict JSON."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    return finite(value)

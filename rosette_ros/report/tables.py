# SPDX-License-Identifier: Apache-2.0
"""Every table of a report, made from a Story: exact for CSV, rounded as far as it is known for people."""

from functools import partial

import numpy as np

from rosette_ros.core.records import CURVES, ISO_NAMES
from rosette_ros.report.table import Table, column, words
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.words import (
    MEANINGS,
    chance,
    decimals,
    duration,
    fixed,
    percent,
    setting_words,
    shown_parameter,
    signed,
    times,
)

UNITS = tuple('um' if curve.startswith('ct') else 'urad' for curve in CURVES)
SHOWN_UNITS = {'um': 'µm', 'urad': 'µrad'}
UM = partial(fixed, places=3)
WORST = 6


def tables_of(story):
    """Return every Table of a Story, in the order of the report."""
    return (curves(story.final.error_motions), deviations(story.final), places(story.comparison),
            worst_readings(story.comparison), residuals(story), groups(story.comparison),
            ladder(story.rungs), candidates(story.diagnosis), effects(story.final),
            visibility(story), bias(story), *([orders(story.advice)] if story.advice else []))


def curves(motions):
    """Return the six curves with standard uncertainties; on the page the expanded ones."""
    values, u = 1e6 * motions.values, 1e6 * motions.u
    columns = [column('table_position', 'table position', range(1, len(values) + 1), str),
               column('table_angle_deg', 'angle / °', np.rad2deg(motions.angle), partial(fixed, places=1))]
    spread = []
    for place, (curve, unit) in enumerate(zip(CURVES, UNITS, strict=True)):
        digits = decimals(COVERAGE_FACTOR * float(np.median(u[:, place])))
        head = f'{curve} ({ISO_NAMES[curve]}) / {SHOWN_UNITS[unit]}'
        columns.append(column(f'{curve}_{unit}', head, values[:, place], partial(signed, places=digits)))
        spread.append(column(f'u_{curve}_{unit}', f'U({curve}) / {SHOWN_UNITS[unit]}', u[:, place],
                             lambda one, digits=digits: fixed(COVERAGE_FACTOR * one, digits)))
    return Table('curves', 'Six error motions of the table; U is the expanded uncertainty '
                 f'(k = {COVERAGE_FACTOR}, about 95 %)', (*columns, *spread))


def deviations(report):
    """Return the deviations of the plate's balls and of the CMM's positions."""
    digits = decimals(1e6 * report.fit.sigma, 1) + 1
    columns = [column(f'{what}_{axis}_um', f'{label} {axis} / µm', 1e6 * values[:, place],
                      partial(signed, places=digits))
               for what, label, values in (('plate', 'plate', report.plate), ('cmm', 'CMM', report.cmm))
               for place, axis in enumerate('xyz')]
    number = column('number', 'ball or CMM position', range(1, len(report.plate) + 1), str)
    return Table('deviations', 'Deviations of the ball plate and of the CMM', (number, *columns))


def places(comparison):
    """Return, for all that the residuals were grouped by, the group in which they are largest."""
    sigma = comparison.fit.run.repeatability or comparison.fit.rms
    sizes = [1e6 * float(np.sqrt(np.mean(one.rms[one.worst]**2))) for one in comparison.groupings]
    every = comparison.groupings
    return Table('worst_places', 'Where the residual of the model is largest', (
        words('by', 'by', [one.label for one in every]),
        words('worst', 'largest at', [one.keys[one.worst] for one in every]),
        column('rms_um', 'its rms / µm', sizes, UM),
        column('rms_sigma', 'in σ', [1e-6 * size / sigma for size in sizes], times),
        column('p', 'chance of noise', [one.p for one in every], chance)))


def worst_readings(comparison):
    """Return the readings that fit worst."""
    worst = comparison.worst[:WORST]
    return Table('worst_readings', 'Readings that fit worst', (
        column('reading', 'reading', [one.number for one in worst], str),
        column('table_position', 'table position', [one.table_position for one in worst], str),
        column('ball', 'ball', [one.ball for one in worst], str),
        column('cmm_position', 'CMM position', [one.cmm_position for one in worst], str),
        *(column(f'{axis}_um', f'{axis} / µm', [1e6 * one.residual[place] for one in worst],
                 partial(signed, places=3)) for place, axis in enumerate('xyz')),
        column('p', 'chance of noise', [one.p for one in worst], chance)))


def residuals(story):
    """Return every reading with its residual before and after: for the file alone."""
    run = story.run
    numbers = [('reading', np.arange(1, run.size + 1)), ('table_position', run.table_position),
               ('ball', run.ball), ('cmm_position', run.cmm_position), ('time_s', run.time),
               ('table_angle_deg', np.rad2deg(run.table_angle)), ('temperature_C', run.temperature)]
    numbers += [(f'{when}_{axis}_um', 1e6 * report.fit.residual[:, place])
                for when, report in (('before', story.report), ('after', story.final))
                for place, axis in enumerate('xyz')]
    return Table('residuals', 'Residuals', tuple(column(key, key, values) for key, values in numbers))


def groups(comparison):
    """Return every group of residuals: for the file alone."""
    rows = [(one, place) for one in comparison.groupings for place in range(len(one.keys))]
    return Table('residual_groups', 'Residuals by group', (
        column('by', 'by', [one.label for one, _ in rows]),
        column('group', 'group', [one.keys[place] for one, place in rows]),
        *(column(f'{what}_{axis}_um', '', [1e6 * getattr(one, what)[place, k] for one, place in rows])
          for what in ('rms', 'mean') for k, axis in enumerate('xyz'))))


def ladder(rungs):
    """Return the ladder of models with the error of each."""
    fits = [rung.report.fit for rung in rungs]
    chi = [fit.reduced_chi_square for fit in fits]
    return Table('ladder', 'The ladder of models', (
        words('model', 'model', rung_names(rungs)),
        column('rms_um', 'in the fit / µm', [1e6 * fit.rms for fit in fits], UM),
        column('held_out_rms_um', 'in readings left out / µm', [1e6 * rung.held_out for rung in rungs], UM),
        column('reduced_chi_square', 'reduced χ²', chi, lambda one: '–' if one is None else f'{one:.3g}'),
        column('rank', 'parameters', [fit.rank for fit in fits], str),
        column('dof', 'degrees of freedom', [fit.dof for fit in fits], str)))


def rung_names(rungs):
    """Return the names of the models of a ladder: the base, then what came with each."""
    return [f'+ {rung.added}' if rung.added else base_name(rung.report.model) for rung in rungs]


def base_name(model):
    """Return what the base of a model is."""
    return 'base model' if len(model.base) == 3 else ' + '.join(model.base) or 'nothing'


def candidates(diagnosis):
    """Return the candidates, best first, with probability, size and look-alikes."""
    every = diagnosis.candidates
    return Table('candidates', 'Candidates, best first; each beside those that are claimed above it', (
        words('effect', 'effect', [one.effect for one in every]),
        words('claimed', 'claimed', ['yes' if one.claimed else 'no' for one in every]),
        column('p', 'chance of noise', [one.p for one in every], chance),
        words('size', 'size', [size_words(one) for one in every]),
        column('visible_fraction', 'visible', [one.visible_fraction for one in every], percent),
        column('rms_before_um', 'residual before / µm', [1e6 * one.rms_before for one in every], UM),
        column('rms_after_um', 'after / µm', [1e6 * one.rms_after for one in every], UM),
        column('held_out_rms_before_um', 'left out before / µm',
               [1e6 * one.held_out_before for one in every], UM),
        column('held_out_rms_after_um', 'after / µm', [1e6 * one.held_out_after for one in every], UM),
        column('delta_bic', 'ΔBIC', [one.delta_bic for one in every], partial(fixed, places=0)),
        words('look_alikes', 'looks like', [', '.join(one.look_alikes) for one in every])))


def size_words(candidate):
    """Return the parameters of a candidate with expanded uncertainties, as text."""
    shown = [(one.name, *shown_parameter(one)) for one in candidate.parameters]
    parts = [f'{name} {value} {spread} {unit}'.strip() for name, value, spread, unit in shown]
    setting = setting_words(candidate.effect, candidate.setting, [one.name for one in candidate.parameters])
    return '; '.join([', '.join(parts)] * bool(parts) + [setting] * bool(setting))


def effects(report):
    """Return the parameters of the effects of a model."""
    rows = [(effect, one) for effect in report.effects for one in effect.parameters]
    shown = [shown_parameter(one) for _, one in rows]
    at = [setting_words(effect.name, effect.setting, [one.name for one in effect.parameters])
          for effect, _ in rows]
    return Table('effects', f'Effects in the final model; U is the expanded uncertainty '
                 f'(k = {COVERAGE_FACTOR})', (
                     words('effect', 'effect', [effect.name for effect, _ in rows]),
                     words('parameter', 'parameter', [one.name for _, one in rows]),
                     column('value_si', '', [one.value for _, one in rows]),
                     column('u_si', '', [one.u for _, one in rows]),
                     column('unit_si', '', [one.unit for _, one in rows]),
                     column('value', 'value', [one[0] for one in shown], str),
                     column('expanded_uncertainty', 'U', [one[1] for one in shown], str),
                     words('unit', 'unit', [one[2] for one in shown]), words('setting', 'found at', at)))


def visibility(story):
    """Return what this order shows of every effect of the library."""
    every = story.visibilities
    best = story.advice.best if story.advice else None
    recommended = {one.name: one.typical_share for one in best.visibilities} if best else {}
    return Table('visibility', 'What this order of measurement shows of every effect', (
        words('effect', 'effect', [one.name for one in every]),
        words('meaning', 'what it is', [MEANINGS[one.name].meaning for one in every]),
        column('typical_visible_fraction', 'visible, typically', [one.typical_share for one in every], percent),
        column('visible_fraction', 'at best', [one.share for one in every], percent),
        column('recommended_order_visible_fraction', 'in the recommended order',
               [recommended.get(one.name) for one in every], lambda one: '' if one is None else percent(one)),
        column('detectable_rms_um', 'smallest that is found / µm rms',
               [1e6 * one.detectable for one in every], UM),
        words('remark', 'remark', [_remark(one) for one in every])))


def _remark(entry):
    if entry.reason:
        return f'not judged: {entry.reason}'
    if entry.hidden:
        return 'hidden by this order'
    return f'looks like {", ".join(entry.alike)}' if entry.alike else ''


def bias(story):
    """Return what 1 µm rms of each effect would put on the six curves if it were not in the model."""
    every = [one for one in story.visibilities if not one.reason]
    return Table('bias', 'What 1 µm rms of an effect puts on the curves while it is not in the model', (
        words('effect', 'effect', [one.name for one in every]),
        *(column(f'{curve}_{unit}_per_um', f'{curve} ({ISO_NAMES[curve]}) / {SHOWN_UNITS[unit]}',
                 [one.bias[place] for one in every], partial(fixed, places=2))
          for place, (curve, unit) in enumerate(zip(CURVES, UNITS, strict=True)))))


def orders(advice):
    """Return the orders that were compared for the next run."""
    every = (advice.present, *advice.orders)
    marks = ['now', *('recommended' if one.label == advice.best.label else '' for one in advice.orders)]
    shares = [[one.share(name) for one in every] for name in advice.wanted]
    return Table('orders', 'Orders for the next run, and what they show of the effects that are weak now', (
        words('order', 'order', [one.label for one in every]), words('mark', '', marks),
        column('duration_s', 'takes', [one.duration for one in every], duration),
        *(column(f'visible_fraction_{name}', name, share, percent)
          for name, share in zip(advice.wanted, shares, strict=True))))

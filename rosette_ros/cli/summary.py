# SPDX-License-Identifier: Apache-2.0
"""The six curves and what was fitted, for a person: the same tables in every verb."""

import numpy as np
from rich.markup import escape

from rosette_ros.cli.screen import pairs, table
from rosette_ros.core.records import CURVES, ISO_NAMES
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.units import scale_of
from rosette_ros.words import decimals, exact, fixed, signed

DOUBTFUL_P = 0.05
"""Below this chance that noise alone leaves as much, the fit is called doubtful."""
SMALLEST_P = 1e-12


def head(run):
    """Return one line that says what was measured."""
    share = '' if run.is_complete else f' of {run.n**2}'
    return (f'[bold]{escape(run.run_id or run.source)}[/]: {run.n} balls on R = '
            f'{exact(1e3 * run.radius, 6)} mm, {run.size}{share} ball centres')


def curve_table(motions, title='Six error motions of the table'):
    """Return the table of six curves, µm and µrad, with expanded uncertainties.

    Where the uncertainty is the same at all angles it stands below all values, else below each.
    """
    values, expanded = 1e6 * motions.values, COVERAGE_FACTOR * 1e6 * motions.u
    places = [decimals(float(np.median(column))) for column in expanded.T]
    alike = bool(np.all(np.ptp(expanded, axis=0) <= 0.005 * expanded.max(axis=0)))
    made = table('table\n\ndeg', *(_curve_head(curve) for curve in CURVES), title=title)
    for angle, row, spread in zip(motions.angle, values, expanded, strict=True):
        made.add_row(exact(np.rad2deg(angle), 4), *(
            _cell(value, u, digits, not alike)
            for value, u, digits in zip(row, spread, places, strict=True)))
    made.add_section()
    made.add_row('span', *(fixed(float(np.ptp(column)), digits)
                           for column, digits in zip(values.T, places, strict=True)))
    if alike:
        made.add_row(f'U (k={COVERAGE_FACTOR})', *(
            f'±{fixed(float(column.max()), digits)}'
            for column, digits in zip(expanded.T, places, strict=True)), style='bold')
    return made


def _curve_head(curve):
    return f'{curve}\n{ISO_NAMES[curve]}\n{"µm" if curve.startswith("ct") else "µrad"}'


def _cell(value, u, digits, with_u):
    return signed(value, digits) + (f'\n±{fixed(u, digits)}' if with_u else '')


def deviation_table(report):
    """Return the table of plate and CMM deviations in µm, by ball and by CMM position."""
    both = 1e6 * np.concatenate([report.plate, report.cmm], axis=1)
    places = decimals(1e6 * report.fit.sigma, 1) + 1
    made = table('ball or\nCMM pos.', *(f'{what}\n{axis}' for what in ('plate', 'CMM')
                                        for axis in 'xyz'),
                 title='Deviations of the ball plate and of the CMM, µm')
    for number, row in enumerate(both, 1):
        made.add_row(str(number), *(signed(float(value), places) for value in row))
    return made


def effect_table(report):
    """Return the table of fitted effects with expanded uncertainties; None without effects."""
    if not report.effects:
        return None
    made = table(title='Effects in the model')
    for name, side in (('effect', 'left'), ('parameter', 'left'), ('value', 'right'),
                       (f'U (k={COVERAGE_FACTOR})', 'right'), ('unit', 'left')):
        made.add_column(name, justify=side)
    for effect in report.effects:
        for parameter in effect.parameters:
            scale = scale_of(parameter.unit, parameter.name)
            factor, unit = scale.factor, scale.unit
            u = factor * COVERAGE_FACTOR * parameter.u
            places = decimals(u)
            made.add_row(escape(effect.name), parameter.name,
                         signed(factor * parameter.value, places), f'±{fixed(u, places)}',
                         escape(unit))
    return made


def fit_summary(report):
    """Return what was fitted, how well it fits and what it cannot know, as (name, text) rows."""
    fit = report.fit
    rows = [
        ('Model', f'{escape(" + ".join(fit.model.names) or "nothing")} (rank {fit.rank}, '
                  f'{fit.dof} degrees of freedom left)'),
        ('Residual', residual_words(fit)),
        ('Uncertainty', f'from {_um(fit.sigma)} per coordinate of a ball centre, as told by '
                        f'{fit.sigma_source}'),
        ('Not known', gauge_words(report.gauge)),
    ]
    return pairs(rows)


def residual_words(fit):
    """Return how large the residual is, and whether noise of the repeatability explains it."""
    text = f'{_um(fit.rms)} rms per coordinate'
    known, dof = fit.run.repeatability, fit.run.repeatability_dof
    if known is None:
        return (f'{text}; the repeatability is not known, so it cannot be said whether '
                'anything is missing')
    of = '' if dof is None else f' ({dof:g} degrees of freedom)'
    text = f'{text}, {fit.rms / known:.2f} times the repeatability of {_um(known)}{of}'
    if fit.lack_of_fit_p >= DOUBTFUL_P:
        return f'{text}: [green]the model fits[/] (p = {fit.lack_of_fit_p:.2g})'
    p = (f'p = {fit.lack_of_fit_p:.1g}' if fit.lack_of_fit_p > SMALLEST_P
         else f'p < {SMALLEST_P:g}')
    return (f'{text}: [red]the model does not explain the readings[/]; noise alone would leave '
            f'as much with {p}')


def gauge_words(gauge):
    """Return the sentence on what no three-rosette run can know."""
    return f'to no three-rosette run, and taken out of the curves: {"; ".join(gauge)}'


def _um(metres):
    value = 1e6 * metres
    return f'{fixed(value, decimals(value, 3))} µm'

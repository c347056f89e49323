# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget for people and programs: contributions, inputs, Monte Carlo."""

from functools import partial

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.errors import counted
from rosette_ros.core.run.number_words import significant
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.uncertainty.budget_lines import root_mean
from rosette_ros.core.uncertainty.budget_monte_carlo import MonteCarlo
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.stated_environment import KINDS, Environment
from rosette_ros.core.uncertainty.uncertainty_budget import PROBABILITY, Budget
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.json_output import CURVE_KEYS, Json, by_curve, plain
from rosette_ros.presentation.table_format import Column, Table, column, words
from rosette_ros.words import effect_words
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.effect_words import MICRO_DECIMALS, decimals, fixed, names, scale_of, title_of

SCHEMA = 'rosette-budget-results/1'
ROWS = ('combined u', f'U (k = {COVERAGE_FACTOR})', 'U, worst point', 'effective dof')
NOTE = ('Standard uncertainties of a point, rms over the points of a curve; degrees of freedom: Welch and '
        'Satterthwaite.')
ALIKE = 0.02
"""Relative difference up to which U of the worst point is not told by itself."""
WORST = 2
UNLIMITED = 1e6
"""More degrees of freedom are shown as ∞."""
LEAST_SHARE = 0.01
"""Share in the variance of a curve from which on an effect that may be there is shown."""
AGREEMENT = {True: 'yes', False: 'no', None: 'too few trials'}


def budget_tables(made: Budget, found: MonteCarlo | None = None) -> tuple[Table, ...]:
    """Return the tables of a budget: contributions, inputs and, where it was done, Monte Carlo."""
    bounds = [bound_table(made)] if any(one.is_bound for one in made.contributions) else []
    return contributions(made), *bounds, stated_inputs(made), *([monte_carlo_table(made, found)] if found else [])


def expanded_words(made: Budget) -> str:
    """Return the expanded uncertainties of the six curves in a sentence."""
    names, scales = text.curve_names(made.fit.run.rotation), text.curve_scales()
    return f'U (k = {COVERAGE_FACTOR}, rms over the angles): ' + ', '.join(
        f'{name} {significant(COVERAGE_FACTOR * scale.factor * u)} {scale.unit}'
        for name, scale, u in zip(names, scales, made.mean, strict=True)) + '.'


def contributions(made: Budget) -> Table:
    """Return what each influence contributes to each curve."""
    lines, names = [one for one in made.contributions if not one.is_bound], text.curve_names(made.fit.run.rotation)
    u, worst = made.mean, made.combined().max(axis=0)
    is_even = bool(np.all(worst <= (1 + ALIKE) * u))
    rows = [one for place, one in enumerate(ROWS) if place != WORST or not is_even]
    columns = [words('contribution', 'contribution', [one.name for one in lines], rows)]
    for place, (curve, (factor, unit)) in enumerate(zip(CURVES, text.curve_scales(), strict=True)):
        digits = _digits(factor * u[place])
        footer = [fixed(factor * value, digits) for value in (
            u[place], COVERAGE_FACTOR * u[place], COVERAGE_FACTOR * worst[place])][:WORST + (not is_even)]
        columns.append(column(
            f'u_{curve}_{text.file_unit(unit)}', names[place], [factor * float(one.mean[place]) for one in lines],
            partial(text.at_least, places=digits), unit, footer=[*footer, shown_dof(float(made.effective_dof[place]))]))
    for place, curve in enumerate(CURVES):
        columns.append(column(f'sensitivity_{curve}_si', '', [float(one.sensitivity[place]) for one in lines]))
    return Table('budget', 'Uncertainty budget (GUM)', tuple(columns), note=NOTE)


def bound_table(made: Budget) -> Table:
    """Return the bounds of effects that are not in the model, which are no part of the combined uncertainty."""
    lines, names = [one for one in made.contributions if one.is_bound], text.curve_names(made.fit.run.rotation)
    return Table('bounds', 'Bounds of effects that are not in the model, beside the combined u', (
        words('effect', 'effect', [one.name for one in lines]), words('words', 'bound', [one.words for one in lines]),
        *(column(f'u_{curve}_{text.file_unit(unit)}', name, [factor * float(one.mean[place]) for one in lines],
                 significant, unit)
          for place, (curve, (factor, unit), name) in enumerate(zip(CURVES, text.curve_scales(), names, strict=True)))),
        note='Standard uncertainties if the effect were as large as its bound; no estimates.')


def hidden_table(made: Budget) -> Table | None:
    """Return the effects that may be there and are the most of U, largest first; None where no environment is stated.
    """
    if made.around is None:
        return None
    names, shares = text.curve_names(made.fit.run.rotation), made.around.shares
    shown = [name for name, one in shares.items() if one.max() >= LEAST_SHARE]
    return Table('hidden', f'What this order cannot show, in U (environment: {made.around.environment.name})', (
        words('effect', 'effect', shown), words('title', 'what may be there', map(title_of, shown)),
        *(column(f'share_{curve}', names[place], [float(shares[name][place]) for name in shown], text.percent)
          for place, curve in enumerate(CURVES))),
        note='Shares in the variance of each curve; effects with less than 1 % in all of them are left out.')


def environment_words(environment: Environment | None) -> str:
    """Return what may move in a run, with its sizes."""
    if environment is None:
        return 'not stated: U lacks what the order of measurement cannot show'
    sizes = [f'{KINDS[kind].words} {_size(one.value, KINDS[kind].si)}' for kind, one in environment.sizes.items()]
    sizes += [f'{title_of(name)} {_size(one.value, "m")} at a ball'
              for name, one in environment.effects.items()]
    known = environment.experience
    titles = [title_of(name) for name in (known.by_name if known else ()) if name in EFFECTS]
    learnt = f'; of {names(titles)} as in {counted(known.runs, "earlier run")} of the cell' if known and titles else ''
    return f'{environment.name}: {", ".join(sizes)} in a run (standard deviations from run to run){learnt}'


def _size(value: float, unit: str, digits: int = 1) -> str:
    scale = scale_of(unit)
    return f'{fixed(scale.factor * value, decimals(scale.factor * value, digits))} {scale.unit}'


def beyond_words(environment: Environment | None) -> str:
    """Return what of the effects that are not in the model U contains after all."""
    return f' nor among those of the environment ({environment.name})' if environment else ''


def environment_json(made: Budget | None) -> Json:
    """Return what is stated of the environment and what it makes of U, null where nothing is stated."""
    if made is None or made.around is None:
        return {'environment': None}
    around = made.around
    return {'environment': {**(stated_json(around.environment) or {}), 'hidden': [{
        'effect': name, 'probability': around.there[name], 'share': by_curve(share),
        'u': by_curve(root_mean(np.sqrt(around.parts[name])))} for name, share in around.shares.items()]}}


def stated_json(environment: Environment | None) -> Json | None:
    """Return what is stated of the environment, SI units, None where nothing is."""
    return None if environment is None else {
        'name': environment.name,
        'sizes': {kind: {'value': one.value, 'unit': KINDS[kind].si, 'source': one.source}
                  for kind, one in environment.sizes.items()},
        'effects': {name: {'value': one.value, 'unit': 'm', 'source': one.source}
                    for name, one in environment.effects.items()},
        'experience': environment.experience and {'runs': environment.experience.runs,
                                                  'effects': list(environment.experience.by_name)}}


def _digits(u: float) -> int:
    return decimals(COVERAGE_FACTOR * u, 2) + 1 if u else MICRO_DECIMALS


def shown_dof(dof: float) -> str:
    """Return degrees of freedom for people."""
    return '∞' if not dof < UNLIMITED else f'{dof:.0f}'


def stated_inputs(made: Budget) -> Table:
    """Return the inputs: value with unit, kind of evaluation, distribution, degrees of freedom, whence it is."""
    lines = made.contributions
    return Table('budget_inputs', 'Inputs of the budget', (
        words('contribution', 'contribution', [one.name for one in lines]),
        column('value_si', '', [one.value for one in lines]), column('unit_si', '', [one.unit for one in lines]),
        words('input', 'standard uncertainty', [_size(one.value, one.unit, 2) for one in lines]),
        words('kind', 'type', [one.kind for one in lines]),
        words('distribution', 'distribution', [one.distribution for one in lines]),
        column('dof', 'dof', [one.dof for one in lines], shown_dof),
        words('words', 'what it is', [one.words for one in lines]),
        words('source', 'from', [one.source for one in lines])),
        note='Type A: by statistics, B: by other knowledge (GUM 4.2, 4.3).')


def monte_carlo_table(made: Budget, found: MonteCarlo) -> Table:
    """Return the comparison of a budget with Monte Carlo."""
    every = found.agreements
    factors = text.curve_factors().tolist()
    digits = [_digits(factor * one.expected) for factor, one in zip(factors, every, strict=True)]

    def micro(key: str, head: str, values: list[float]) -> Column:
        scaled = tuple(factor * value for factor, value in zip(factors, values, strict=True))
        return Column(key, head, scaled, tuple(map(fixed, scaled, digits)))

    return Table('budget_monte_carlo', f'Monte Carlo, {found.trials} trials, seed {found.seed} (GUM S1)', (
        words('curve', 'curve', text.curve_names(made.fit.run.rotation)), words('unit', 'unit', text.curve_units()),
        micro('u_budget', 'u, budget', [one.expected for one in every]),
        micro('u_monte_carlo', 'u, Monte Carlo', [one.found for one in every]),
        micro('k_u', f'± U (k = {COVERAGE_FACTOR})', [COVERAGE_FACTOR * one.expected for one in every]),
        micro('low', f'{100 * PROBABILITY:.2f} % from', [one.low for one in every]),
        micro('high', 'to', [one.high for one in every]),
        micro('tolerance', 'tolerance', [one.tolerance for one in every]),
        words('agrees', 'agrees', [AGREEMENT[one.agrees] for one in every])),
        levels=tuple({True: 'good', False: 'bad', None: 'doubtful'}[one.agrees] for one in every),
        note='Ends of the interval about the curve; tolerance of an end: half a unit of the leading digit of u '
             '(GUM S1, 7.9.2, 8.1).')


def agreement_words(found: MonteCarlo) -> str:
    """Return whether Monte Carlo confirms a budget, in a sentence."""
    off = max((abs(one.found / one.expected - 1) for one in found.agreements if one.expected), default=0.0)
    beside = f'standard uncertainties differ by at most {100 * off:.1f} %'
    if found.agrees is None:
        return (f'{found.trials} trials are too few to say whether Monte Carlo confirms the budget (10000 mostly do); '
                f'{beside}.')
    if found.agrees:
        return f'Monte Carlo confirms the budget: all intervals agree within the tolerance; {beside}.'
    names = effect_words.names([curve for curve, one in zip(CURVES, found.agreements, strict=True)
                                if one.agrees is False])
    return f'Monte Carlo does not confirm the budget of {names}: take its intervals instead; {beside}.'


def together_words(found: MonteCarlo) -> str:
    """Return in a sentence how the six error motions of a point scatter together (GUM S2)."""
    correlation = np.triu(found.correlation, 1)
    _, first, second = np.unravel_index(np.abs(correlation).argmax(), correlation.shape)
    normal = float(np.sqrt(scipy.special.chdtri(len(CURVES), 1 - PROBABILITY)))
    return (f'Together (GUM S2): largest correlation of two errors of a point {float(np.abs(correlation).max()):.2f} '
            f'({CURVES[first]} with {CURVES[second]}); the ellipsoid of {100 * PROBABILITY:.2f} % for all six '
            f'reaches {float(found.reach.mean()):.2f} standard deviations (normal: {normal:.2f}).')


def budget_json(made: Budget, found: MonteCarlo | None = None) -> Json:
    """Return a Budget, SI units."""
    run, combined = made.fit.run, made.combined()
    out: Json = {
        'schema': SCHEMA, 'run_id': run.run_id, 'coverage_factor': COVERAGE_FACTOR, 'contributions': [{
            'name': one.name, 'words': one.words, 'type': one.kind, 'distribution': one.distribution,
            'value': one.value, 'unit': one.unit, 'dof': one.dof,
            'source': one.source, 'is_bound': one.is_bound, 'u': by_curve(one.mean),
            'sensitivity': by_curve(one.sensitivity)} for one in made.contributions],
        'u': by_curve(made.mean), 'U': by_curve(COVERAGE_FACTOR * made.mean),
        'U_worst_point': by_curve(COVERAGE_FACTOR * combined.max(axis=0)),
        'effective_dof': by_curve(made.effective_dof), 'coverage_factor_by_dof': by_curve(made.coverage),
        'table_angle_rad': made.fit.error_motions.angle,
        'u_points': by_curve(combined.T), 'not_considered': not_considered(made), **environment_json(made)}
    if found:
        out['monte_carlo'] = {
            'trials': found.trials, 'seed': found.seed, 'agrees': found.agrees, 'probability': PROBABILITY,
            'covariance_si': found.covariance, 'reach': found.reach,
            'u': by_curve(root_mean(found.u)), 'curves': {key: {
                'u_budget': one.expected, 'u': one.found, 'low': one.low, 'high': one.high, 'scatter': one.scatter,
                'tolerance': one.tolerance, 'agrees': one.agrees}
                for key, one in zip(CURVE_KEYS, found.agreements, strict=True)}}
    return plain(out)

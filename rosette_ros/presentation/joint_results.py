# SPDX-License-Identifier: Apache-2.0
"""Several runs as one, for people and programs: tables, words, JSON."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rosette_ros.core.joint.conclusion import conclude, fits
from rosette_ros.core.joint.joint_evaluation import JointResult, Reversal
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.joint.run_to_run import joint_lines
from rosette_ros.core.joint.sharing import ITEMS, PARTS
from rosette_ros.core.joint.sharing_tests import SharingTest
from rosette_ros.core.run.number_words import UNKNOWN, Tolerance, micrometres, p_value, p_words
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import doubt_of
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.budget_results import environment_words, stated_json
from rosette_ros.presentation.error_results import TITLE, errors, errors_json
from rosette_ros.presentation.json_output import Json, by_curve, motions_json, parameters_json, plain
from rosette_ros.presentation.table_format import STANDARD, Table, column, micrometre_column, words
from rosette_ros.presentation.tables import CURVES_SCHEMA, EXPANDED, STANDARD_U, curves, effects, range_rows
from rosette_ros.words.effect_words import decimals, exact, fixed, names, scale_of
from rosette_ros.words.joint_words import note_words, part_words
from rosette_ros.words.result_words import conclusion_text

JOINT = 'rosette-joint-evaluation/1'


def test_result(test: SharingTest) -> str:
    """Return what a test of the sharing says."""
    if test.item == 'sense':
        return 'they differ' if test.is_contradicted else 'no difference shows'
    if test.p is None:
        return 'used; cannot be tested by these readings'
    if not test.is_contradicted:
        return 'used; the readings agree with it'
    if test.is_used:
        return 'used as declared, but the readings CONTRADICT it: results are wrong; declare it separate'
    return 'NOT used: the readings contradict it'


POSITIONED = {'B': 'largest reversal', 'mean B': 'mean of the reversal', 'M': 'range of the mean of both senses',
              'E': 'range of both senses', 'E+': 'counter-clockwise', 'E-': 'clockwise'}
"""What ISO 230-2 means by its values."""
NOT_POSITIONED = ('B', 'mean B', 'E')
REVERSAL_SIGN = 'The sign is that of ISO 230-2: counter-clockwise (the positive sense) less clockwise.'


def sharing_table(result: JointResult) -> Table:
    """Return what is shared, and whether the data allow it."""
    tests = result.tests
    return Table('sharing', 'What the runs share', (
        words('shared', 'the same', [ITEMS[test.item] for test in tests]),
        words('declared', 'from', ['declared' if test.item in result.declared else 'the runs' for test in tests]),
        column('f', 'F', [np.nan if test.p is None else test.f for test in tests], lambda value: fixed(value, 2)),
        column('dof', 'degrees of freedom', [test.dof for test in tests],
               lambda dof: str(dof) if dof else UNKNOWN),
        column('p', text.P_VALUE, [np.nan if test.p is None else test.p for test in tests], p_value),
        words('result', 'result', [test_result(test) for test in tests])),
        levels=tuple('bad' if test.is_contradicted and test.item != 'sense' else '' for test in tests))


def joint_curves(result: JointResult) -> list[Table]:
    """Return the six curves of each table and sense, and the reversal between senses."""
    shown = [_titled(motions, 'Six error motions of the ' + one.words, one.words)
             for one, motions in result.curves]
    for one in result.reversals:
        shown.append(replace(_titled(one.motions, 'Reversal: counter-clockwise less clockwise', 'reversal'),
                             note=_mean_words(one)))
    return shown


def joint_errors(result: JointResult, tolerances: Mapping[str, Tolerance] | None = None) -> list[Table]:
    """Return error motions in a line each, of each table and sense; tolerances: of ranges by curve, m and rad."""
    every = joint_lines(result, tolerances, doubt_of(conclude(result)))
    return [errors(lines, TITLE.format(one.words), f'errors{place}' if place else 'errors')
            for place, (one, _, lines) in enumerate(every)] + [positioning(one) for one in result.reversals]


def positioning(one: Reversal) -> Table:
    """Return the values of angular positioning of a table (ISO 230-2), and what the runs do not determine."""
    values, (factor, unit) = one.positioning, scale_of('rad')
    known = {name: value for name, value in values.items() if value is not None}
    lacks = [f'{names(NOT_POSITIONED)} need the mean of the reversal, which these runs do not tell'] * (
        not {*NOT_POSITIONED} <= known.keys())
    lacks.append('R and A need five approaches to each angle in each sense, these runs have one')
    return Table('positioning', f'Angular positioning of table {one.table} (ISO 230-2)', (
        words('value', 'value', [f'{name}: {POSITIONED[name]}' for name in known]),
        column(f'value_{text.file_unit(unit)}', 'crz', [factor * value for value in known.values()],
               partial(fixed, places=2 + (factor < 1e6)), unit)), note='U of B and of its mean stand with '
        f'the reversal, U of E+ and E- with the range of crz. Not determined: {"; ".join(lacks)}.')


def joint_effects(result: JointResult) -> list[Table]:
    """Return the effects of each run that has any, with the sizes that all runs give."""
    out = []
    for place, (run, found) in enumerate(zip(result.solution.model.runs, result.effects, strict=True)):
        named = [(one.name, one.setting, one.parameters) for one in found if one.parameters]
        if named:
            table = effects(named, f'Effects in {run.name}', run.run.time_unit if run.run else 's')
            out.append(replace(table, name=f'effects{place + 1}'))
    return out


def reversal_means(result: JointResult) -> list[Table]:
    """Return the means of the reversal curves of each table, with U, and p that noise alone makes the reversal."""
    return [Table(f'means{place}' if place > 1 else 'means', f'Means of the reversal curves; {EXPANDED}', (
        words('curve', 'curve', CURVES),
        column('mean_si', '', np.where(one.is_known, one.mean, np.nan)),
        column('u_si', '', np.where(one.is_known, one.u_mean, np.nan)),
        words('mean', 'mean', [mean for mean, _ in _means(one)]),
        words('U', f'U (k = {COVERAGE_FACTOR})', [spread for _, spread in _means(one)])),
        note=REVERSAL_SIGN + ('' if one.p is None else f' {text.P_VALUE} of the whole reversal: {p_value(one.p)}'))
        for place, one in enumerate(result.reversals, 1)]


def joint_deviations(result: JointResult) -> list[Table]:
    """Return the ball centre deviations and the CMM measurement errors, with U."""
    out, model = [], result.solution.model
    for part, title in (('plate', 'Ball centre deviations'),
                        ('cmm', 'CMM measurement errors at the probing positions')):
        names, values, u = result.deviations(part)
        at = (column('ball', 'ball', model.places['plate'][:, 1] + 1, str) if part == 'plate' else column(
            'azimuth_deg', 'azimuth', np.rad2deg(model.cmm_azimuth), lambda value: exact(value, places=4), '°'))
        several = [words('name', part, names)] if len({*names}) > 1 else []
        out.append(Table(part, f'{title}; {EXPANDED}', (*several, at, *(
            one for place, axis in enumerate('xyz') for one in (
                micrometre_column(f'{axis}_um', axis, values[:, place], sign=True),
                micrometre_column(f'expanded_{axis}_um', f'U({axis})', COVERAGE_FACTOR * u[:, place]))))))
    return out


def joint_csv(result: JointResult, tolerances: Mapping[str, Tolerance] | None = None) -> str:
    """Return all curves as one CSV table, its first column naming the curve's table and sense; above it in '#' lines
    verdict, model and the ranges of each table and sense with U."""
    parts, conclusion = joint_curves(result), conclude(result)
    verdict = conclusion_text(conclusion)
    heading: list[tuple[str, Any]] = [
        ('schema', CURVES_SCHEMA), ('run_id', '+'.join(run.run_id for run in result.solution.model.runs)),
        ('model', dict(joint_rows(result))['Model']), ('level', verdict.level), ('verdict', verdict.sentence),
        ('action', verdict.action), ('uncertainties', STANDARD_U)]
    for one, _, lines in joint_lines(result, tolerances, doubt_of(conclusion)):
        heading += [(f'{key} of the {one.words}', value) for key, value in range_rows(lines)]
    names = words('curves', '', [part.name for part in parts for _ in part.columns[0].values])
    joined = (replace(one, values=tuple(value for part in parts for value in part.columns[place].values))
              for place, one in enumerate(parts[0].columns))
    return replace(parts[0], columns=(names, *joined)).csv(heading)


def _titled(motions: ErrorMotions, title: str, name: str) -> Table:
    return replace(curves(motions), name=name, title=f'{title}; {EXPANDED}')


def _means(one: Reversal) -> list[tuple[str, str]]:
    """Return each mean and its U as texts."""
    out = []
    for (factor, unit), mean, u, known in zip(text.curve_scales(), one.mean, one.u_mean, one.is_known, strict=True):
        spread = factor * COVERAGE_FACTOR * float(u)
        places = decimals(spread)
        out.append((text.signed(factor * float(mean), places), f'{fixed(spread, places)} {unit}') if known else
                   ('not known', ''))
    return out


def _mean_words(one: Reversal) -> str:
    means = [' ± '.join(filter(None, (f'{curve} {mean}', spread)))
             for curve, (mean, spread) in zip(CURVES, _means(one), strict=True)]
    p = '' if one.p is None else f'; {p_words(one.p)}'
    return f'{REVERSAL_SIGN} Means: {", ".join(means)}{p}'


def nothing_known(result: JointResult) -> str:
    """Return what is said where the readings tell no more than one run alone."""
    return 'nothing; the runs test what they share' if len(result.solution.model.runs) > 1 else 'nothing; it is one run'


def joint_rows(result: JointResult) -> list[tuple[str, str]]:
    """Return what was fitted, how well it fits, what became known and what did not, as (name, text)."""
    solution, lack = result.solution, result.lack_of_fit_p
    known = part_words(result.knowledge.known) or (nothing_known(result),)
    fit = '' if lack is None else f'; {p_words(lack)}'
    if fits(result) is False:
        fit += ', one model does not fit'
    beside = len(solution.beside.chosen(solution.beside.choice)[0])
    of_effects = f' and {beside} of effects' * bool(beside)
    return [('Model', f'{solution.model.unknowns} unknowns{of_effects}, rank {solution.rank}, {solution.dof} degrees '
                      'of freedom; '
                      f'{solution.hidden.shape[1]} combinations cannot be measured, {solution.hidden_in_curves} '
                      'of them in the curves, from which they are removed'
                      + ', with means and fundamental error motions that are known only together' * bool(
                          solution.known_together)),
            ('Residual', f'{micrometres(result.rms)} rms per coordinate{fit}'),
            ('Uncertainty', f'from {micrometres(result.sigma)} per coordinate of a ball centre, estimated from '
                            f'{result.sigma_source}'),
            ('Environment', environment_words(result.environment)),
            ('Known', f'beyond what one run knows: {"; ".join(known)}'),
            ('Not determined', '; '.join(part_words(result.knowledge.hidden)) or 'nothing')]


def joint_head(run: Readings) -> str:
    """Return what was measured in a run."""
    used = np.unique(run.table_position).size
    return f'{run.name}: {run.plate.balls} balls, {used} table positions, {run.size} ball centres'


def joint_json(result: JointResult, tolerances: Mapping[str, Tolerance] | None = None) -> Json:
    """Return the results, schema rosette-joint-evaluation/1; u holds standard uncertainties, SI units."""
    solution, sharing = result.solution, result.sharing
    model, conclusion = solution.model, conclude(result)
    noises = [one.noise for one in solution.beside.runs]
    verdict = conclusion_text(conclusion)
    every = joint_lines(result, tolerances, doubt_of(conclusion))
    return plain({
        'schema': JOINT, 'level': verdict.level, 'verdict': verdict.sentence, 'action': verdict.action,
        'runs': [{'run_id': run.run_id, 'source': run.source, 'readings': run.size, 'balls': run.plate.balls,
                  'table_positions': np.unique(run.table_position).size, 'plate_turned_rad': turn,
                  'shares': {part: getattr(sharing, part)[place] for part in PARTS},
                  'noise': noises[place].kinds, 'effects': [
                      {'effect': one.name, 'probability': result.probability(place, one.name), 'setting': one.setting,
                       'rms_m': one.rms, 'parameters': parameters_json(one.parameters)}
                      for one in result.effects[place]]}
                 for place, (run, turn) in enumerate(zip(model.runs, sharing.turn, strict=True))],
        'seat': sharing.seat, 'by_sense': sharing.by_sense, 'cmm_is_calibrated': sharing.cmm_is_calibrated,
        'tests': [{'item': test.item, 'declared': test.item in result.declared, 'dof': test.dof, 'p': test.p,
                   'f': None if test.p is None else test.f, 'used': test.is_used, 'contradicted': test.is_contradicted,
                   'text': test_result(test)} for test in result.tests],
        'unknowns': model.unknowns, 'rank': solution.rank, 'hidden': solution.hidden.shape[1],
        'hidden_in_curves': solution.hidden_in_curves, 'environment': stated_json(result.environment),
        'known': part_words(result.knowledge.known),
        'not_known': part_words(result.knowledge.hidden),
        'curves': [{'table': one.name, 'sense': one.sense, **motions_json(motions), 'iso_230_7': errors_json(lines)}
                   for one, motions, lines in every],
        'reversal': [{'table': one.table, **motions_json(one.motions), 'p': one.p,
                      'mean': by_curve(np.where(one.is_known, one.mean, np.nan)),
                      'u_mean': by_curve(np.where(one.is_known, one.u_mean, np.nan))} for one in result.reversals],
        'iso_230_2': [{'table': one.table, 'unit': 'rad', **one.positioning} for one in result.reversals],
        'u_coverage_factor': STANDARD, 'U_coverage_factor': COVERAGE_FACTOR,
        **{f'{part}{key}': value for part in ('plate', 'cmm')
           for key, value in zip(('_name', '_m', '_u_m'), result.deviations(part), strict=True)},
        'plate_ball': model.places['plate'][:, 1] + 1, 'cmm_azimuth_rad': model.cmm_azimuth,
        'fit': {'rms_m': result.rms, 'dof': solution.dof, 'sigma_m': result.sigma, 'sigma_source': result.sigma_source,
                'lack_of_fit_p': result.lack_of_fit_p}, 'notes': tuple(map(note_words, result.notes))})

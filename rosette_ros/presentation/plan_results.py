# SPDX-License-Identifier: Apache-2.0
"""Plans as tables and JSON: the targets, what a plan determines and shows, several plans side by side."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rosette_ros.core.planning.expectation import Expectation
from rosette_ros.core.planning.next_readings import NextReadings
from rosette_ros.core.planning.plan_comparison import Outlook
from rosette_ros.core.run.number_words import UNKNOWN
from rosette_ros.core.run.records import CURVES, Run
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.io.csv_parser import COLUMNS
from rosette_ros.io.plan_file import SCHEMA
from rosette_ros.io.table_heading import SCHEMA as TABLE_SCHEMA
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.budget_results import stated_json
from rosette_ros.presentation.json_output import Json, by_curve, plain, visibility_json
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.tables import visibility
from rosette_ros.words import effect_words
from rosette_ros.words.effect_words import exact
from rosette_ros.words.plan_words import better_words
from rosette_ros.words.settling_words import next_words

COMPARISON, NEXT_READINGS = 'rosette-plans/1', 'rosette-next-readings/1'
ANGLE_PLACES = 9
"""Decimals of an angle that is no whole number of degrees: 1e-9 deg is 3 pm at 182.5 mm."""
HEADER = 'seq,cmm_position,table_position,ball,x_mm,y_mm,z_mm,table_angle_deg'


def rows(scheme: Scheme, radius_mm: float) -> Iterator[tuple[str, ...]]:
    """Yield the texts of each target in the order of HEADER; no coordinate reads -0.00."""
    centres = scheme.centres(radius_mm)
    for seq, (k, i, j, centre) in enumerate(zip(
            scheme.cmm_position, scheme.table_position, scheme.ball, centres, strict=True), 1):
        yield (str(seq), str(k), str(i), str(j), *(effect_words.plain(float(value), 2) for value in centre),
               exact(360 * (int(i) - 1) / scheme.n + float(np.rad2deg(scheme.table_offset)), ANGLE_PLACES))


def target_list(scheme: Scheme, radius_mm: float) -> str:
    """Return the targets as CSV; with the sense of the last move of the table where it does not only turn forward."""
    lines = [HEADER, *(','.join(row) for row in rows(scheme, radius_mm))]
    if np.any(scheme.approach < 0):
        lines = [f'{line},{sense}' for line, sense in zip(lines, ['approach', *scheme.approach.tolist()], strict=True)]
    return '\n'.join([*lines, ''])


def template(scheme: Scheme, radius_mm: float) -> str:
    """Return a ball-centre table whose coordinates, times and temperatures are to be filled in."""
    offset = [f'# table_offset_deg: {float(np.rad2deg(scheme.table_offset))!r}'] if scheme.table_offset else []
    repeats = ['# repeated_balls: yes'] if scheme.repeats else []
    lines = [f'# schema: {TABLE_SCHEMA}', f'# radius_mm: {radius_mm!r}', f'# balls: {scheme.n}', *offset, *repeats,
             ','.join(COLUMNS)]
    for (seq, k, i, j, *_, angle), approach in zip(rows(scheme, radius_mm), scheme.approach.tolist(), strict=True):
        given = {'seq': seq, 'table_position': i, 'ball': j, 'cmm_position': k, 'table_angle_deg': angle,
                 'approach': str(approach)}
        lines.append(','.join(given.get(name, '') for name in COLUMNS))
    return '\n'.join([*lines, ''])


def targets(scheme: Scheme, radius_mm: float) -> Table:
    """Return the table of the targets."""
    heads = ('seq', 'CMM position', 'table position', 'ball', 'x', 'y', 'z', 'table angle')
    units = ('', '', '', '', 'mm', 'mm', 'mm', '°')
    texts = zip(*rows(scheme, radius_mm), strict=True)
    return Table('targets', 'Targets', (
        *(column(*one) for one in zip(HEADER.split(','), heads, texts, [text.signs] * len(heads), units)),
        column('approach', 'turn', scheme.approach, lambda sense: '+' if sense > 0 else '−'),
        *([column('touches', 'touches', scheme.touches, str)] if scheme.touches.any() else []),
        *([column('session', 'session', scheme.session, str)] if scheme.session[-1] > 1 else [])))


def sequence_map(scheme: Scheme) -> Table:
    """Return the map of the scheme: which measurement is made where (Figure 3 of the paper)."""
    grid = np.zeros((scheme.n, scheme.n), dtype=int)
    first = slice(None, None, -1)  # of several measurements the first is shown
    grid[scheme.table_position[first] - 1, scheme.ball[first] - 1] = np.arange(scheme.ball.size, 0, -1)
    every = range(1, scheme.n + 1)
    return Table('sequence', 'When each ball is measured', (
        column('table_position', 'table \\ ball', every, str),
        *(column(f'ball_{ball}', str(ball), grid[:, ball - 1], lambda seq: str(seq) if seq else '−')
          for ball in every)))


def uncertainties(plan: Outlook) -> Table:
    """Return the table of the uncertainties that a plan is expected to give the curves."""
    u = text.curve_factors() * COVERAGE_FACTOR * mean_u(plan)
    title = f'Expected U (k = 2), standard deviation {1e6 * plan.sigma:g} µm per coordinate (20 touches){_within(plan)}'
    return Table('expected', title, (
        column('curve', 'curve', CURVES, str), column('U', 'U', u, lambda value: f'{value:.3g}'),
        column('unit', '', text.curve_units(), str)))


def mean_u(plan: Outlook) -> Any:
    """Return the expected standard uncertainties of the six curves, rms over the positions, (6,), m and rad."""
    return np.sqrt(np.mean(plan.u**2, axis=0))


def _within(plan: Outlook) -> str:
    """Return of which environment U contains what the order hides, where one is stated."""
    return f', in the environment {plan.environment.name}' if plan.environment else ''


def effects(plan: Outlook) -> Table | None:
    """Return what a plan shows of each effect, None where that is not known."""
    return visibility(plan.effects).select('effect', 'typical_visible_fraction', 'detectable_rms_um', 'remark') if (
        plan.effects) else None


def comparison(plans: Sequence[Outlook]) -> Table:
    """Return what several plans determine, a row for each."""
    every, places = [one.expectation for one in plans], [np.unique(one.scheme.cmm_position).size for one in plans]
    known = all(one.effects for one in plans)
    title = f'What the plans determine; U: expanded (k = 2), σ = {1e6 * plans[0].sigma:g} µm{_within(plans[0])}'
    return Table('plans', title, (
        words('plan', 'plan', [one.name for one in plans]),
        column('readings', 'readings', [one.scheme.ball.size for one in plans], str),
        column('cmm_positions', 'CMM positions', places, str),
        words('touches', 'touches', [_touches(one.scheme) for one in plans]),
        column('duration_h', 'time', [one.duration / 3600 for one in every], lambda hours: f'{hours:.2f}', 'h'),
        column('rank', 'rank', [one.rank for one in every], str),
        column('relative_uncertainty', 'relative u', [one.penalty for one in plans], lambda value: f'{value:.2f}'),
        column('ideal_relative_uncertainty', '', [one.ideal for one in every]),
        *(column(f'U_{curve}_{text.file_unit(unit)}', f'U {curve}', [
            COVERAGE_FACTOR * factor * mean_u(one)[place] for one in plans],
                 None if curve in ('cty', 'cry') else lambda value: f'{value:.2g}', unit)
          for place, (curve, (factor, unit)) in enumerate(zip(CURVES, text.curve_scales()))),
        *([column('effects_shown', 'effects shown', [len(one.shown) for one in plans], str)] if known else [])))


def _touches(scheme: Scheme) -> str:
    low, high = int(scheme.touches.min()), int(scheme.touches.max())
    return 'usual' if high == 0 else str(high) if low == high else f'{low or "usual"} to {high}'


def shares(plans: Sequence[Outlook]) -> Table | None:
    """Return the sensitivity of several plans to each effect, None where that is not known."""
    if not all(one.effects for one in plans):
        return None
    return Table('shares', 'Sensitivity to each effect (share not absorbed), typical', (
        words('effect', 'effect', [one.name for one in plans[0].effects]),
        *(column(f'plan_{place}', plan.name, [None if one.reason else one.typical_share for one in plan.effects],
                 lambda share: UNKNOWN if share is None else text.percent(share))
          for place, plan in enumerate(plans, 1))), note=f'{UNKNOWN}: cannot be judged in this plan')


def plan_json(plan: Outlook) -> Json:
    """Return a plan as plain lists and dicts, SI, schema rosette-plan/1."""
    scheme, way = plan.scheme, plan.scheme.travel(plan.radius)
    return plain({
        'schema': SCHEMA, 'n': scheme.n, 'radius_m': plan.radius, 'order': scheme.order, 'seed': scheme.seed,
        **{name: getattr(scheme, name) for name in (
            'cmm_position', 'table_position', 'ball', 'approach', 'touches', 'session')},
        **({'table_offset_rad': scheme.table_offset} if scheme.table_offset else {}),
        'table_angle_rad': scheme.table_angle, 'centre_m': scheme.centres(plan.radius),
        'travel': {'table_rad': way.table_angle, 'table_moves': way.table_moves,
                   'cmm_m': way.cmm_way, 'cmm_moves': way.cmm_moves},
        'expected': expected_json(plan)})


def next_json(found: NextReadings, run: Run) -> Json:
    """Return the next readings of a run as plain lists and dicts, SI, schema rosette-next-readings/1."""
    block, pair = found.targets, found.separates
    return plain({
        'schema': NEXT_READINGS, 'run_id': run.run_id, 'n': run.n, 'radius_m': run.radius,
        'readings_so_far': run.size, 'text': ' '.join(next_words(found)), 'is_settled': found.is_settled,
        'is_hopeless': found.is_hopeless, 'gain_nat': found.gain, 'duration_s': found.duration,
        'uncertainty_m': found.uncertainty, 'expected_uncertainty_m': found.expected_uncertainty,
        'explanations': [{'members': one.members, 'probability': one.probability}
                         for one in found.likely],
        'separates': pair and {'members': [pair.first.members, pair.second.members], 'share': pair.now,
                               'expected_share': pair.expected},
        'readings': block and {name: getattr(block, name) for name in (
            'table_position', 'ball', 'cmm_position', 'approach')} | {
            'wait_s': block.wait, 'table_angle_rad': block.table_angle, 'centre_m': block.centres(run.radius)}})


def expected_json(plan: Outlook) -> Json:
    """Return what a plan determines and shows, SI; u: standard uncertainties at each table position."""
    expected: Expectation = plan.expectation
    return {'sigma_m': plan.sigma, 'rank': expected.rank, 'rank_of_a_complete_run': expected.full_rank,
            'u': by_curve(plan.u.T), 'relative_uncertainty': plan.penalty,
            'environment': stated_json(plan.environment),
            'ideal_relative_uncertainty': expected.ideal, 'duration_s': expected.duration,
            'unobservable': expected.unobservable,
            'effects': {one.name: visibility_json(one) for one in plan.effects}}


def comparison_json(plans: Sequence[Outlook]) -> Json:
    """Return several plans side by side, schema rosette-plans/1."""
    return plain({'schema': COMPARISON, 'better': better_words(plans), 'plans': [
        {'name': one.name, 'n': one.scheme.n, 'radius_m': one.radius, 'order': one.scheme.order,
         'readings': one.scheme.ball.size, 'cmm_positions': np.unique(one.scheme.cmm_position),
         'balls_in_use': np.unique(one.scheme.ball), 'touches': _touches(one.scheme), **expected_json(one)}
        for one in plans]})

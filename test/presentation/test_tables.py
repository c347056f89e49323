# SPDX-License-Identifier: Apache-2.0
"""Tables: exact in the file, with units in the heads, the same numbers as every other interface gives."""

import csv
import io
import re

import numpy as np
import pytest
from summaries import summary_of, verification_runs

from rosette_ros.analysis import RunResult
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.run.geometry import rigid_motion
from rosette_ros.presentation.json_output import diagnosis_json, evaluation_json
from rosette_ros.presentation.report.verification import verification_tables, verify
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.presentation.tables import bars, effects, size_words, tables_of

CURVES = {'ctx': 'm', 'cty': 'm', 'ctz': 'm', 'crx': 'rad', 'cry': 'rad', 'crz': 'rad'}
WITH_UNIT = re.compile(r'_(um|urad|deg|s|C|si|sigma|in_unit|per_um)$')
PURE = re.compile(r'^(p|probability|reading|table_position|ball|cmm_position|number|visible_fraction.*|rank|dof|runs|'
                  r'reduced_chi_square|typical_visible_fraction|recommended_order_visible_fraction|value|'
                  r'expanded_uncertainty|group|by|share|weight|worst_share|held_out_change)$')
"""Numbers without a unit; what has its unit beside it in the row; names."""


def rows(table):
    """Return the rows of a table's CSV text as mappings."""
    return list(csv.DictReader(io.StringIO(table.csv())))


def tables(hidden='drift'):
    """Return the tables of a summary by name."""
    return {table.name: table for table in tables_of(summary_of(hidden, 6))}


def test_curves_are_those_of_the_evaluation():
    """The result and as modelled, every digit."""
    made = evaluation_json(summary_of('drift', 6).result)
    for name, wanted in (('curves', made['result']), ('curves_as_modelled', made)):
        _are_curves(rows(tables()[name]), wanted)


def _are_curves(found, wanted):
    assert [float(row['table_angle_deg']) for row in found] == pytest.approx(np.rad2deg(wanted['angle_rad']))
    for curve, unit in CURVES.items():
        short = 'um' if unit == 'm' else 'urad'
        np.testing.assert_allclose([1e-6 * float(row[f'{curve}_{short}']) for row in found],
                                   wanted[f'{curve}_{unit}'], rtol=1e-15, atol=0)
        np.testing.assert_allclose([1e-6 * float(row[f'u_{curve}_{short}']) for row in found],
                                   wanted['u'][f'{curve}_{unit}'], rtol=1e-15, atol=0)


def test_deviations_are_those_of_the_evaluation():
    """Plate, freed of its clamping, which is a result of its own, and CMM."""
    wanted = evaluation_json(RunResult(summary_of('drift', 6).fit))
    found = rows(tables()['deviations'])
    np.testing.assert_allclose(rigid_motion(np.array(wanted['plate_freed_m']), wanted['radius_m'] * np.stack(
        [np.cos(wanted['angle_rad']), np.sin(wanted['angle_rad']), np.zeros(wanted['n'])], axis=-1)), 0, atol=1e-15)
    tilt = 1e6 * np.hypot(*wanted['clamping_rotation_rad'][:2])
    expanded = 1e6 * max(wanted['clamping_U_rotation_rad'][:2])
    assert re.search(rf'tilt {tilt:.2f} ± {expanded:.2f} µrad', tables()['deviations'].note)
    np.testing.assert_allclose([[2e-6 * float(row[f'u_plate_{axis}_um']) for axis in 'xyz'] for row in found],
                               wanted['plate_freed_U_m'], rtol=1e-12)
    for what in ('plate_freed', 'cmm'):
        np.testing.assert_allclose(
            [[1e-6 * float(row[f'{what.partition("_")[0]}_{axis}_um']) for axis in 'xyz'] for row in found],
            wanted[f'{what}_m'], rtol=1e-14, atol=0)


def test_candidates_are_those_of_the_diagnosis():
    """In the same order, with the same chances and errors."""
    summary = summary_of('drift', 6)
    wanted = diagnosis_json(summary.diagnosis)['candidates']
    found = rows(tables()['candidates'])
    assert [row['effect'] for row in found] == [one['effect'] for one in wanted]
    assert [row['claimed'] == 'yes' for row in found] == [one['claimed'] for one in wanted]
    assert [float(row['p']) for row in found] == [one['p'] for one in wanted]
    assert [float(row['rms_after_um']) for row in found] == pytest.approx(
        [1e6 * one['rms_after_m'] for one in wanted], rel=1e-14)


def test_residuals_are_all_there_before_and_after():
    """One row a reading, in measuring order."""
    summary, found = summary_of('drift', 6), rows(tables()['residuals'])
    assert [int(row['ball']) for row in found] == summary.run.ball.tolist()
    for when, fit in (('before', summary.fit), ('after', summary.final)):
        np.testing.assert_allclose([[float(row[f'{when}_{axis}_um']) for axis in 'xyz'] for row in found],
                                   1e6 * fit.residual, rtol=1e-14)


def test_effects_are_told_in_si_and_as_a_person_reads_them():
    """2.5 µm/h of drift in x were hidden."""
    [row] = [row for row in rows(tables()['effects']) if row['parameter'] == 'd_x']
    assert row['effect'] == 'frame_drift'
    assert row['unit_si'] == 'm/s' and row['unit'] == 'µm/h'
    assert float(row['value']) == pytest.approx(3.6e9 * float(row['value_si']), abs=0.01)
    assert abs(3.6e9 * float(row['value_si']) - 2.5) < 4 * 3.6e9 * float(row['u_si'])


@pytest.mark.parametrize('hidden', ['clean', 'drift'])
def test_numbers_have_their_unit_in_the_head(hidden):
    """Of every column of numbers in every file."""
    verified = verify([(RunResult(fit), source) for *_, fit, source in verification_runs()])
    every = [*tables(hidden).values(), *verification_tables(verified)]
    assert len({table.name for table in every}) == len(every)
    for table in every:
        assert len({column.key for column in table.columns}) == len(table.columns), table.name
        for one in table.columns:
            if any(isinstance(value, float) for value in one.values):
                assert WITH_UNIT.search(one.key) or PURE.match(one.key), f'{table.name}: {one.key}'


def test_parameters_that_are_not_determined_are_one_line():
    """Of a free form of all balls, 192 on a plate of 12; each that is determined has its own."""
    parameters = [Parameter('b', 1e-6, 1e-7, 'm'), *(Parameter(f'a_{ball}_{m}', 0.0, np.inf, 'm')
                                                     for ball in (1, 2, 3) for m in (2, 3)),
                  Parameter('c', 0.0, np.inf, 'rad')]
    table = effects([('ball_form', {'ball': 0, 'harmonic': 0, 'part': 'xy'}, parameters)], 'Effects', 's')
    assert [row[1:5] for row in table.rows] == [
        ('b', '+1.00', '±0.20', 'µm'), ('a_1_2 … a_3_3 (6)', '–', 'not determined', 'µm'),
        ('c', '–', 'not determined', 'µrad')]
    assert table.note == 'Not determined: cannot be told from other parameters of the model.'
    assert size_words('ball_form', parameters, {}) == (
        'b +1.00 ±0.20 µm, a_1_2 … a_3_3 (6) – not determined µm, c – not determined µrad')
    assert not effects([('ball_form', {}, parameters[:1])], 'Effects', 's').note


def test_what_is_not_known_is_left_empty():
    """No nan, no inf, no None in a file; texts with commas are quoted."""
    table = Table('t', 'T', (column('a_um', 'a', [1.5, float('nan'), float('inf'), -0.0]),
                             column('b', 'b', [None, 2, 3, 4], str), words('c', 'c', ['x,y', '"', 'é', ''])))
    assert table.csv() == 'a_um,b,c\n1.5,,"x,y"\n,2,""""\n,3,é\n0.0,4,\n'


def test_places_that_were_not_measured_are_gaps_in_bars():
    """They are not the lowest; of groups that are joined the measured ones count."""
    assert bars(np.array([np.nan, 0.0, 1.0]), 1.0) == '·▁█'
    assert bars(np.where(np.arange(80) % 2, 1.0, np.nan), 1.0) == 40 * '█'


def test_a_page_shows_what_is_meant_for_it():
    """Columns of the file alone are left out; heads have units, columns can be chosen, the footer follows them."""
    table = Table('t', 'T', (column('a', 'a', [1.0]), column('b', 'b', [2.0], '{:.1f}'.format, 'µm', footer=['sum']),
                             words('c', 'c', ['z'], footer=[''])), levels=('bad',))
    assert table.rows == (('2.0', 'z'),)
    assert table.footer == (('sum', ''),)
    assert [one.head for one in table.shown] == ['b / µm', 'c']
    assert table.select('c', 'a').csv() == 'c,a\nz,1.0\n'
    assert table.select('c').level(0) == 'bad'

# SPDX-License-Identifier: Apache-2.0
"""rosette evaluate against sums written down straight from the paper."""

import csv
import json
from math import cos, fsum, pi, sin

import pytest

from rosette_ros.analysis import MOST_BALLS_JUDGED

CURVES = ('ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad')


def paper(path, n):
    """Return the six curves of a table by equations (1) to (16), exact sums, no package code."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith('#')]
    x, y, z = {}, {}, {}
    for row in csv.DictReader(lines):
        place = int(row['table_position']), int(row['ball'])
        x[place], y[place], z[place] = (float(row[f'{axis}_mm']) / 1e3 for axis in 'xyz')
    every = range(1, n + 1)

    def phi(i):
        return 2 * pi * (i - 1) / n

    def alpha(i, j):
        return 2 * pi * ((i - 1) / n + (j - 1) / n)

    def row_mean(value, i):
        return fsum(value[i, j] for j in every) / n

    def mean(value):
        return fsum(value.values()) / n**2

    ctz = [row_mean(z, i) - mean(z) for i in every]                                         # (1)
    xs = {i: row_mean(x, i) - mean(x) for i in every}                                       # (4)
    ys = {i: row_mean(y, i) - mean(y) for i in every}                                       # (5)
    a = fsum(xs[i] * cos(phi(i)) + ys[i] * sin(phi(i)) for i in every) / n                  # (6)
    b = fsum(-xs[i] * sin(phi(i)) + ys[i] * cos(phi(i)) for i in every) / n                 # (7)
    ctx = [xs[i] - a * cos(phi(i)) + b * sin(phi(i)) for i in every]                        # (2)
    cty = [ys[i] - a * sin(phi(i)) - b * cos(phi(i)) for i in every]                        # (3)
    radius = fsum(x[i, j] * cos(alpha(i, j)) + y[i, j] * sin(alpha(i, j))
                  for i in every for j in every) / n**2                                     # (10)
    rz = {i: fsum(-x[i, j] * sin(alpha(i, j)) + y[i, j] * cos(alpha(i, j))
                  for j in every) / (n * radius) for i in every}                            # (9)
    crz = [rz[i] - fsum(rz.values()) / n for i in every]                                    # (8)
    rx = {i: 2 * fsum(z[i, j] * sin(alpha(i, j)) for j in every) / (n * radius)
          for i in every}                                                                   # (13)
    ry = {i: -2 * fsum(z[i, j] * cos(alpha(i, j)) for j in every) / (n * radius)
          for i in every}                                                                   # (14)
    c = fsum(rx[i] * cos(phi(i)) + ry[i] * sin(phi(i)) for i in every) / n                  # (15)
    d = fsum(-rx[i] * sin(phi(i)) + ry[i] * cos(phi(i)) for i in every) / n                 # (16)
    crx = [rx[i] - fsum(rx.values()) / n - c * cos(phi(i)) + d * sin(phi(i)) for i in every]
    cry = [ry[i] - fsum(ry.values()) / n - c * sin(phi(i)) - d * cos(phi(i)) for i in every]
    return dict(zip(CURVES, (ctx, cty, ctz, crx, cry, crz), strict=True))


@pytest.mark.parametrize(('n', 'order'), [(6, 'row'), (6, 'diagonal'), (7, 'random')])
def test_curves_agree_with_the_paper(rosette, make_table, n, order):
    """Within 1e-13 m and 1e-13 rad, at deviations of 50 µm."""
    path = make_table(n, order, seed=n)
    got = json.loads(rosette('evaluate', path, '--json').out)
    for curve, wanted in paper(path, n).items():
        assert got[curve] == pytest.approx(wanted, rel=0, abs=1e-13)


def test_json_has_what_the_contract_says(rosette, make_table):
    """Keys, lengths, units in the names; strict JSON on one line; on stderr that the model does not fit."""
    answer = rosette('evaluate', make_table(7), '--json')
    assert answer.err.count('\n') == 1 and json.loads(answer.out)['verdict'] in answer.err
    assert answer.out.count('\n') == 1
    got = json.loads(answer.out, parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-evaluation/1'
    assert got['n'] == 7
    assert got['radius_m'] == 0.1825
    for key in ('angle_rad', *CURVES):
        assert len(got[key]) == 7
    assert set(got['u']) == set(got['U']) == set(CURVES)
    assert (got['u_coverage_factor'], got['U_coverage_factor'], got['coverage_factor']) == (1, 2, 2)
    assert got['U']['ctz_m'] == [2 * u for u in got['u']['ctz_m']]
    assert {len(u) for u in got['u'].values()} == {7}
    assert min(min(u) for u in got['u'].values()) > 0
    for key in ('plate_m', 'cmm_m'):
        assert [len(row) for row in got[key]] == [3] * 7
    assert got['fit']['model'] == ['table_motions', 'plate_deviations', 'cmm_deviations']
    assert got['fit']['rank'] == 12 * 7 - 13
    assert got['fit']['dof'] == 3 * 49 - 12 * 7 + 13
    assert got['fit']['rms_m'] == pytest.approx(50e-6, rel=0.3)
    assert got['fit']['sigma_m'] > 0
    assert got['effects'] == {}
    assert len(got['gauge']) == 5


def test_repeatability_of_a_residual_500_times_larger_is_not_believed(rosette, make_table):
    """The uncertainties then come from the residuals, and the words say what is wrong."""
    path = make_table(6)
    fit = json.loads(rosette('evaluate', path, '--json').out)['fit']
    assert fit['sigma_m'] == fit['rms_m'] > 100 * fit['repeatability_m']
    out = ' '.join(rosette('evaluate', path).out.split())
    assert 'The readings scatter more than stated' in out


def test_a_model_file_is_used(rosette, make_table, tmp_path):
    """Without CMM deviations the rank falls and the names tell."""
    model = tmp_path / 'model.yaml'
    model.write_text('base: [table_motions, plate_deviations]\n')
    got = json.loads(rosette('evaluate', make_table(), '--model', model, '--json').out)
    assert got['fit']['model'] == ['table_motions', 'plate_deviations']
    assert got['fit']['rank'] < 12 * 6 - 13


def test_an_effect_comes_with_value_uncertainty_and_unit(rosette, make_table, tmp_path):
    """In SI."""
    model = tmp_path / 'model.yaml'
    model.write_text('effects: [frame_drift]\n')
    path = make_table(order='column')
    got = json.loads(rosette('evaluate', path, '--model', model, '--json').out)
    drift = got['effects']['frame_drift']
    assert drift
    for parameter in drift.values():
        assert set(parameter) == {'value', 'u', 'coverage_factor', 'unit'} and parameter['coverage_factor'] == 1
    assert 'frame_drift' in rosette('evaluate', path, '--model', model).out


def test_the_table_for_a_person(rosette, make_table):
    """Both names of every curve, units, expanded uncertainty, what cannot be known; no colour."""
    out = rosette('evaluate', make_table()).out
    for word in ('ctx', 'EXC', 'cty', 'EYC', 'ctz', 'EZC', 'crx', 'EAC', 'cry', 'EBC', 'crz',
                 'ECC', 'µm', 'µrad', 'U (k = 2)', 'repeatability of 0.100 µm', 'eccentricity'):
        assert word in out
    assert '\x1b' not in out
    assert max(len(line) for line in out.splitlines() if 'rosette add' not in line) <= 100


def test_csv_of_the_curves(rosette, make_table):
    """One row per table position; the same numbers as in the JSON, µm and µrad."""
    path = make_table()
    rows = list(csv.DictReader(
        line for line in rosette('evaluate', path, '--csv').out.splitlines() if not line.startswith('#')))
    wanted = json.loads(rosette('evaluate', path, '--json').out)
    assert [float(row['table_angle_deg']) for row in rows] == [0, 60, 120, 180, 240, 300]
    assert [float(row['crz_urad']) for row in rows] == pytest.approx(
        [1e6 * value for value in wanted['result']['crz_rad']], abs=1e-9)
    assert [float(row['u_ctz_um']) for row in rows] == pytest.approx(
        [1e6 * value for value in wanted['result']['u']['ctz_m']], abs=1e-9)


def test_missing_balls_show_in_the_uncertainty(rosette, make_table):
    """Positions with fewer balls are less certain; the table then shows U beside every value."""
    def cut(lines):
        return ['# balls: 6', *(line for line in lines
                                if line.split(',')[1:3] not in (['2', '1'], ['2', '4']))]
    path = make_table(edit=cut)
    got = json.loads(rosette('evaluate', path, '--json').out)
    assert got['readings'] == 34
    assert got['u']['ctz_m'][1] > got['u']['ctz_m'][4]
    out = rosette('evaluate', path).out
    assert '34 of 36 ball centres' in out
    assert out.count('±') == 2 * 6 + 36 + 36 + 4  # errors; curves; plate and CMM; clamping
    assert '…' not in out
    assert max(len(line) for line in out.splitlines() if 'rosette add' not in line) <= 100


def test_a_large_plate_is_judged_on_request(rosette, make_table):
    """One line names the verb that does; the keys of the verdict are null."""
    path = make_table(MOST_BALLS_JUDGED + 1)
    got = json.loads(rosette('evaluate', path, '--json').out)
    assert [got[key] for key in ('outcome', 'level', 'verdict', 'action')] == [None] * 4
    assert 'Plates of more than 36 balls are judged on request: rosette diagnose RUN' in rosette('evaluate', path).out

# SPDX-License-Identifier: Apache-2.0
"""Corrections as files: nothing is lost, signs and limits are those of the controllers, errors are told in words."""

import csv

import numpy as np
import pytest
import yaml

from rosette_ros.core.run.errors import InvalidConfig, InvalidData
from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.controller_tables import Axis, linuxcnc
from rosette_ros.io.correction_file import correction_csv, format_correction, read_correction

N = 12
ANGLE = TWO_PI * np.arange(N) / N


def motions(sign=1):
    """Return error motions with a crz of 10 microradian times the sine of the angle."""
    values = np.zeros((N, 6))
    values[:, 2], values[:, 5] = 2e-6 * np.cos(2 * ANGLE), sign * 1e-5 * np.sin(ANGLE)
    return ErrorMotions(ANGLE, values, np.full((N, 6), 1e-7))


BOTH = Correction(motions(), motions(-1), ('ctz', 'crz'), 'run 7', simulated=True)


@pytest.mark.parametrize('correction', [BOTH, Correction(*[motions()] * 2)])
def test_nothing_is_lost(tmp_path, correction):
    """What is written is read, bit for bit."""
    path = tmp_path / 'a.yaml'
    path.write_text(format_correction(correction, 'RT-4711'))
    found, serial = read_correction(path)
    assert (found.corrected, found.run_id, found.simulated, serial) == (
        correction.corrected, correction.run_id, correction.simulated, 'RT-4711')
    assert (found.backward is found.forward) == (correction.backward is correction.forward)
    for one, wanted in ((found.forward, correction.forward), (found.backward, correction.backward)):
        for name in ('angle', 'values', 'u'):
            np.testing.assert_array_equal(getattr(one, name), getattr(wanted, name))


@pytest.mark.parametrize(('change', 'words'), [
    ({'schema': 'rosette-plan/1'}, 'file of rosette correct RUN --for ros with "schema: rosette-correction/1"'),
    ({'corected': []}, "expected one of .*, found 'corected'|corected"),
    ({'corrected': ['crq']}, 'corrected: expected a list of ctx, cty, ctz, crx, cry, crz, found'),
    ({'corrected': []}, r'corrected: expected a list of .*, found \[\]'),
    ({'run_id': 7}, 'run_id: expected a text, found 7'),
    ({'simulated': 'no'}, "simulated: expected true or false, found 'no'"),
    ({'forward': None}, 'forward: expected a mapping of angle, ctx, .*, found None'),
    ({'forward': {'ctx': 'a'}}, "forward: ctx: expected a list of at most 4000 finite numbers, found 'a'"),
    ({'forward': {'ctx': [float('nan')] * N}}, 'forward: ctx: expected a list of at most 4000 finite numbers'),
    ({'forward': {'ctx': [0.0]}}, 'forward: expected as many values of each error as angles, found angle 12, ctx 1'),
    ({'forward': {'angle': [0.0] * N}}, 'a.yaml: correction: expected error motions at 5 equally spaced angles')])
def test_bad_files_are_refused_in_words(tmp_path, change, words):
    """By key, with what was wanted and what came."""
    path = tmp_path / 'a.yaml'
    values = yaml.safe_load(format_correction(BOTH))
    for key, value in change.items():
        values[key] = {**values[key], **value} if isinstance(value, dict) else value
    path.write_text(yaml.safe_dump(values))
    with pytest.raises(InvalidData, match=words):
        read_correction(path)


def test_a_table_for_people_and_programs():
    """Errors as they are, not turned round; the head says so, and what U is."""
    text = correction_csv(BOTH, np.deg2rad([0.0, 45.0, 90.0]))
    head = [line for line in text.splitlines() if line.startswith('#')]
    assert '# sign: deviations actual minus nominal; compensation = -deviation' in head
    assert any('U (k = 2) of a single value: ctx 0.2 µm' in line for line in head)
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith('#')))
    assert [float(row['crz_urad_forward']) for row in rows] == pytest.approx([0, 7.071068, 10], abs=1e-6)
    assert [float(row['crz_urad_backward']) for row in rows] == pytest.approx([0, -7.071068, -10], abs=1e-6)
    assert [float(row['ctz_um_forward']) for row in rows] == pytest.approx([2, 0, -2], abs=1e-6)
    one = correction_csv(Correction(*[motions()] * 2), np.zeros(1))
    assert one.splitlines()[-2] == ','.join(['angle_deg', *(
        f'{curve}_{"um" if curve.startswith("ct") else "urad"}' for curve in CURVES)])


def test_a_compensation_file_of_linuxcnc():
    """No comment, ascending, both limits, the trim against the error, each sense its own."""
    lines = [list(map(float, line.split())) for line in linuxcnc(BOTH, -360, 450, 7, Axis())[0].splitlines()]
    nominal, forward, backward = np.transpose(lines)
    assert (nominal[0], nominal[-1], len(lines) <= 256) == (-360, 450, True)
    assert (np.diff(nominal) > 0).all()
    wanted = -np.rad2deg(1e-5 * np.sin(np.deg2rad(nominal)))
    np.testing.assert_allclose(forward, wanted, atol=1e-9)
    np.testing.assert_allclose(backward, -wanted, atol=1e-9)


@pytest.mark.parametrize(('limits', 'corrected', 'words'), [
    ((0, 360, 1), CURVES, 'expected at most 256 lines, which LinuxCNC reads, found 361; take --step 1.412 to '),
    ((0, 360, 5), ('ctz',), 'expected crz among the errors to correct, .* found ctz')])
def test_what_linuxcnc_would_not_read_is_refused(limits, corrected, words):
    """In words, with what would do."""
    with pytest.raises(InvalidConfig, match=words):
        linuxcnc(Correction(BOTH.forward, BOTH.backward, corrected), *limits, Axis())

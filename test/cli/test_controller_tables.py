# SPDX-License-Identifier: Apache-2.0
"""Compensation tables, read back as their manuals say and applied to the run, leave only noise of crz."""

import re

import numpy as np
import pytest

from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.core.run.geometry import TWO_PI, rotate_z
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.ball_centre_table import read_csv, write_csv
from rosette_ros.io.controller_tables import OF_A_TURN, Axis, fanuc, heidenhain
from rosette_ros.simulation import Machine, machine_config

MACHINE = {'seed': 4, 'plate': {'balls': 12}, 'table': {'translation_um': 1.0, 'rotation_urad': 40.0, 'harmonics': 4}}


def of_sinumerik_enc(text, _):
    """Return what the axis moves on top of its command, deg: a positive value moves it in its negative direction."""
    assert re.match(r'%_N_AX_EEC_INI\nCHANDATA\(1\)\n', text) and text.endswith('M17\n')
    value = {int(at): float(one) for at, one in re.findall(r'\$AA_ENC_COMP\[0,(\d+),C1\]=(\S+)', text)}
    facts = dict(re.findall(r'\$AA_ENC_COMP_(\w+)\[0,C1\]=(\S+)', text))
    assert (float(facts['MIN']), float(facts['MAX']), facts['IS_MODULO']) == (0, 360, '1')
    assert [*value] == list(range(round(360 / float(facts['STEP'])) + 1)) and len(value) <= 200
    assert value[0] == value[max(value)] == 0  # at the reference point, and after a turn
    return lambda angle, sense: -np.interp(angle % 360, float(facts['STEP']) * np.array([*value]), [*value.values()])


def of_sinumerik_cec(text, sense_of):
    """As above; a table for each direction of the input axis, or direction 0 for both."""
    tables = {}
    for table in sorted(set(re.findall(r'\$AN_CEC\[(\d),', text))):
        facts = dict(re.findall(rf'\$AN_CEC_(\w+)\[{table}\]=(\S+)', text))
        assert facts['INPUT_AXIS'] == facts['OUTPUT_AXIS'] == '(C1)' and facts['IS_MODULO'] == '1'
        values = [float(one) for one in re.findall(rf'\$AN_CEC\[{table},\d+\]=(\S+)', text)]
        tables[int(facts['DIRECTION'])] = float(facts['STEP']) * np.arange(len(values)), values
    return lambda angle, sense: -np.interp(angle % 360, *tables.get(sense, tables.get(0, (None, None))))


def of_heidenhain(text, _):
    """The control takes off the error, positive where the travel is too long; BACKLASH: of the negative direction."""
    head, names, *rows, end, _ = text.split('\n')
    assert (head, names.split(), end) == ('BEGIN C1.COM MM', ['NR', 'AXISPOS', 'BACKLASH', 'C1'], '[END]')
    number, at, back, value = np.array([row.split() for row in rows], dtype=float).T
    assert number.tolist() == list(range(len(rows))) and len(rows) <= 256
    assert at[0] == 0 and 360 <= at[-1] < 360 + at[1] and value[0] == 0
    assert np.abs(np.diff(value)).max() <= (at[1] - at[0]) / 64
    return lambda angle, sense: -np.interp(angle % 360, at, value if sense > 0 else back)


def of_fanuc(text, told):
    """Each point adds its value, times magnification and detection unit, to the move; the sum over a turn is 0."""
    assert text.startswith('%\n') and text.endswith('%\n')
    value = {int(at) - 10000: int(one) for at, one in re.findall(r'N(1\d{4})P(-?\d+);', text)}
    facts = {key: float(one) for key, one in re.findall(r'(36\d\d) = ([\d.]+)', told)}
    assert (facts['3620'], facts['3622'], facts['3625']) == (0, max(value), 360) and len(value) <= 128
    assert max(map(abs, value.values())) <= 7 and facts['3623'] <= 100
    assert value[0] == value[max(value)] and sum(list(value.values())[1:]) == 0
    moved = 1e-4 * facts['3623'] * np.cumsum([0, *list(value.values())[1:]])
    return lambda angle, sense: np.interp(angle % 360, facts['3624'] * np.arange(len(value)), moved)


def of_linuxcnc(text, _):
    """The trim is added to the motor."""
    at, forward, backward = np.array([line.split() for line in text.splitlines()], dtype=float).T
    return lambda angle, sense: np.interp(angle, at, forward if sense > 0 else backward)


@pytest.fixture(scope='module')
def before(tmp_path_factory):
    """Return the path of a run of 12 balls of a table with a large crz."""
    path = tmp_path_factory.mktemp('before') / 'before.csv'
    write_csv(Machine(machine_config(MACHINE)).run(plan(12, 'diagonal'), run_id='before'), path)
    return path


READERS = {'sinumerik-enc': of_sinumerik_enc, 'sinumerik-cec': of_sinumerik_cec, 'heidenhain': of_heidenhain,
           'fanuc': of_fanuc, 'linuxcnc': of_linuxcnc}


@pytest.mark.parametrize(('sign', 'zero', 'words'), [
    (1, 0.0, ('--axis', 'C1')), (-1, 0.0, ('--axis', "C1'")),
    (-1, 17.0, ('--axis', 'C1', '--sign', '-1', '--zero', '17'))])
@pytest.mark.parametrize('target', READERS)
def test_a_table_that_a_controller_reads_takes_crz_off(rosette, tmp_path, before, target, sign, zero, words):
    """Of a table that counts like ours, of C' that counts clockwise, and with another zero."""
    file = tmp_path / 'table'
    limits = ('--range', '-400', '400', '--step', '4') if target == 'linuxcnc' else ()
    told = rosette('correct', before, '--for', target, '-o', file, *words, *limits)
    assert told.code == 0, told.err
    assert f'Axis: C1 = {zero:g}° {"+" if sign > 0 else "−"} table angle' in told.out
    adds = READERS[target](file.read_text(), told.out)
    run = read_csv(before)
    theta = np.rad2deg(run.table_angle) % 360
    moved = np.array([adds(np.array(zero + sign * one), sign) for one in theta])  # of the axis, on its own scale
    write_csv(run.replace(centre=rotate_z(np.deg2rad(sign * moved), run.centre)), tmp_path / 'after.csv')
    crz = [np.ptp(fit(read_csv(path)).error_motions.values[:, 5]) for path in (before, tmp_path / 'after.csv')]
    assert crz[0] > 3e-5
    assert crz[1] < (4e-6 if target == 'fanuc' else 1.5e-6)  # steps of 1e-4 deg; else decimals, lines between


def motions(sign, size=1e-4):
    """Return error motions with a crz of the sine of the angle, and a reversal."""
    angle = TWO_PI * np.arange(12) / 12
    values = np.zeros((12, 6))
    values[:, 5] = size * np.sin(angle) + sign * 1e-5
    return ErrorMotions(angle, values, np.full((12, 6), 1e-7))


BOTH = Correction(motions(1), motions(-1), ('crz',))


def test_each_sense_has_its_values_or_the_reversal_goes_elsewhere():
    """CEC and HEIDENHAIN have values for both; ENC and FANUC their mean, and the reversal is said; C' turns senses."""
    for axis, senses in ((Axis('C1'), (1, -1)), (Axis('C1', -1), (-1, 1))):
        for target in ('sinumerik-cec', 'heidenhain'):
            adds = READERS[target](OF_A_TURN[target](BOTH, 5.0, axis)[0], '')
            apart = [float(adds(np.array(40.0), sense)) for sense in (1, -1)]
            reversal = axis.sign * (senses[0] - senses[1]) * np.rad2deg(1e-5)
            assert apart[0] - apart[1] == pytest.approx(-reversal, abs=2e-7)
    for target, words in (('sinumerik-enc', 'MD32450 .MA_BACKLASH'), ('fanuc', 'parameter 1851')):
        assert re.search(rf'reversal of 4.13 arcsec .* goes into {words}',
                         ' '.join(OF_A_TURN[target](BOTH, 5.0, Axis('C1'))[1]))


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize('target', ['sinumerik-cec', 'heidenhain', 'fanuc'])
def test_how_to_try_the_sign_is_said_and_the_values_can_be_inverted(target, sign):
    """Where the table turns too far, and by how much; inverted, all values have the other sign and nothing else."""
    one = Correction(*[motions(0)] * 2, ('crz',))
    (text, told), (other, _) = (OF_A_TURN[target](one, 5.0, Axis('C', sign, count=count)) for count in (1, -1))
    names = {'(C)': '(C1)', 'C.COM': 'C1.COM', 'BACKLASH      C': 'BACKLASH      C1'}
    text, other = (re.sub('|'.join(map(re.escape, names)), lambda found: names[found[0]], some)
                   for some in (text, other))
    plain, inverted = (READERS[target](some, ' '.join(told)) for some in (text, other))
    at = np.arange(0.0, 360.0, 5.0)
    assert np.allclose(plain(at, 1), -inverted(at, 1), atol=1e-12) and np.ptp(plain(at, 1)) > 0.01
    said = re.search(r'Try the sign first, .* from C = 0 to (\d+) deg the table turns 20.63 arcsec too (\w+)', told[-1])
    assert (plain(float(said[1]), 1) < 0) == (said[2] == 'far')  # the controller moves it back
    assert told[-1].endswith('Where it is twice as much, write the file again with --invert.')


@pytest.mark.parametrize(('words', 'error'), [
    (['--for', 'sinumerik-enc', '--invert'],
     'correct: --invert goes with --for sinumerik-cec, heidenhain, fanuc only; leave it out'),
    (['--for', 'sinumerik-enc', '--step', '1'], 'expected at most 200 points, which a table of SINUMERIK holds, found '
                                                '361'),
    (['--for', 'fanuc', '--step', '2'], 'expected at most 128 points, which a table of FANUC holds, found 181; take '
                                        'a '),
    (['--for', 'heidenhain', '--step', '7'], 'expected a --step that divides a turn, found 7 deg'),
    (['--for', 'heidenhain', '--step', '3.2767'], 'expected a --step that divides a turn, found 3.2767 deg'),
    (['--for', 'sinumerik-cec', '--step', '3.2768'], 'expected a --step that divides a turn, found 3.2768 deg'),
    *[(['--for', target, '--zero', zero], f"--zero: expected a number (deg) from -360 to 360, found '{zero}'")
      for target in OF_A_TURN for zero in ('nan', 'inf', '1e300')],
    (['--for', 'linuxcnc', '--range', '0', 'nan'], "--range: expected a number (deg) from -36000 to 36000, found "
                                                   "'nan'"),
    (['--for', 'fanuc', '--detection-unit', '1e300'], "expected a positive number (deg), found '1e300'"),
    (['--for', 'fanuc', '--step', '60'], 'straight lines lose at most 10% of crz, found --step 60'),
    (['--for', 'fanuc', '--range', '0', '90'], 'correct: --range goes with --for csv, linuxcnc only; leave it out'),
    (['--for', 'csv', '--sign', '-1'], 'correct: --sign goes with --for linuxcnc, sinumerik-enc, '),
    (['--for', 'heidenhain', '--detection-unit', '0.001'], '--detection-unit goes with --for fanuc only'),
    (['--for', 'heidenhain', '--axis', '1C'], "--axis: expected the name of an axis such as C, C1 or C', found '1C'"),
    (['--for', 'heidenhain', '--curves', 'ctz'], 'expected crz among the errors to correct')])
def test_what_a_controller_would_not_take_is_refused(refused, tmp_path, before, words, error):
    """In words, with what would do."""
    assert error in refused('correct', before, '-o', tmp_path / 'c', *words)


def test_a_table_of_tnc_controls_has_a_power_of_two_between_its_entries():
    """2^15/10^4 deg by default, the entry beyond a turn as that of the next turn; other distances are told."""
    text, told = heidenhain(Correction(*[motions(0)] * 2, ('crz',)), 3.2768, Axis('C1'))
    at, value = np.array([row.split() for row in text.split('\n')[2:-2]], dtype=float).T[[1, 3]]
    assert np.allclose(np.diff(at), 3.2768, atol=1e-4) and at[-1] == pytest.approx(360.448)
    assert value[-1] == pytest.approx(np.rad2deg(1e-4 * np.sin(np.deg2rad(0.448))), abs=1e-7)
    assert not any('2^n' in words for words in told)
    assert heidenhain(Correction(*[motions(0)] * 2, ('crz',)), 5.0, Axis('C1'))[1][0] == (
        'TNC controls want a distance of 2^n/10^4 deg between the entries; 5 is none, --step 3.2768 is one.')


def test_sinumerik_is_told_to_switch_off_before_a_file_is_loaded():
    """A compensation that is active does not take new values."""
    one = Correction(*[motions(0)] * 2, ('crz',))
    for target, words in (('sinumerik-enc', 'MD32700'), ('sinumerik-cec', 'SD41300 .* and MD32710')):
        assert re.search(f'{words} .*: 0 before the file is loaded, 1 makes it active',
                         ' '.join(OF_A_TURN[target](one, 5.0, Axis())[1]))


def test_slopes_and_steps_beyond_a_format_are_refused():
    """HEIDENHAIN: 1/64 of the distance; FANUC: 7 times 100 units, and what is less than half a unit."""
    steep = Correction(*[motions(1, 0.05)] * 2, ('crz',))
    with pytest.raises(InvalidConfig, match='values of a .COM table that differ by at most 0.078125 deg from one to'):
        heidenhain(steep, 5.0, Axis())
    with pytest.raises(InvalidConfig, match='expected steps of at most 7 times 100 detection units'):
        fanuc(steep, 5.0, Axis(unit=1e-4))
    with pytest.raises(InvalidConfig, match='found less than 0.01 deg; state that of the controller by '
                                            '--detection-unit'):
        fanuc(Correction(*[motions(1, 1e-5)] * 2, ('crz',)), 5.0, Axis(unit=0.01))

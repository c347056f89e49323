# SPDX-License-Identifier: Apache-2.0
"""rosette correct and verify: from a run to a file for a controller, and the proof that it works."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from rosette_ros.cli.main import main
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.model_file import write_model
from rosette_ros.simulation import Machine, load_machine, machine_config

LOG = Path(__file__).parents[1] / 'golden' / 'logs' / 'log_clean_n6_diagonal'
MACHINE = {'seed': 4, 'plate': {'balls': 8},
           'table': {'translation_um': 1.0, 'rotation_urad': 8.0, 'harmonics': 3}}


@pytest.fixture
def measure(tmp_path):
    """Return a function that measures with the simulated machine and returns the path of the table."""
    def run(name, offset=0.0, **table):
        path = tmp_path / f'{name}.yaml'
        path.write_text(yaml.safe_dump({**MACHINE, 'table': {**MACHINE['table'], **table}}))
        scheme = plan(8, 'diagonal').shifted(offset)
        write_csv(Machine(load_machine(path)).run(scheme, run_id=name), tmp_path / f'{name}.csv')
        return tmp_path / f'{name}.csv'
    return run


def test_a_table_is_corrected_and_verified(rosette, measure, tmp_path):
    """The machine takes the file off, beside which it stands; verify confirms what is in the file, and nothing else."""
    before, file = measure('before'), tmp_path / 'c.yaml'
    told = rosette('correct', before, '-o', file, '--curves', 'ctz,crz')
    assert told.code == 0
    assert 'Harmonics: up to 4 of the table angle' in told.out
    assert f'verify {before} AFTER --correction {file}\n' in told.out
    after = measure('after', correction_file='c.yaml')
    confirmed = rosette('verify', before, after, '--correction', file)
    shown = confirmed.out
    assert confirmed.code == 0
    assert 'The correction did what it promised: of ctz, crz only noise is left, the rest is unchanged.' in shown
    told = json.loads(rosette('verify', before, after, '--correction', file, '--json').out)
    assert told['schema'] == 'rosette-verification/1'
    assert (told['level'], told['before'], told['after']) == ('good', 'before', 'after')
    assert {one['curve']: one['result'] for one in told['errors']} == {
        **dict.fromkeys(('ctx', 'cty', 'crx', 'cry'), 'not corrected, unchanged'),
        **dict.fromkeys(('ctz', 'crz'), 'only noise is left')}
    assert 'wrong sign' not in shown
    again = rosette('verify', before, before, '--correction', file)
    assert 'ctz (was not taken off), crz (was not taken off)' in again.out
    assert again.code == 1


def test_another_serial_number_is_told(rosette, tmp_path, monkeypatch):
    """Where correction and log name different tables."""
    file, identity = tmp_path / 'c.yaml', tmp_path / 'identity.yaml'
    identity.write_text('schema: rosette-identity/1\ntable: {maker: A, model: B, serial: RT-1}\n')
    assert rosette('correct', LOG, '-o', file, '--identity', identity).code == 0
    assert yaml.safe_load(file.read_text())['table'] == 'RT-1'
    monkeypatch.setattr(LogRun, 'identity', lambda *_: Identity({'table.serial': 'RT-2'}))
    shown = ' '.join(rosette('verify', LOG, LOG, '--correction', file).out.split())
    assert 'The correction is not of this table: ' in shown
    assert shown.count('is of table RT-2, the correction of table RT-1') == 2
    done = rosette('verify', LOG, LOG, '--correction', file, '--json')
    told = json.loads(done.out)
    assert told['remarks'][0] == f'{LOG}: is of table RT-2, the correction of table RT-1'
    assert (told['level'], done.code) == ('bad', 1)


@pytest.mark.parametrize(('target', 'lines', 'words'), [
    ('csv', 7 + 1 + 73, 'miss ctx, cty, ctz, crx, cry, crz by at most'), ('linuxcnc', 181, 'miss crz by at most')])
def test_tables_say_what_straight_lines_between_cost(rosette, measure, tmp_path, target, lines, words):
    """Of what is in the file, which has the lines that were wanted."""
    told = rosette('correct', measure('a'), '--for', target, '-o', tmp_path / 'out')
    line, = (one for one in told.out.splitlines() if words in one)
    assert ('µm' in line) == (target == 'csv')
    assert len((tmp_path / 'out').read_text().splitlines()) == lines


def test_the_next_command_has_the_model_of_the_correction(rosette, measure, tmp_path):
    """Or verify would judge the runs under the base model."""
    before, model = measure('before'), tmp_path / 'm.yaml'
    write_model(Model().with_effect('frame_drift'), model)
    told = rosette('correct', before, '-o', tmp_path / 'c.yaml', '--model', model)
    assert f'AFTER --correction {tmp_path / "c.yaml"} --model {model}\n' in told.out


@pytest.mark.parametrize(('words', 'error'), [
    (['--curves', 'crz,foo'], '--curves: expected some of ctx,cty,ctz,crx,cry,crz, found'),
    (['--for', 'linuxcnc', '--step', '1'], 'expected at most 256 lines, which LinuxCNC reads, found 361'),
    (['--for', 'linuxcnc', '--step', '79'], 'straight lines lose at most 10% of crz, found --step 79, which loses '),
    (['--for', 'linuxcnc', '--range', '-9999', '9999'],
     'a range of 19998 deg; LinuxCNC repeats no table, so narrow MIN_LIMIT and MAX_LIMIT of the axis, and --range, '),
    (['--for', 'linuxcnc', '--range', '-9999', '9999', '--step', '78.5'], 'which loses '),
    (['--for', 'linuxcnc', '--range', '-360', '450'], 'found 406; take --step 3.177 to '),
    (['--for', 'csv', '--range', '360', '0'], 'correct: --range: expected MIN below MAX, found 360 and 0'),
    (['--for', 'linuxcnc', '--range', '90', '90'], 'correct: --range: expected MIN below MAX, found 90 and 90'),
    (['--for', 'csv', '--range', '0', 'inf'], "--range: expected a number (deg) from -36000 to 36000, found 'inf'"),
    (['--for', 'csv', '--step', '1e-12'], 'found --range 0 360 with --step 1e-12; take a larger --step or a smaller'),
    (['--for', 'linuxcnc', '--range', '0', '1e308'], "expected a number (deg) from -36000 to 36000, found '1e308'"),
    (['--for', 'linuxcnc', '--range', '0', '36000', '--step', '0.1'], 'expected a table of at most 100000 lines, '
                                                                      'found '),
    (['--step', '-3'], 'expected a positive number'),
    (['--step', '5'], 'correct: --step goes with --for csv, linuxcnc, sinumerik-enc, sinumerik-cec, heidenhain, fan'),
    (['--range', '0', '90'], 'correct: --range goes with --for csv, linuxcnc only; leave it out'),
    (['-o', 'q.csv'], "--output: expected a name for YAML with --for ros, found 'q.csv'; --for csv writes a table")])
def test_what_cannot_be_is_refused(refused, measure, tmp_path, words, error):
    """In words; an existing file stays."""
    run = measure('a')
    assert error in refused('correct', run, '-o', tmp_path / 'c', *words)
    (tmp_path / 'c').write_text('mine')
    assert 'exists already' in refused('correct', run, '-o', tmp_path / 'c')
    assert (tmp_path / 'c').read_text() == 'mine'


def test_a_table_of_ball_centres_is_no_correction(refused, measure):
    """In words."""
    run = measure('a')
    assert 'rosette-correction/1' in refused('verify', run, run, '--correction', run)


def test_both_senses_of_turning_get_their_own_curves(rosette, tmp_path):
    """From two runs of one table, one clockwise, evaluated as one."""
    config = machine_config({**MACHINE, 'probing': {'repeatability_um': 0.05}})
    paths, forward = [tmp_path / '1.csv', tmp_path / '2.csv'], plan(8, 'diagonal')
    back = replace(forward, table_position=forward.table_position[::-1], ball=forward.ball[::-1],
                   approach=-forward.approach)
    for path, scheme in zip(paths, (forward, back)):
        write_csv(Machine(config).run(scheme, run_id=path.stem), path)
    told = rosette('correct', *paths, '--joint', '-o', tmp_path / 'c.yaml', '--curves', 'ctz,crz')
    assert told.code == 0
    assert 'Not corrected, as the runs do not tell it: the mean of the reversal of ctz, crz.' in told.out
    share = tmp_path / 'share.yaml'
    share.write_text('schema: rosette-sharing/1\nframe: shared\n')
    told = rosette('correct', *paths, '--share', share, '-o', tmp_path / 'c.yaml', '--force')
    assert told.code == 0
    assert 'Not corrected' not in told.out
    correction, _ = read_correction(tmp_path / 'c.yaml')
    assert correction.run_id == '1+2'
    assert correction.backward is not correction.forward
    assert np.abs(correction.backward.values - correction.forward.values).max() < 1e-6  # one table without backlash


def in_sense(path, sense, **settings):
    """Measure a table with backlash forward (1), backward (-1) or in both senses (0); return the path of the table."""
    machine = Machine(machine_config({
        **MACHINE, 'plate': {'balls': 6}, 'table': {**MACHINE['table'], **settings},
        'hidden': [{'kind': 'table_backlash', 'width_urad': 6.0}]}))
    forward = plan(6, 'diagonal')
    machine.run(forward)
    scheme = plan(6, 'there_and_back') if sense == 0 else replace(forward, approach=sense * forward.approach)
    write_csv(machine.run(scheme, run_id=path.stem), path)
    return path


@pytest.fixture(scope='module')
def senses(tmp_path_factory):
    """Return the paths of a run in each sense and in both, of a sharing file that says that all frames are one, and of
    the correction by the first two with it."""
    folder = tmp_path_factory.mktemp('senses')
    made = {name: in_sense(folder / f'{name}.csv', sense) for name, sense in (('fw', 1), ('bw', -1), ('both', 0))}
    made |= {'share': folder / 'share.yaml', 'correction': folder / 'c.yaml'}
    made['share'].write_text('schema: rosette-sharing/1\nframe: shared\n')
    assert main(['correct', *(str(made[name]) for name in ('fw', 'bw')), '--share', str(made['share']), '-o',
                 str(made['correction'])]) == 0
    return made


@pytest.mark.parametrize(('sense', 'before'), [(1, 'fw'), (-1, 'bw'), (0, 'both')])
def test_a_correction_for_both_senses_is_verified_in_that_of_the_run(rosette, senses, tmp_path, sense, before):
    """A reversal of 6 microradian is a mean that no run alone knows; each run is held against what it measured."""
    file = senses['correction']
    stated = read_correction(file)[0]
    assert np.ptp([stated.forward.values[:, 5].mean(), stated.backward.values[:, 5].mean()]) > 5e-6
    after = in_sense(tmp_path / 'after.csv', sense, correction_file=str(file))
    told = json.loads(rosette('verify', senses[before], after, '--correction', file, '--json').out)
    crz = told['errors'][5]
    assert told['p_of_table'] > 0.05 / 6
    assert crz['result'] == 'only noise is left'
    assert abs(crz['taken_off'] - 1) < 4 * crz['u_taken_off']
    assert not [one for one in told['errors'] if one['level'] == 'bad']


def test_each_sense_is_held_against_its_own_curves(rosette, senses, tmp_path):
    """A curve of the file that is wrong in one sense is found by the runs in this one only."""
    file = tmp_path / 'c.yaml'
    stated = yaml.safe_load(senses['correction'].read_text())
    stated['backward']['ctz'] = [-one for one in stated['backward']['ctz']]
    file.write_text(yaml.safe_dump(stated))
    backward, forward = (json.loads(rosette('verify', senses[name], senses[name], '--correction', file, '--json').out)
                         for name in ('bw', 'fw'))
    assert backward['p_of_table'] < 1e-6 < 0.05 / 6 < forward['p_of_table']


def test_runs_between_the_steps_are_verified_in_the_axes_of_the_correction(rosette, measure, tmp_path):
    """Their own x and y are turned by half a step, those of a joint correction are of table angle 0."""
    runs, file = (measure('zero'), measure('half', 22.5)), tmp_path / 'c.yaml'
    assert rosette('correct', *runs, '--joint', '-o', file).code == 0
    done = rosette('verify', runs[1], measure('after', 22.5, correction_file=str(file)), '--correction', file)
    assert done.code == 0
    assert 'of ctx, cty, ctz, crx, cry, crz only noise is left.' in done.out
    assert 'along x and y of table angle 0, as those of the correction.' in done.out


def test_angular_positioning_after_iso_230_2(rosette, senses):
    """From one run in each sense, with and without a known mean of the reversal, and from one there and back."""
    runs = senses['fw'], senses['bw']
    for words, is_known in ((('--share', senses['share']), True), (('--joint',), False)):
        told = json.loads(rosette('evaluate', *runs, *words, '--json').out)
        value, = told['iso_230_2']
        crz = {one['sense']: np.array(one['crz_rad']) for one in told['curves']}
        assert value['M'] == pytest.approx(np.ptp((crz[1] + crz[-1]) / 2), abs=1e-12)
        assert (value['E+'], value['E-']) == pytest.approx((np.ptp(crz[1]), np.ptp(crz[-1])), abs=1e-12)
        assert (value['R'], value['A']) == (None, None)
        assert [value[key] is not None for key in ('B', 'mean B', 'E')] == [is_known] * 3
        if is_known:
            assert abs(value['mean B']) == pytest.approx(6e-6, abs=4e-7)  # the width of the backlash
            assert value['B'] == pytest.approx(np.abs(crz[1] - crz[-1]).max(), abs=1e-12)
            assert value['E'] == pytest.approx(np.ptp([*crz[1], *crz[-1]]), abs=1e-12)
        shown = ' '.join(rosette('evaluate', *runs, *words).out.split())
        assert 'Angular positioning of ' in shown and 'R and A need five approaches to each angle in each' in shown
        assert ('need the mean of the reversal, which these runs do not tell' in shown) == (not is_known)
    value, = json.loads(rosette('evaluate', senses['both'], '--joint', '--json').out)['iso_230_2']
    assert value['M'] > 0 and value['R'] is None

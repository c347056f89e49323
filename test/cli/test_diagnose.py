# SPDX-License-Identifier: Apache-2.0
"""rosette diagnose: what is missing, what is hidden, and whether another run agrees."""

import json

import pytest
from simulated import DRIFT, WARP, simulated_table

HOUR = 3600.0


def diagnosed(rosette, *words):
    """Return the JSON object that the verb prints; it has to be strict."""
    answer = rosette('diagnose', *words, '--json')
    assert answer.code == 0, answer.err
    assert answer.out.count('\n') == 1
    return json.loads(answer.out, parse_constant=pytest.fail)


@pytest.fixture(scope='module')
def tables():
    """Return runs A and B of a cell that drifts and warps, and a clean one."""
    return (simulated_table('drift_and_warp', 8), simulated_table('drift_and_warp', 8, seed=4),
            simulated_table(n=8, seed=5))


def test_json_is_that_of_the_contract(rosette, tables):
    """Keys, levels, claimed effects, uncertainties and units; the truth lies within three u."""
    got = diagnosed(rosette, tables[0])
    assert got['schema'] == 'rosette-diagnosis/1'
    assert {'schema', 'model', 'fit', 'missing', 'unexplained', 'candidates',
            'invisible'} <= set(got)
    assert got['model'] == ['table_motions', 'plate_deviations', 'cmm_deviations']
    assert set(got['missing']) == {'frame_drift', 'plate_warp'}
    assert got['unexplained'] is False
    levels = {one['motion']: one for one in got['levels']}
    assert set(levels) == {'frame', 'plate'}
    for one in levels.values():
        assert set(one) == {'motion', 'motions', 'variables', 'probability', 'law', 'law_probability', 'law_certain',
                            'laws', 'text'}
        assert one['text'] in got['verdict'].replace('The probe', 'the probe')
        assert any('time' in some for some in one['variables']) and one['law_probability'] <= one['probability'] <= 1
        assert one['laws'][0] == {'effect': one['law'], 'probability': one['law_probability']}
    assert (levels['frame']['law'], levels['plate']['law']) == ('frame_drift', 'plate_warp')
    assert got['invisible'] == ['table_backlash', 'table_backlash_angle']
    assert set(got['invisible_bias']['table_backlash']) == {
        'ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad'}
    top = next(entry for entry in got['candidates'] if entry['effect'] == 'frame_drift')
    assert {'effect', 'p', 'visible_fraction', 'rms_before_m', 'rms_after_m', 'parameters', 'look_alikes'} <= set(top)
    assert top['p'] < 1e-6 and top['claimed'] and top['setting'] == {'axes': 'xyz'}
    assert 0.5 < top['visible_fraction'] <= 1
    assert top['rms_after_m'] < top['rms_before_m']
    for name, rate in zip(('d_x', 'd_y', 'd_z'), DRIFT['rate_um_per_h'], strict=True):
        parameter = top['parameters'][name]
        assert parameter['unit'] == 'm/s'
        assert abs(parameter['value'] - 1e-6 * rate / HOUR) < 3 * parameter['u']


def test_missing_effects_have_the_sizes_of_the_fit_with_all_of_them(rosette, tables, tmp_path):
    """As evaluate states them once they are in the model; the first alone would take up part of the second."""
    model = tmp_path / 'm.yaml'
    model.write_text('effects: [frame_drift, plate_warp]\n', encoding='utf-8')
    wanted = json.loads(rosette('evaluate', tables[0], '--model', model, '--json').out)['effects']
    got = {one['effect']: one['parameters'] for one in diagnosed(rosette, tables[0])['candidates'] if one['claimed']}
    assert {name: [one['value'] for one in effect.values()] for name, effect in got.items()} == {
        name: pytest.approx([one['value'] for one in effect.values()], rel=1e-6) for name, effect in wanted.items()}


def test_what_a_person_sees(rosette, tables):
    """Verdict first; µm/h and a chance that a metrologist reads; what it means; what to do."""
    out = rosette('diagnose', tables[0]).out
    lines = out.splitlines()
    assert lines[0].startswith('drift_and_warp_1: 8 balls')
    assert lines[1] == 'SYSTEMATIC EFFECT FOUND, NOT IN THE MODEL' and lines[2].startswith('The probe moves')
    flat = ' '.join(out.split())
    for words in ('The probe moves with time (', ' µm/h in ', ' ± ', 'most likely warping of the plate (', 'µm/h',
                  'U: expanded uncertainty (k = 2)',
                  'This run could not have shown ', 'backlash of the table', 'negligible',
                  f'rosette add frame_drift plate_warp --model model.yaml --run {tables[0]}',
                  'Order interleaved shows '):
        assert words in flat
    assert ' um' not in out
    assert max(len(line) for line in lines if 'rosette ad' not in line) <= 100
    drift = next(line for line in lines if line.startswith('frame_drift ') and 'd_x' in line)
    assert float(drift.split()[2]) == pytest.approx(DRIFT['rate_um_per_h'][0], abs=0.3)


def test_a_clean_run_lacks_nothing(rosette, tables):
    """No name, and the words say so."""
    got = diagnosed(rosette, tables[2])
    assert got['missing'] == []
    assert not any(entry['claimed'] for entry in got['candidates'])
    assert 'The model fits: ' in rosette('diagnose', tables[2]).out


def test_with_the_effects_in_the_model_nothing_is_missing(rosette, tables, tmp_path):
    """The file that `add` writes ends the search."""
    model = tmp_path / 'model.yaml'
    for name in ('frame_drift', 'plate_warp'):
        assert rosette('add', name, '--model', model).code == 0
    got = diagnosed(rosette, tables[0], '--model', model)
    assert got['missing'] == []
    assert got['model'][-2:] == ['frame_drift', 'plate_warp']


def test_a_base_term_left_out_is_missed(rosette, tables, tmp_path):
    """A model without plate deviations is told so, with what they are."""
    model = tmp_path / 'model.yaml'
    model.write_text('base: [table_motions, cmm_deviations]\n')
    got = diagnosed(rosette, simulated_table(order='diagonal'), '--model', model)
    assert got['missing'] == ['plate_deviations']
    out = rosette('diagnose', simulated_table(order='diagonal'), '--model', model).out
    assert '\nBall centre deviations. With it the residual ' in out and 'rosette add plate_deviations ' in out


def test_without_temperatures_their_effects_are_not_judged(rosette):
    """And neither is backlash where the sense of the moves is not known."""
    run = simulated_table(temperature=(float('nan'),) * 36, approach=(0,) * 36)
    got = diagnosed(rosette, run)
    assert got['unavailable'] == {
        **dict.fromkeys(('frame_temperature', 'frame_temperature_lag', 'table_zero_temperature',
                         'table_zero_lag', 'axis_tilt_temperature', 'axis_tilt_lag',
                         'plate_expansion_lag', 'cmm_scale_temperature', 'cmm_scale_lag'),
                        'the run has no temperatures'),
        'table_backlash': 'the run does not say in which sense the table moved',
        'table_backlash_angle': 'the run does not say in which sense the table moved',
        'encoder_interpolation': 'what it depends on does not change in this run'}
    assert 'Not judged' in rosette('diagnose', run).out


def test_another_run_confirms_what_was_learnt(rosette, tables):
    """The shape is there, at the size that was learnt, and the error falls without any fit."""
    check = diagnosed(rosette, tables[0], '--check', tables[1])['check']
    assert check['run_id'] == 'drift_and_warp_4'
    assert check['confirmed'] is True
    assert {entry['effect']: (entry['outcome'], entry['same_size'])
            for entry in check['effects']} == {'frame_drift': ('confirmed', True),
                                               'plate_warp': ('confirmed', True)}
    assert check['held_out_rms_after_m'] < 0.6 * check['held_out_rms_before_m']
    assert check['held_out_rms_carried_m'] < 0.7 * check['held_out_rms_before_m']
    out = rosette('diagnose', tables[0], '--check', tables[1]).out
    assert 'Checked on drift_and_warp_4' in out
    assert 'Linear probe drift is confirmed, with the same size.' in out


def test_a_clean_run_does_not_confirm(rosette, tables):
    """What is not there is not seen, and the amplitudes of the first run make it worse."""
    check = diagnosed(rosette, tables[0], '--check', tables[2])['check']
    assert check['confirmed'] is False
    assert {entry['outcome'] for entry in check['effects']} == {'not seen'}
    assert check['held_out_rms_carried_m'] > 1.5 * check['held_out_rms_before_m']
    assert WARP['kind'] in {entry['effect'] for entry in check['effects']}


def test_the_same_readings_are_no_check(rosette, refused, tables, tmp_path):
    """Also under another name, with only some of them, or as a log."""
    same = 'expected another run as a check, found 64 of 64 readings that are those of'
    assert same in refused('diagnose', tables[0], '--check', tables[0])
    rows = tables[0].read_text().replace('run_id: ', 'run_id: other_').splitlines()
    copy = tmp_path / 'other.csv'
    copy.write_text('\n'.join(rows[:-10]) + '\n')
    assert f'{copy}: expected another run as a check, found 54 of 54' in refused('diagnose', tables[0], '--check', copy)
    assert rosette('import', tables[0], '-o', tmp_path / 'log').code == 0
    assert same in refused('diagnose', tables[0], '--check', tmp_path / 'log', '--json')


def test_bad_paths_are_named(refused, tables):
    """Of either run."""
    assert 'nowhere.csv' in refused('diagnose', 'nowhere.csv')
    assert 'nowhere.csv' in refused('diagnose', tables[2], '--check', 'nowhere.csv')

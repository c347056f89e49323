# SPDX-License-Identifier: Apache-2.0
"""rosette add and remove: the model file, the residual before and after, and what is refused."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated import simulated_run, simulated_table

from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

BASE = ['table_motions', 'plate_deviations', 'cmm_deviations']


@pytest.fixture
def model(tmp_path):
    """Return the path of a model file that is not there yet."""
    return tmp_path / 'model.yaml'


def content(path):
    """Return the content of a model file, read without the package."""
    return yaml.safe_load(path.read_text(encoding='utf-8'))


def test_add_makes_the_file_from_the_base_model(rosette, model):
    """And only the file: nothing is left beside it."""
    answer = rosette('add', 'frame_drift', '--model', model)
    assert answer.code == 0
    assert content(model) == {'schema': 'rosette-model/1', 'base': BASE,
                              'effects': ['frame_drift']}
    assert [path.name for path in model.parent.iterdir()] == ['model.yaml']
    assert 'CMM measurement errors + linear probe drift' in answer.out


def test_remove_gives_the_file_back_as_it_was(rosette, model):
    """Effects in their order; a base term can go too."""
    for name in ('frame_drift', 'plate_warp', 'outlier'):
        rosette('add', name, '--model', model)
    rosette('remove', 'plate_warp', '--model', model)
    assert content(model)['effects'] == ['frame_drift', 'outlier']
    rosette('remove', 'cmm_deviations', '--model', model)
    assert content(model)['base'] == BASE[:2]
    rosette('add', 'cmm_deviations', '--model', model)
    assert content(model)['base'] == BASE


def test_what_explains_more_and_what_is_no_longer_needed_is_said(rosette, model, tmp_path):
    """After `add`: the weaker of two effects helps; one that imitated another is superfluous once that is there."""
    run = simulated_table('drift_and_warp', 6, 'sensitive')
    said = ' '.join(rosette('add', 'plate_warp', '--model', model, '--run', run).out.split())
    assert re.search(r'Warping of the plate (helps: .* But|does not lower .* while) linear probe drift '
                     r'\(frame_drift\) (explains \d\S* times more|is missing: add that first)\.', said)
    said = json.loads(rosette('add', 'frame_drift', '--model', model, '--run', run, '--json').out)['sentence']
    assert said.startswith('Linear probe drift')
    assert 'But' not in said and 'missing' not in said and 'needed' not in said
    warmup = {'kind': 'frame_warmup', 'amplitude_um': [1.5, -3.0, -1.5], 'time_constant_h': 0.17}
    config = MachineConfig().changed(seed=1, plate={'balls': 8}, hidden=[warmup])
    write_csv(Machine(config).run(plan(8, 'sensitive')), tmp_path / 'run.csv')
    rosette('add', 'frame_drift', '--model', tmp_path / 'm.yaml')
    said = rosette('add', 'frame_warmup', '--model', tmp_path / 'm.yaml', '--run', tmp_path / 'run.csv').out
    assert 'No longer needed: linear probe drift; remove frame_drift.' in ' '.join(said.split())


def test_the_right_effect_helps(rosette, model):
    """Before and after: residual, χ², cross-validation, curves, uncertainties, parameters."""
    run = simulated_table('drift_and_warp', 6, 'sensitive')
    answer = rosette('add', 'frame_drift', '--model', model, '--run', run)
    flat = ' '.join(answer.out.split())
    assert 'Linear probe drift helps: the cross-validation residual falls from' in flat
    for words in ('residual µm', 'reduced χ²', 'cross-validation residual µm', 'largest',
                  'U before', 'U after', 'crz', 'µm/h'):
        assert words in flat
    got = json.loads(rosette('add', 'plate_warp', '--model', model, '--run', run, '--json').out)
    assert got['schema'] == 'rosette-change/1'
    assert (got['action'], got['effect'], got['helps']) == ('add', 'plate_warp', True)
    assert got['held_out_rms_after_m'] < got['held_out_rms_before_m']
    assert got['after']['fit']['rms_m'] < got['before']['fit']['rms_m']
    assert set(got['curve_change']) == set(got['after']['u_max']) == {
        'ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad'}
    assert got['model']['effects'] == ['frame_drift', 'plate_warp']
    assert content(model) == got['model']


def test_a_wrong_effect_only_describes_noise(rosette, model):
    """Its residual falls a little, the cross-validation residual does not; the words say so."""
    run = simulated_table(seed=5)
    answer = rosette('add', 'plate_creep', '--model', model, '--run', run)
    flat = ' '.join(answer.out.split())
    assert re.search(r'Creep of the plate does not lower the cross-validation residual by more than chance '
                     r'\(.*\): noise is all that is described. Take it out', flat)
    flat = ' '.join(rosette('remove', 'plate_creep', '--model', model, '--run', run).out.split())
    assert 'Creep of the plate is not needed' in flat


def test_a_needed_effect_is_said_to_be_needed(rosette, model):
    """When it is taken out."""
    run = simulated_table('drift')
    rosette('add', 'frame_drift', '--model', model)
    got = json.loads(rosette('remove', 'frame_drift', '--model', model, '--run', run,
                             '--json').out)
    assert got['hurts'] and not got['helps']
    assert got['sentence'].startswith('Linear probe drift is needed: without it the ')
    assert content(model)['effects'] == []


def test_what_a_run_hides_is_refused_and_the_file_not_touched(refused, rosette, model):
    """Backlash of a table that always turns one way."""
    run = simulated_table()
    line = refused('add', 'table_backlash', '--model', model, '--run', run)
    assert 'table_backlash cannot be seen in this order of measurement' in line
    assert not model.exists()
    rosette('add', 'table_backlash', '--model', model)
    answer = rosette('remove', 'table_backlash', '--model', model, '--run', run)
    assert answer.code == 0
    assert 'The model before could not be fitted' in answer.out
    assert content(model)['effects'] == []


def test_settings_are_fixed(rosette, model):
    """Numbers as numbers, words as words; a run then finds the rest."""
    answer = rosette('add', 'frame_warmup', '--model', model, '--set', 'tau=600', '--set',
                     'axes=xyz', '--run', simulated_table('drift'))
    assert answer.code == 0, answer.err
    assert content(model)['effects'] == [{'name': 'frame_warmup', 'tau': 600, 'axes': 'xyz'}]
    assert 'tau 600' not in answer.out.splitlines()[0]


def test_a_term_of_ones_own(rosette, model):
    """Direction, expression and per what, as in a model file."""
    answer = rosette('add', 'wave', '--model', model, '--direction', 'z', '--expression',
                     't*cos(3*alpha)', '--per', 'all', '--run', simulated_table())
    assert answer.code == 0, answer.err
    assert content(model)['effects'] == [{'own': 'wave', 'direction': 'z',
                                          'expression': 't*cos(3*alpha)', 'per': 'all'}]
    out = ' '.join(answer.out.split())
    assert 'CMM measurement errors + wave (t*cos(3*alpha) along z)' in out
    assert 'Amplitude of a custom term: what it adds where its expression is 1, with t in s, T in K and' in out
    answer = rosette('evaluate', simulated_table(), '--model', model)
    assert '+ wave (t*cos(3*alpha) along z) (rank' in ' '.join(answer.out.split())
    assert rosette('remove', 'wave', '--model', model).code == 0
    assert content(model)['effects'] == []


REFUSED = {
    'unknown effect': (('frame_drif',), "Unknown effect 'frame_drif'. Did you mean frame_drift?"),
    'unknown setting': (('frame_warmup', '--set', 'time=3'), 'expected settings among axes, tau'),
    'word for a number': (('frame_warmup', '--set', 'tau=long'),
                          "effect frame_warmup: tau: expected a positive number (s), found 'long'"),
    'negative': (('frame_cycle', '--set', 'period=-3'), 'expected a positive number (s), found -3'),
    'no assignment': (('frame_warmup', '--set', 'tau'), 'expected NAME=VALUE such as tau=600'),
    'base term twice, with a setting': (('cmm_deviations', '--set', 'a=1'),
                                 'cmm_deviations is already in '),
    'base term twice': (('cmm_deviations',), 'cmm_deviations is already in '),
    'both kinds': (('wave', '--direction', 'z', '--expression', 't', '--set', 'a=1'), 'found both'),
    'no expression': (('wave', '--direction', 'z'), 'expected the key expression'),
    'unknown direction': (('wave', '--direction', 'up', '--expression', 't'),
                          "direction: expected one of x, y, z, axial"),
    'not arithmetic': (('wave', '--direction', 'z', '--expression', '__import__("os")'),
                       'expression: expected'),
    'a name of the library': (('frame_drift', '--direction', 'z', '--expression', 't'),
                              'frame_drift is the name of a library effect'),
}


@pytest.mark.parametrize('fault', REFUSED)
def test_add_refuses(refused, model, fault):
    """In words, and no file is made."""
    words, wanted = REFUSED[fault]
    assert wanted in refused('add', *words, '--model', model)
    assert not model.exists()


def test_a_choice_that_the_run_does_not_offer(refused, model):
    """What can be chosen is listed."""
    line = refused('add', 'ball_slip', '--set', 'ball=9', '--model', model, '--run',
                   simulated_table())
    assert 'effect ball_slip: ball: expected one of 1, 2, 3, 4, 5, 6, found 9' in line
    assert not model.exists()


def test_twice_is_refused(refused, rosette, model):
    """The same effect with the same settings."""
    rosette('add', 'frame_drift', '--model', model)
    assert f'frame_drift is already in {model}' in refused('add', 'frame_drift', '--model', model)
    assert content(model)['effects'] == ['frame_drift']
    rosette('add', 'outlier', '--set', 'reading=3', '--model', model)
    assert f'outlier(reading=3) is already in {model}' in refused(
        'add', 'outlier', '--set', 'reading=3', '--model', model)


def test_the_printed_command_adds_an_effect_that_is_missing_twice(rosette, model, tmp_path):
    """Two wrong readings, both by the command as it is printed; their names are apart."""
    run = simulated_run()
    off = np.zeros((run.size, 3))
    off[20, 0], off[30, 1] = 3e-6, 4e-6
    path = tmp_path / 'two.csv'
    write_csv(run.replace(centre=run.centre + off), path)
    line = next(line for line in rosette('evaluate', path).out.splitlines() if 'rosette add ' in line)
    verb, *words = shlex.split(line)[1:]
    assert words == ['outlier', 'outlier', '--model', 'model.yaml', '--run', str(path)]
    words[3] = model
    assert 'help: ' in rosette(verb, *words).out
    got = json.loads(rosette('evaluate', path, '--model', model, '--json').out)
    assert got['outcome'] != Outcome.NAMED
    assert sorted(got['effects']) == ['outlier(reading=21)', 'outlier(reading=31)']


def test_remove_names_what_is_there(refused, rosette, model):
    """For a name that is not in the model."""
    rosette('add', 'frame_drift', '--model', model)
    line = refused('remove', 'plate_warp', '--model', model)
    assert "Unknown effect 'plate_warp'. " in line


def test_a_broken_file_is_left_alone(refused, model):
    """It is named, with line and column, and keeps its content."""
    model.write_text('effects: [frame_drift\n', encoding='utf-8')
    line = refused('add', 'plate_warp', '--model', model)
    assert str(model) in line and 'expected YAML' in line
    assert model.read_text(encoding='utf-8') == 'effects: [frame_drift\n'


def test_a_file_that_cannot_be_written_is_never_half_written(refused, rosette, model,
                                                             monkeypatch):
    """The old one stays, and nothing lies about beside it."""
    rosette('add', 'frame_drift', '--model', model)
    before = model.read_bytes()

    def full(self, target):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'replace', full)
    line = refused('add', 'plate_warp', '--model', model)
    assert 'cannot be written: No space left on device' in line
    assert model.read_bytes() == before
    assert [path.name for path in model.parent.iterdir()] == ['model.yaml']


def test_a_folder_that_is_not_there(refused, tmp_path):
    """Is not made on the quiet."""
    line = refused('add', 'frame_drift', '--model', tmp_path / 'none' / 'model.yaml')
    assert 'cannot be written' in line

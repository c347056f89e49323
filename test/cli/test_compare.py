# SPDX-License-Identifier: Apache-2.0
"""rosette compare: where a model fails."""

import json
import re
from functools import partial

import numpy as np
import pytest
from simulated import DRIFT
from simulated import simulated_run as run_of
from simulated import simulated_table as table_of

from rosette_ros.cli.console import console, print_table
from rosette_ros.presentation.table_format import Table, column, words

pytestmark = pytest.mark.long

SIGMA = 1e-7
simulated_run, simulated_table = partial(run_of, n=8), partial(table_of, n=8)


@pytest.fixture
def model(tmp_path):
    """Return the path of a model with both effects that the machine hides."""
    path = tmp_path / 'model.yaml'
    path.write_text('effects: [frame_drift, plate_warp]\n', encoding='utf-8')
    return path


def test_json_has_its_keys(rosette):
    """All groupings and worst readings, strict JSON on one line."""
    answer = rosette('compare', simulated_table('slip'), '--json')
    assert answer.out.count('\n') == 1
    got = json.loads(answer.out, parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-comparison/1'
    assert set(got) == {'schema', 'run_id', 'model', 'fit', 'failing', 'summary', 'axis_rms_m',
                        'groups', 'neighbours', 'worst_readings', 'outcome', 'level', 'verdict', 'action'}
    assert set(got['groups']) == {'table position', 'ball', 'CMM position', 'time', 'sequence'}
    assert len(got['groups']['ball']['rms_m']) == 8
    assert {'reading', 'table_position', 'ball', 'cmm_position', 'residual_m', 'size_sigma',
            'p', 'weight', 'curves_without'} == set(got['worst_readings'][0])


def test_a_ball_that_moved_is_found(rosette):
    """The ball stands out, and the worst readings are readings of that ball."""
    got = json.loads(rosette('compare', simulated_table('slip'), '--json').out)
    assert got['failing']
    assert got['groups']['ball']['worst'] == '4'
    assert got['groups']['ball']['p'] < 0.01
    assert [one['ball'] for one in got['worst_readings'][:3]] == [4, 4, 4]
    run = simulated_run('slip')
    worst = got['worst_readings'][0]
    assert run.table_position[worst['reading'] - 1] == worst['table_position']


def test_drift_makes_neighbours_alike(rosette):
    """It is spread over all positions of a shuffled order, but not over the sequence."""
    got = json.loads(rosette('compare', simulated_table('drift'), '--json').out)
    assert got['failing']
    assert got['neighbours']['correlation'] > 0.3
    assert got['neighbours']['p'] < 1e-6
    assert 'autocorrelation (lag 1) +' in got['summary']


def test_a_clean_run_fails_nowhere(rosette):
    """The residual is the noise along every axis."""
    got = json.loads(rosette('compare', simulated_table(), '--json').out)
    assert not got['failing']
    assert got['axis_rms_m'] == pytest.approx([SIGMA] * 3, rel=0.35)


def test_what_a_person_sees(rosette):
    """Verdict first, σ and where it comes from, bars, the map with the loud ball, no colour."""
    answer = rosette('compare', simulated_table('slip'))
    lines = answer.out.splitlines()
    assert lines[1].startswith('The model does not fit')
    assert 'slip of' not in answer.out and 'ball_slip' not in answer.out
    assert 'rosette diagnose ' in lines[-1]
    assert ' µm, the repeatability; uncertainties of the curves follow ' in ' '.join(answer.out.split())
    bars = next(line for line in lines if line.startswith('ball '))
    assert bars.split()[1][3] == '█'
    rows = [line.split()[1:] for line in lines if line.strip()[:2].strip().isdigit()
            and set(line.split()[1:]) <= {'·', *'23456789'} and len(line.split()) == 9]
    assert len(rows) == 8
    loud = np.array([[mark in '23456789' for mark in row] for row in rows])
    assert loud[:, 3].sum() >= 5
    assert loud.sum() - loud[:, 3].sum() < 16
    assert max(map(len, lines)) <= 100
    assert '\x1b' not in answer.out


def test_time_and_sequence_are_one_row_where_they_are_the_same(rosette):
    """An even pace parts the readings alike, one that becomes slower does not; numbers stand beside the minutes."""
    even = simulated_table('drift', order='sensitive', time=tuple(30.0 * np.arange(64)))
    assert re.search('^time  .* min \\(readings ', rosette('compare', even).out, re.MULTILINE)
    out = rosette('compare', simulated_table('drift', order='sensitive', time=tuple(0.5 * np.arange(64)**2))).out
    assert re.search('^time  ', out, re.MULTILINE) and re.search('^sequence  ', out, re.MULTILINE)


def test_a_residual_far_below_the_repeatability_has_digits(rosette):
    """A full bar of 0 σ and 0.00 for every axis would say nothing."""
    out = rosette('compare', simulated_table(repeatability=1e-4)).out
    assert 'σ = 100 µm, the repeatability' in ' '.join(out.split())
    assert re.search(r'a full bar is 0\.00\d\d σ', out)
    assert re.search(r'^x +0\.\d+ +0\.00\d+$', out, re.MULTILINE)


def test_without_a_repeatability_the_scale_is_said(rosette):
    """The residual itself is what readings are measured by then."""
    path = simulated_table('slip', repeatability=None, repeatability_dof=None)
    assert 'the repeatability is not known' in ' '.join(rosette('compare', path).out.split())


def test_missing_balls_are_blank(rosette, tmp_path):
    """In the map of an incomplete run, which has all the rest."""
    lines = simulated_table('slip').read_text().splitlines()
    head = [line for line in lines if line.startswith('#')]
    rows = [line for line in lines[len(head):] if line.split(',')[1:3] != ['5', '6']]
    path = tmp_path / 'part.csv'
    path.write_text('\n'.join([*head, *rows]) + '\n')
    answer = rosette('compare', path)
    assert '63 of 64 ball centres' in answer.out


def test_the_ladder_falls_with_every_right_effect(rosette, model):
    """Base model, drift, warp: the error in readings left out goes down to the noise."""
    path = simulated_table('drift_and_warp')
    got = json.loads(rosette('compare', path, '--model', model, '--ladder', '--json').out)
    assert [step['added'] for step in got['ladder']] == ['', 'frame_drift', 'plate_warp']
    held = [step['held_out_rms_m'] for step in got['ladder']]
    assert held[0] > 2 * held[2] and held[0] > held[1] > held[2]
    assert held[2] == pytest.approx(SIGMA, rel=0.25)
    assert got['ladder'][2]['fit']['reduced_chi_square'] < got['ladder'][0]['fit'][
        'reduced_chi_square']
    out = rosette('compare', path, '--model', model, '--ladder').out
    base, drift, warp = out.splitlines()[-3:]
    assert base.startswith('base model ') and drift.startswith('+ frame_drift ')
    assert warp.startswith('+ plate_warp ') and drift.split()[-2].startswith('−')
    assert DRIFT['kind'] in out


def test_a_broken_model_is_named(refused, tmp_path):
    """File and what was wanted."""
    path = tmp_path / 'model.yaml'
    path.write_text('effects: [frame_drif]\n')
    line = refused('compare', simulated_table(), '--model', path)
    assert str(path) in line
    assert 'Unknown effect ' in line


def test_no_number_is_cut(capsys):
    """A narrow screen wraps heads, then its lines go beyond it: −1.314 is never shown as −1.3, nor a name broken."""
    numbers = ['−1.314', '+2.539', '>0.99']
    data = Table('t', 'T', (words('n', 'name', ['frame_drift_onset'] * 3), *(
        column(f'c{k}', f'a heading of many words {k}', numbers, str) for k in range(8))))
    for width in (100, 60, 20):
        out = console()
        out.width = width
        print_table(out, data)
        lines = capsys.readouterr().out.splitlines()[-3:]
        assert [line.split() for line in lines] == [['frame_drift_onset', *8 * [number]] for number in numbers]
        assert out.width == width


def test_the_picture_of_the_noise_is_written_once(rosette, refused, tmp_path):
    """Named in what is printed; an existing file stays, and another format is refused."""
    path = tmp_path / 'noise.svg'
    assert 'noise.svg' in rosette('compare', simulated_table('slip'), '--noise-picture', path).out
    drawn = path.read_text(encoding='utf-8')
    assert '<svg' in drawn
    assert 'exists' in refused('compare', simulated_table('slip'), '--noise-picture', path)
    assert path.read_text(encoding='utf-8') == drawn
    words = refused('compare', simulated_table('slip'), '--noise-picture', tmp_path / 'noise.jpg')
    assert 'expected a file name that ends with .png, .svg, .pdf' in words

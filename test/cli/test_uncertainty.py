# SPDX-License-Identifier: Apache-2.0
"""`rosette budget`: the uncertainty budget of a run for people and programs."""

import json

import numpy as np
import pytest
from simulated import simulated_table
from touched_log import write_touched_log

from rosette_ros.simulation import Machine, MachineConfig

INPUTS = """
schema: rosette-budget/1
ball_form: {form_um: 0.13, words: grade 5}
radius: {u_um: 1.0}
"""


@pytest.fixture
def inputs(tmp_path):
    """Return the path of a file of inputs."""
    path = tmp_path / 'inputs.yaml'
    path.write_text(INPUTS)
    return path


def test_budget_and_monte_carlo_are_shown(rosette, inputs, tmp_path):
    """Each contribution, its input, the sum, whether Monte Carlo agrees, what is not considered; and the bars."""
    picture = tmp_path / 'bars.png'
    told = rosette('budget', simulated_table(n=6), '--inputs', inputs, '--monte-carlo', '3000', '-o', picture)
    assert told.code == 0
    text = ' '.join(told.out.split())
    for words in ('repeatability x', 'form of the balls', 'grade 5', 'combined u', 'U (k = 2)', 'effective dof',
                  'Monte Carlo, 3000 trials, seed 0 (GUM S1)', 'Monte Carlo confirms the budget', 'Not considered',
                  'table frame as it was found (alignment)'):
        assert words in text
    assert picture.read_bytes().startswith(b'\x89PNG')
    again = rosette('budget', simulated_table(n=6), '-o', picture)
    assert again.code == 2 and 'exists' in again.err


def test_json_adds_up(rosette, inputs):
    """The squares of the contributions, but for bounds, are that of u; U is twice that; Monte Carlo is beside it."""
    found = json.loads(rosette('budget', simulated_table('drift', 6), '--inputs', inputs, '--hidden-effects',
                               '--monte-carlo', '100', '--json').out)
    for curve in ('ctx_m', 'crz_rad'):
        square = sum(one['u'][curve]**2 for one in found['contributions'] if not one['is_bound'])
        assert found['u'][curve] == pytest.approx(np.sqrt(square))
        assert found['U'][curve] == pytest.approx(2 * found['u'][curve])
        assert found['monte_carlo']['curves'][curve]['u'] > 0
    effects, form = found['contributions'][3:5]
    assert (effects['name'], form['name']) == ('effects in the model', 'form of the balls') and form['dof'] is None
    assert found['contributions'][-1]['is_bound']
    assert not any(words.startswith('What the model lacks') for words in found['not_considered'])  # it is taken off


def test_touches_of_a_log_are_a_line(rosette, tmp_path):
    """Their scatter is that of the machine: the log holds each touch."""
    config = MachineConfig().changed(plate={'balls': 6})
    write_touched_log(tmp_path / 'log', config)
    found = json.loads(rosette('budget', tmp_path / 'log', '--json').out)
    touches = next(one for one in found['contributions'] if one['name'] == 'touches')
    assert touches['value'] == pytest.approx(Machine(config).pattern.touch_noise, rel=0.06)
    assert touches['source'] == 'touches in the log'


def test_mistakes_are_named(rosette, tmp_path):
    """One line each."""
    run = simulated_table(n=6)
    assert 'expected a file name that ends with .png, .svg, .pdf' in rosette('budget', run, '-o', 'bars.gif').err
    assert 'expected a whole number in 100 .. 1000000' in rosette('budget', run, '--monte-carlo', '5').err
    assert '--seed goes with --monte-carlo only; leave it out' in rosette('budget', run, '--seed', '3').err
    (tmp_path / 'bad.yaml').write_text('schema: rosette-budget/1\nform: 3\n')
    words = rosette('budget', run, '--inputs', tmp_path / 'bad.yaml').err
    assert 'bad.yaml: expected one of touches, ball_form' in words

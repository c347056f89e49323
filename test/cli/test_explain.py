# SPDX-License-Identifier: Apache-2.0
"""rosette explain: what explains a run, with probabilities."""

import json

import pytest
from simulated import simulated_table


def test_a_hidden_drift_has_nearly_all_probability(rosette):
    """JSON, strict: the names, their probabilities, explanations up to 95 % together; and the same in words."""
    table = simulated_table('drift_and_warp')
    answer = rosette('explain', table, '--json')
    assert answer.code == 0, answer.err
    got = json.loads(answer.out, parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-explanation/1'
    assert 'frame_drift' in {one['effect'] for one in got['missing'] if one['with_look_alikes'] > 0.9}
    assert sum(one['probability'] for one in got['explanations']) >= 0.95
    assert got['probability_of_nothing'] < 1e-3
    assert got['final']['rms_m'] < got['fit']['rms_m']
    out = rosette('explain', table).out
    assert 'Explanations, the likeliest first' in out and '(frame_drift)' in out


def test_a_clean_run_says_that_nothing_is_missing(rosette):
    """In words and in numbers."""
    table = simulated_table(seed=5)
    got = json.loads(rosette('explain', table, '--json').out)
    assert got['missing'] == got['unnamed'] == []
    assert got['probability_of_nothing'] > 0.5
    assert 'nothing is missing' in rosette('explain', table).out

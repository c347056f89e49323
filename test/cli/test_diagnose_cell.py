# SPDX-License-Identifier: Apache-2.0
"""rosette diagnose RUN RUN ...: what comes again in the runs of a cell."""

import json

import pytest
from simulated import simulated_table

import rosette_ros


@pytest.fixture(scope='module')
def runs():
    """Return three runs of a cell that drifts and whose plate warps."""
    return [simulated_table('drift_and_warp', seed=seed) for seed in (3, 4, 5)]


def test_json_says_what_comes_again(rosette, runs):
    """Both causes in all runs, with sizes and U, and the words of the screen."""
    answer = rosette('diagnose', *runs, '--json')
    assert answer.code == 0, answer.err
    got = json.loads(answer.out, parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-cell-diagnosis/1' and got['level'] == 'bad' and len(got['runs']) == 3
    again = {one['laws'][0]['effect']: one for one in got['causes'] if one['kind'] == 'property'}
    assert set(again) == {'frame_drift', 'plate_warp'}
    for one in again.values():
        assert one['property'] > 0.9 and one['expected_runs'] > 2.9 and one['judged_runs'] == 3
        for each in one['runs']:
            assert each['probability'] > 0.9 and 0 < each['U_m'] < each['size_m']
    assert any('the probe moves with time' in one.lower() for one in got['sentences'])
    assert got['hidden'] and got['orders'][0]['shows']


def test_screen_shows_causes_and_runs(rosette, runs):
    """A sentence for each cause, a table of causes, and one of the causes in each run."""
    answer = rosette('diagnose', *runs)
    assert answer.code == 0, answer.err
    for words in ('The probe moves with time (99 %)', 'in 3 of 3 runs', 'Causes of the cell', 'The causes in each run',
                  'None of these runs could have shown', 'would show'):
        assert words in ' '.join(answer.out.split())


def test_python_gives_the_same(runs):
    """A list of runs is diagnosed as a cell."""
    found = rosette_ros.diagnose(list(runs[:2]))
    assert [one.name for one in found.causes][:1] and found.to_mapping()['schema'] == 'rosette-cell-diagnosis/1'


def test_the_same_run_twice_is_refused(refused, runs):
    """Its noise would count as that of two runs."""
    assert 'expected different runs, found the same ball centres in both' in refused('diagnose', runs[0], runs[0])
    assert 'expected one RUN with --check, found several' in refused('diagnose', *runs, '--check', runs[0])


def test_six_runs_of_a_demo_are_diagnosed_together(rosette, tmp_path):
    """As the README has it: one machine, so many runs, a command that names them."""
    made = rosette('demo', '--offline', '--hidden', 7, '--balls', 6, '--runs', 3, '--output', tmp_path)
    assert made.code == 0, made.err
    logs = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    assert len(logs) == 3 and '3 runs of one machine' in made.out and all((one / 'envelope.json').exists()
                                                                         for one in logs)
    answer = rosette('diagnose', *logs)
    assert answer.code == 0, answer.err


def test_experience_of_another_table_is_refused_unless_asked_for(rosette, refused, runs, tmp_path):
    """By the serial numbers of both."""
    known, who = tmp_path / 'cell.yaml', tmp_path / 'identity.yaml'
    known.write_text('schema: rosette-experience/1\ntable: T17\nruns: 6\ncauses:\n'
                     '- {effect: frame_drift, rate: 0.8, in_runs: 5, judged_runs: 6}\n')
    who.write_text('schema: rosette-identity/1\ntable: {serial: T18}\n')
    words = ('evaluate', runs[0], '--identity', who, '--experience', known)
    assert 'expected a run of table T17, of which 6 runs have taught the experience, found table T18' in refused(*words)
    told = rosette(*words, '--any-cell')
    assert told.code == 0 and 'in 5 of 6 earlier runs; this run alone: ' in ' '.join(told.out.split())

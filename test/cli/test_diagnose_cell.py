# SPDX-License-Identifier: Apache-2.0
"""rosette diagnose RUN RUN ...: what comes again in the runs of a cell."""

import json

import pytest
from simulated import simulated_table

import rosette_ros
from rosette_ros.cli.cell import experience_parameter
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig


@pytest.fixture(scope='module')
def runs():
    """Return three runs of a cell that drifts and whose plate warps."""
    return [simulated_table('drift_and_warp', seed=seed) for seed in (1, 4, 5)]


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


def test_python_gives_the_same(runs, tmp_path):
    """A list of runs is diagnosed as a cell."""
    found = rosette_ros.diagnose(list(runs[:2]))
    assert [one.name for one in found.causes][:1] and found.to_mapping()['schema'] == 'rosette-cell-diagnosis/1'
    told = [one for one in found.to_mapping()['causes'] if one['kind'] != 'possible']
    frame = found.to_frame('cell_runs')
    assert list(frame) == ['run', 'effect', 'probability', 'alone', 'size_um', 'u_um']
    assert len(frame) == 2 * len(told) and frame.attrs['units'] == {'size_um': 'µm', 'u_um': 'µm'}
    first, [line, *_] = frame.iloc[0], told[0]['runs']
    assert (first['run'], first['effect']) == (line['run'], told[0]['laws'][0]['effect'])
    for key, wanted in (('probability', line['probability']), ('alone', line['alone']),
                        ('size_um', 1e6 * line['size_m']), ('u_um', 0.5e6 * line['U_m'])):
        assert first[key] == pytest.approx(wanted)
    found.save_plot(tmp_path / 'causes.png')
    assert (tmp_path / 'causes.png').stat().st_size and found.plot().axes[0].collections


def test_the_same_run_twice_is_refused(refused, runs):
    """Its noise would count as that of two runs."""
    assert 'expected different runs, found the same ball centres in both' in refused('diagnose', runs[0], runs[0])
    assert 'expected one RUN with --check, found several' in refused('diagnose', *runs, '--check', runs[0])


def test_runs_of_a_demo_are_diagnosed_together(rosette, tmp_path):
    """As the README has it: one machine, so many runs, a command that names them."""
    made = rosette('demo', '--offline', '--hidden', 7, '--balls', 6, '--runs', 2, '--output', tmp_path)
    assert made.code == 0, made.err
    logs = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    assert len(logs) == 2 and '2 runs of one machine' in made.out and all((one / 'envelope.json').exists()
                                                                         for one in logs)
    answer = rosette('diagnose', *logs)
    assert answer.code == 0, answer.err


@pytest.fixture(scope='module')
def another(tmp_path_factory):
    """Return the paths of what earlier runs of a table have taught, and of the identity of another table."""
    known, who = (tmp_path_factory.mktemp('another') / f'{name}.yaml' for name in ('cell', 'identity'))
    known.write_text('schema: rosette-experience/1\ntable: T17\nruns: 6\ncauses:\n'
                     '- {effect: frame_drift, rate: 0.8, in_runs: 5, judged_runs: 6}\n')
    who.write_text('schema: rosette-identity/1\ntable: {serial: T18}\n')
    return known, who


def test_experience_of_another_table_is_refused_unless_asked_for(rosette, refused, runs, another):
    """By the serial numbers of both."""
    known, who = another
    words = ('evaluate', runs[0], '--identity', who, '--experience', known)
    assert 'expected a run of table T17, of which 6 runs have taught the experience, found table T18' in refused(*words)
    told = rosette(*words, '--any-cell')
    assert told.code == 0 and 'in 5 of 6 earlier runs; this run alone: ' in ' '.join(told.out.split())


def test_python_takes_the_experience_of_another_table_where_asked(runs, another):
    """evaluate and diagnose alike; the refusal names the argument."""
    known, who = another
    run = rosette_ros.read(runs[0], identity=who)
    for ask in (rosette_ros.evaluate, rosette_ros.diagnose):
        with pytest.raises(rosette_ros.RosetteError, match='found table T18; any_cell=True takes it all the same'):
            ask(run, experience=known)
        assert 'frame_drift' in [one.name for one in ask(run, experience=known, any_cell=True).verdict.missing]


def test_a_cell_is_started_with_its_experience(another):
    """Of the table of its identity, unless another one is asked for."""
    known, who = another
    assert experience_parameter(None, None, False) == {}
    assert experience_parameter(str(known), None, False) == {'experience': str(known)}
    assert experience_parameter(str(known), str(who), True) == {'experience': str(known)}
    with pytest.raises(rosette_ros.RosetteError, match='expected the cell of table T17, of which 6 runs have'):
        experience_parameter(str(known), str(who), False)


def test_u_of_what_an_order_hides_is_that_of_the_cell(rosette, refused, tmp_path):
    """A drift of the table that comes in every run of the cell, in a run and in a plan of an order that hides it."""
    run, known = tmp_path / 'row.csv', tmp_path / 'cell.yaml'
    write_csv(Machine(MachineConfig().changed(seed=7, plate={'balls': 6})).run(plan(6, 'row', 7)), run)
    known.write_text('schema: rosette-experience/1\nruns: 40\ncauses: [{effect: table_zero_drift, rate: 0.97, '
                     'in_runs: 40, judged_runs: 40, size_um: 3.0, size_spread: 0.1}]\n')
    words = 'plan', '--balls', 6, '--order', 'row', '--radius-mm', 182.5, '--environment', 'laboratory', '--json'
    plans = [json.loads(rosette(*words, *more).out)['expected'] for more in ((), ('--experience', known))]
    runs = [rosette_ros.evaluate(run, environment='laboratory', experience=one) for one in (None, known)]
    taught = {'runs': 40, 'effects': ['table_zero_drift']}
    assert [one['environment']['experience'] for one in plans] == [None, taught]
    assert [one.to_mapping()['environment']['experience'] for one in runs] == [None, taught]
    for before, after in ([max(one['u']['crz_rad']) for one in plans],
                          [one.result.curves.motions.u[:, 5].max() for one in runs]):
        assert after > 3 * before
    said = ' '.join(rosette('evaluate', run, '--environment', 'laboratory', '--experience', known).out.split())
    assert '; of angular drift of the table as in 40 earlier runs of the cell' in said
    assert '--experience: expected an environment beside it' in refused(
        'plan', '--balls', 6, '--order', 'row', '--experience', known)

# SPDX-License-Identifier: Apache-2.0
"""rosette advise: what an order shows, and what to measure next."""

import json
import re

import pytest
from simulated import HIDDEN, simulated_run, simulated_table

from rosette_ros.core.diagnosis.diagnosis import judge
from rosette_ros.io.plan_file import read_plan
from rosette_ros.simulation import Machine, MachineConfig


def test_a_plan_is_judged(rosette):
    """The diagonal order hides what the paper's order hides; another order shows it."""
    got = json.loads(rosette('advise', '--balls', 6, '--order', 'diagonal', '--json').out,
                     parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-advice/1'
    assert {'schema', 'run_id', 'n', 'radius_m', 'text', 'present', 'recommended', 'orders',
            'weak', 'wanted'} == set(got)
    now, then = (got[key]['effects'] for key in ('present', 'recommended'))
    assert {'table_zero_drift', 'table_backlash'} <= set(got['weak'])
    assert now['table_backlash']['hidden'] and now['table_backlash']['detectable_rms_m'] is None
    assert then['table_backlash']['typical_visible_fraction'] > 0.3
    assert then['table_backlash']['detectable_rms_m'] < 1e-6
    assert got['recommended']['worst_share'] > got['present']['worst_share'] + 0.1
    assert set(now['frame_drift']['bias_per_m_rms']) == {
        'ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad'}
    assert got['present']['duration_s'] > 36 * 20


def test_a_run_is_judged_by_its_own_readings(rosette):
    """Its order is recognised; effects that it cannot judge are said to be so."""
    run = simulated_table(n=6, order='column', temperature=(float('nan'),) * 36)
    got = json.loads(rosette('advise', run, '--json').out)
    assert got['present']['order'] == 'column'
    assert got['run_id'] == 'clean_1'
    judged = got['present']['effects']['frame_temperature']
    assert judged['not_judged'] == 'the run has no temperatures'
    assert 'frame_temperature' not in got['weak']
    assert 'not judged' in rosette('advise', run).out


def test_what_a_person_sees(rosette):
    """Advice, both orders side by side, all orders, the command that plans the next run."""
    answer = rosette('advise', '--balls', 6, '--order', 'row', '--radius-mm', 100)
    assert '6 balls on R = 100 mm, order row' in answer.out
    flat = ' '.join(answer.out.split())
    assert 'Order row cannot show ' in flat and ', linear probe drift' in flat
    assert re.search(r'Order [a-z_]+ shows \d+ more effects in ', flat)
    assert 'rosette plan --balls 6 --radius-mm 100 --order' in flat
    assert all(f'\n{order}' in answer.out for order in ('row ', 'diagonal ', 'column ', 'random '))
    assert max(len(line) for line in answer.out.splitlines() if 'rosette plan' not in line) <= 100


def test_an_effect_can_be_wanted(rosette):
    """Then the orders are compared by that one."""
    got = json.loads(rosette('advise', '--balls', 6, '--order', 'random', '--show',
                             'table_backlash', '--json').out)
    assert got['wanted'] == ['table_backlash']
    assert {order['worst_effect'] for order in got['orders']} == {'table_backlash'}
    assert got['recommended']['turning'] == 'alternate'


def test_the_next_readings(rosette, tmp_path):
    """What they separate is said; the plan has the readings of the run and then they, and is measured and judged as any
    run is: the same cells are measured again."""
    path, made = simulated_table('weak_warm_up', 6, 'sensitive', 3), tmp_path / 'next.csv'
    words = ('advise', path, '--readings', 6)
    out = ' '.join(rosette(*words, '--plan', made).out.split())
    assert 'Settling: no further effect or ' in out and '6 readings (' in out and (
        ') are expected to separate no further effect from ' in out)
    assert f'Written to {made}, after the 36 readings of the run.' in out
    got = json.loads(rosette(*words, '--json').out, parse_constant=pytest.fail)
    assert (got['schema'], got['readings_so_far'], got['is_settled']) == ('rosette-next-readings/1', 36, False)
    assert got['gain_nat'] > 0 and got['duration_s'] > 6 * 30
    assert got['separates']['expected_share'] > got['separates']['share'] > 0.5
    scheme, run = read_plan(made).scheme, simulated_run('weak_warm_up', 6, 'sensitive', 3)
    assert scheme.ball.tolist() == [*run.ball.tolist(), *got['readings']['ball']]
    assert scheme.table_position[36:].tolist() == got['readings']['table_position']
    longer = Machine(MachineConfig().changed(seed=3, plate={'balls': 6}, hidden=HIDDEN['weak_warm_up'])).run(scheme)
    assert longer.is_gapless and judge(longer).before.rms > 0


@pytest.mark.parametrize(('words', 'wanted'), [
    (('run.csv', '--readings', '6', '--until', '1.2'),
     "--until: expected a probability above 0.5 and below 1, found '1.2'"),
    (('run.csv', '--readings', '0'), '--readings: expected a whole number in 1 .. 1000'),
    (('run.csv', '--until', '0.9'), 'advise: --until goes with --readings only; leave it out'),
    (('--readings', '6', '--balls', '6', '--order', 'row'), 'advise: --readings: expected RUN, without --order and'),
    (('run.csv', '--readings', '6', '--plan', 'next.txt'), "--plan: expected a name that ends in .csv, found "
                                                           "'next.txt'"),
    ((), 'expected either RUN or both --balls and --order'),
    (('--balls', '6'), 'expected either RUN or both --balls and --order'),
    (('run.csv', '--balls', '6', '--order', 'row'), 'expected either RUN or both'),
    (('--balls', '6', '--order', 'circle'), "Unknown order 'circle'. Known: row"),
    (('--balls', '2', '--order', 'row'), 'number of balls: expected a whole number of at least 3'),
    (('--balls', '6', '--order', 'row', '--show', 'drift'), "Unknown effect 'drift'"),
    (('--balls', '6', '--order', 'row', '--show', 'ball_sag'),
     'ball_sag: expected an effect that the cell of this run can have, found one that no order shows: the run does '
     'not say '
     'how the table axis stands in the machine'),
    (('--balls', '6', '--order', 'row', '--show', 'free'), 'it is a form without a name'),
    (('--balls', '6', '--order', 'row', '--show', 'encoder_interpolation'),
     'expected effects that an order can show, found encoder_interpolation: what it depends on does not change in'),
    (('nowhere.csv',), 'nowhere.csv'),
])
def test_refused(refused, words, wanted):
    """In one line."""
    assert wanted in refused('advise', *words)

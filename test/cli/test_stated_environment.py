# SPDX-License-Identifier: Apache-2.0
"""--environment: U that contains what an order cannot show, in evaluate, budget, report; nothing is decided without."""

import datetime
import json

import numpy as np
import pytest

from rosette_ros.analysis import analyse, find
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import evaluation_row, heading
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.budget_file import read_budget
from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.simulation import Machine, MachineConfig

HIDDEN = [{'kind': 'frame_warmup', 'amplitude_um': [0.8, 0.5, -0.33], 'time_constant_h': 0.33, 'from_h': 0.3}]


@pytest.fixture(scope='module')
def table(tmp_path_factory):
    """Return a run in the order row of a machine that warms up, which this order does not show."""
    path = tmp_path_factory.mktemp('row') / 'row.csv'
    config = MachineConfig().changed(seed=7, plate={'balls': 6}, hidden=HIDDEN)
    write_csv(Machine(config).run(plan(6, 'row', 7)), path)
    return path


@pytest.fixture
def limits(tmp_path):
    """Return an identity with tolerances that the range of ctz is near."""
    path = tmp_path / 'id.yaml'
    path.write_text('schema: rosette-identity/1\ntolerances: {EZC: 4 µm}\n')
    return path


def evaluated(rosette, *words):
    """Return the evaluation as JSON."""
    return json.loads(rosette('evaluate', *words, '--json').out)


def test_without_an_environment_u_says_what_it_lacks_and_decides_nothing(rosette, table, limits):
    """The verdict does, in its first line, with U of a laboratory; a tolerance is not decided."""
    told = rosette('evaluate', table, '--identity', limits)
    first = ' '.join(told.out.split())
    assert 'The model fits: ' in first and ', does not contain what this order cannot show; in a ' in first
    assert ' in a laboratory environment it is ' in first
    assert ('Neither conformity nor non-conformity is stated: no environment is stated, and U lacks what this order '
            'cannot show') in first
    found = evaluated(rosette, table, '--identity', limits)
    assert found['environment'] is None
    assert found['iso_230_7']['errors'][2]['conformity'] == 'not decidable'


def test_with_one_the_same_run_is_decided_by_its_u(rosette, table, limits):
    """U is larger, states the class, and names what may be there; conformity has its probability."""
    alone = evaluated(rosette, table)
    lab, shop = (evaluated(rosette, table, '--identity', limits, '--environment', name)
                 for name in ('laboratory', 'workshop'))
    assert lab['environment']['name'] == 'laboratory'
    assert lab['environment']['sizes']['machine']['value'] == pytest.approx(0.3e-6)
    assert 'ISO 230-3' in lab['environment']['sizes']['machine']['source']
    assert max(alone['U']['ctz_m']) < max(lab['U']['ctz_m']) < max(shop['U']['ctz_m'])
    shares = [one['share']['ctz_m'] for one in shop['environment']['hidden']]
    assert 0.5 < sum(shares) < 1 and shop['environment']['hidden'][0]['effect']
    line = shop['iso_230_7']['errors'][2]
    assert line['doubt'] == '' and line['k_range'] != 2
    assert (line['conformity'] == 'conforms') == (line['probability_of_conformity'] >= 0.97725)
    assert 'environment: workshop' in shop['verdict']
    assert ' is what this order cannot show, first of all ' in shop['verdict']
    assert 'se the interleaved order' in shop['action']


def test_the_table_of_what_may_be_there(rosette, table):
    """For people: shares, largest first, and the numbers of the class."""
    text = ' '.join(rosette('evaluate', table, '--environment', 'laboratory').out.split())
    assert 'What this order cannot show, in U (environment: laboratory)' in text
    assert 'laboratory: machine against table 0.3 µm, zero of the table angle 0.5 µrad' in text
    assert 'U of the range: half of the interval' in text and 'U: k = 2; residual' in text and 'largest U' in text
    assert 'conformity is stated from a probability of 97.7 % on (JCGM 106)' in text


def test_lines_of_the_budget(rosette, table):
    """Each hidden effect has a line, the largest first; squares add up; without one they are not considered."""
    found = json.loads(rosette('budget', table, '--environment', 'workshop', '--json').out)
    hidden = [one for one in found['contributions'] if one['name'].startswith('hidden: ')]
    assert len(hidden) > 5 and not any(one['is_bound'] for one in hidden)
    for curve in ('ctx_m', 'crz_rad'):
        assert found['u'][curve]**2 == pytest.approx(sum(one['u'][curve]**2 for one in found['contributions']))
    assert any('beyond what the environment states (workshop)' in words for words in found['not_considered'])
    assert 'Effects that this order of measurement hides.' in json.loads(
        rosette('budget', table, '--json').out)['not_considered']


def test_numbers_of_the_cell_are_read_from_a_file(rosette, table, tmp_path):
    """evaluate takes the whole budget then; the class of an option takes the place of that of the file."""
    path = tmp_path / 'b.yaml'
    path.write_text('schema: rosette-budget/1\nenvironment:\n  bearing: {um: 2, words: ISO 230-7 test}\n')
    found = evaluated(rosette, table, '--inputs', path)
    assert found['environment']['name'] == 'stated'
    assert {one['effect'] for one in found['environment']['hidden']} == {'asynchronous_motion', 'table_warmup'}
    assert evaluated(rosette, table, '--inputs', path, '--environment', 'laboratory')['environment']['name'] == (
        'laboratory')


def test_several_runs_as_one_have_it_too(rosette, refused, table, tmp_path):
    """One run as a joint one has the U of that run; what else a budget has is refused."""
    alone = evaluated(rosette, table, '--environment', 'workshop')
    found = evaluated(rosette, table, '--joint', '--environment', 'workshop')
    assert found['environment']['name'] == 'workshop'
    assert found['curves'][0]['U']['crz_rad'] == pytest.approx(alone['U']['crz_rad'], rel=0.02)
    assert 'U contains what this order cannot show (environment: workshop).' in found['verdict']
    assert 'does not contain what this order cannot show; ' in evaluated(rosette, table, '--joint')['verdict']
    path = tmp_path / 'b.yaml'
    path.write_text('schema: rosette-budget/1\nradius: {u_um: 1}\n')
    assert 'expected the section environment only with several runs as one, found radius; leave it out' in refused(
        'evaluate', table, '--joint', '--inputs', path)


def test_a_correction_and_its_verification_have_it(rosette, table, tmp_path):
    """U of the file and of the curves after it contain what the order row hides."""
    widths = []
    for place, words in enumerate(([], ['--environment', 'workshop'])):
        path = tmp_path / f'{place}.yaml'
        assert rosette('correct', table, '-o', path, *words).code == 0
        found = json.loads(rosette('verify', table, table, '--correction', path, '--json', *words).out)
        widths.append((float(np.max(read_correction(path)[0].forward.u[:, 5])), found['errors'][5]['U']))
    assert widths[1][0] > 2 * widths[0][0] and widths[1][1] > 2 * widths[0][1]


def test_orders_for_the_next_run_by_their_u(rosette):
    """Row is the worst one in a workshop; plan compares all orders where none is named, advise takes another one."""
    plans = json.loads(rosette('plan', '--balls', '5', '--radius-mm', '182.5', '--environment', 'workshop',
                               '--json').out)['plans']
    relative = {one['name']: one['relative_uncertainty'] for one in plans}
    assert relative['interleaved'] < 1.5 and relative['row'] == max(relative.values()) > 3
    assert plans[0]['environment']['name'] == 'workshop' and plans[0]['duration_s'] > 0
    text = ' '.join(rosette('plan', 'row', 'sensitive', '--balls', '5', '--radius-mm', '182.5', '--environment',
                            'workshop').out.split())
    assert 'Least U in the environment workshop: interleaved.' in text
    found = rosette('advise', '--balls', '5', '--order', 'row', '--environment', 'workshop').out
    assert 'U ct' in found and 'recommended' in found and 'U ct' not in rosette(
        'advise', '--balls', '5', '--order', 'row').out


def test_earlier_runs_of_a_cell_state_its_environment(rosette, refused, tmp_path):
    """Runs in sensitive show a drift of the angle in one of three, and that nothing else is there: the section that
    they make gives a run in row a U that holds, smaller than that of a class in which the cell was never seen."""
    archive, rows = RunArchive(tmp_path / 'archive', make=True), []
    drift = [{'kind': 'table_zero_drift', 'rate_urad_per_h': 12.0}]
    for seed in range(3):
        config = MachineConfig().changed(seed=seed, plate={'balls': 6}, **({'hidden': drift} if seed == 0 else {}))
        path, run = tmp_path / f'{seed}.csv', Machine(config).run(plan(6, 'sensitive', seed), run_id=f'r{seed}')
        write_csv(run, path)
        identity = parse_identity(b'schema: rosette-identity/1\ntable: {serial: RT-7}\n')
        rows.append({**heading(f'{seed}', str(path), '', Model(), datetime.datetime.now(datetime.UTC), run.run_id),
                     **evaluation_row(analyse(run), find(run), identity=identity)})
    archive.add(rows)
    file = tmp_path / 'cell.yaml'
    text = rosette('archive', 'environment', archive.folder, '--table', 'RT-7').out
    assert rosette('archive', 'environment', archive.folder, '--table', 'RT-7', '-o', file).code == 0
    assert file.read_text() == text
    stated = read_budget(file).environment
    assert 'found in 1 of 3 runs of table RT-7' in stated.effects['table_zero_drift'].source
    hours = float(np.ptp(run.time)) / 3600
    assert stated.effects['table_zero_drift'].value == pytest.approx(12e-6 * hours * 0.1825 / 3**0.5, rel=0.3)
    assert 'not found in 3 runs of table RT-7' in stated.sizes['plate'].source
    row = tmp_path / 'row.csv'
    write_csv(Machine(MachineConfig().changed(seed=9, plate={'balls': 6}, hidden=drift)).run(plan(6, 'row', 9)), row)
    cell, shop, alone = (evaluated(rosette, row, *words)['U'] for words in (
        ['--inputs', file], ['--environment', 'workshop'], []))
    assert max(cell['crz_rad']) > 3 * max(alone['crz_rad'])
    assert max(alone['ctz_m']) < max(cell['ctz_m']) < max(shop['ctz_m'])
    assert 'expected diagnosed runs of table RT-8 whose logs are still there, found none of 0 runs' in refused(
        'archive', 'environment', archive.folder, '--table', 'RT-8')


@pytest.mark.usefixtures('sketched')
def test_the_report_states_it(rosette, table, tmp_path):
    """Verdict, lines and curves are those of the environment."""
    page = tmp_path / 'r.html'
    assert rosette('report', table, '--environment', 'workshop', '-o', page).code == 0
    text = page.read_text()
    assert 'environment: workshop' in text and 'hidden: ' in text


def test_a_certificate_states_environment_and_class(rosette, table, tmp_path):
    """It decides nothing without one; with one it says which, with its numbers and their sources."""
    identity = tmp_path / 'id.yaml'
    identity.write_text("schema: rosette-identity/1\ncertificate: {number: '7'}\nlaboratory: {country: DE}\n"
                        'measured: {begin: 2026-11-27}\ntolerances: {EZC: 40 µm}\n')
    said = []
    for place, words in enumerate(([], ['--environment', 'laboratory'])):
        path = tmp_path / f'{place}.xml'
        assert rosette('certificate', table, '--identity', identity, '-o', path, *words).code == 0
        said.append(path.read_text())
    assert 'not stated: U lacks what the order of measurement cannot show' in said[0]
    assert 'no environment is stated, and U lacks what this order cannot show' in said[0]
    assert 'laboratory: machine against table 0.3 µm' in said[1] and 'no environment is stated' not in said[1]
    assert 'hidden: ' in said[1] and 'drift test' not in said[0]
    assert 'nor among those of the environment (laboratory)' in said[1]
    assert 'not stated: no environment is stated' in said[0] and 'conforms' in said[1]

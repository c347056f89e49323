# SPDX-License-Identifier: Apache-2.0
"""--environment: U that contains what an order cannot show, in evaluate, budget, report; nothing is decided without."""

import json

import pytest

from rosette_ros.core.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

HIDDEN = [{'kind': 'frame_warmup', 'amplitude_um': [0.8, 0.5, -0.33], 'time_constant_h': 0.33, 'from_h': 0.3}]


@pytest.fixture(scope='module')
def table(tmp_path_factory):
    """Return a run in the order row of a machine that warms up, which this order does not show."""
    path = tmp_path_factory.mktemp('row') / 'row.csv'
    config = MachineConfig().changed(seed=7, plate={'balls': 8}, hidden=HIDDEN)
    write_csv(Machine(config).run(plan(8, 'row', 7)), path)
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
    assert 'The model fits, with U of ' in first and 'without what this order cannot show; ' in first
    assert ' in a laboratory: the residual of' in first
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
    assert 'easure in the order interleaved' in shop['action']


def test_the_table_of_what_may_be_there(rosette, table):
    """For people: shares, largest first, and the numbers of the class."""
    text = ' '.join(rosette('evaluate', table, '--environment', 'laboratory').out.split())
    assert 'What this order cannot show, in U (environment: laboratory)' in text
    assert 'laboratory: machine against table 0.3 µm, zero of the table angle 0.5 µrad' in text
    assert 'U of the range' in text and 'of each point the largest' in text
    assert 'conformity is decided from 97.7 % of it on (JCGM 106)' in text


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


def test_several_runs_have_none(refused, table):
    """Their U is that of their scatter."""
    assert '--environment goes with one RUN only' in refused('evaluate', table, table, '--joint', '--environment',
                                                             'workshop')


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
    assert 'neither proven' in said[0] and 'conforms' in said[1]

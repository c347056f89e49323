# SPDX-License-Identifier: Apache-2.0
"""rosette evaluate --joint: several runs as one, declared or as they say."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated_run, simulated_table

from rosette_ros.core.joint.joint_evaluation import SharingTest
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.presentation.joint_results import sharing_table

SHARED = 'schema: rosette-sharing/1\n'


@pytest.fixture
def back():
    """Return the table of a run there and back."""
    return simulated_table(order='there_and_back')


def test_there_and_back_as_json(rosette, back):
    """Curves of both senses, the reversal with its means, rank, and what is known."""
    answer = rosette('evaluate', back, '--joint', '--json')
    got = json.loads(answer.out, parse_constant=pytest.fail)
    assert got['schema'] == 'rosette-joint-evaluation/1'
    assert got['level'] == 'good' and got['verdict'].startswith('The run fits one model: residual ')
    assert 'crz' in got['verdict'] and 'in a laboratory environment' in got['verdict']
    assert [got[key] for key in ('unknowns', 'rank', 'hidden', 'hidden_in_curves')] == [102, 89, 13, 10]
    assert [one['sense'] for one in got['curves']] == [1, -1]
    assert len(got['curves'][0]['ctx_m']) == 6
    (reversal,) = got['reversal']
    assert abs(reversal['mean']['crz_rad']) < 4 * reversal['u_mean']['crz_rad']
    assert 'the reversal of all six curves, with its means' in got['known']
    assert [test['item'] for test in got['tests']] == ['sense']
    assert got['plate_ball'] == list(range(1, 7))
    assert {len(got[key]) for key in ('plate_m', 'plate_u_m', 'plate_name')} == {6}
    assert {len(got[key]) for key in ('cmm_m', 'cmm_u_m', 'cmm_name', 'cmm_azimuth_rad')} == {4}


def test_there_and_back_in_words(rosette, back):
    """What became known, what did not, the rank."""
    out = ' '.join(rosette('evaluate', back, '--joint').out.split())
    assert 'Reversal: counter-clockwise less clockwise' in out
    assert 'The sign is that of ISO 230-2: counter-clockwise (the positive sense) less clockwise. Means: ctx' in out
    assert 'Asynchronous error motion value' not in out  # of one run
    assert '102 unknowns, rank 89' in out
    assert 'The run fits one model: residual ' in out and ' in a laboratory environment ' in out
    assert 'State the environment of the cell (--environment).' in out
    assert 'beyond what one run knows: the reversal of all six curves, with its means' in out


def test_what_cannot_be_tested_is_told(rosette, back):
    """Without F and degrees of freedom; and which deviations one run did not measure."""
    made = [SharingTest('plate', 0.0, 0, None, True)]
    table = sharing_table(SimpleNamespace(tests=made, declared=frozenset()))
    assert [row[2:] for row in table.rows] == [(*3 * ('–',), 'used; cannot be tested by these readings')]
    out = ' '.join(rosette('evaluate', back).out.split())
    assert 'deviations of the CMM at positions 4, 6: not measured' in out


def test_two_runs_and_a_log(rosette, tmp_path):
    """A log gives its frame and its sense of turning as the table does; what is shared is told with p."""
    paths = [simulated_table(), simulated_table(order='diagonal')]
    got = json.loads(rosette('evaluate', *paths, '--joint', '--json').out)
    assert [one['shares']['frame'] for one in got['runs']] == ['1', '2']
    assert {test['item']: test['used'] for test in got['tests']} == dict.fromkeys(
        ('table', 'plate', 'clamping', 'cmm'), True)
    assert all(0 < test['p'] <= 1 for test in got['tests'])
    rosette('import', paths[0], '--output', tmp_path / 'log')
    assert rosette('evaluate', tmp_path / 'log', paths[1], '--joint').code == 0


def test_four_axis_errors_of_both_senses(rosette, back):
    """Their reversal is known and contained; one sense alone says that it is not. JSON has the same, SI."""
    joint, alone = (' '.join(rosette('evaluate', back, '--test-spheres', '200', '300', *more).out.split())
                    for more in (['--joint'], []))
    assert 'Four-axis errors of the table (ISO 10360-3), calculated from its error motions' in joint
    assert 'Other than in a test with spheres, errors of the CMM are not in them.' in joint
    assert 'errors of the CMM are not in them, nor the reversal of the table, which runs in both senses tell' in alone
    [one], [two] = (json.loads(rosette('evaluate', back, '--test-spheres', '200', '300', '--json', *more).out)[
        'iso_10360_3'] for more in ([], ['--joint']))
    for sphere, height in zip(one['spheres'], (0.3, 0.0), strict=True):
        assert (sphere['radius_m'], sphere['height_m']) == pytest.approx((0.2, height))
        assert 0 < sphere['U_FR_m'] < sphere['FR_m'] + 1e-6
    assert two['not_contained'] == '' and two['spheres'][0]['FT_m'] > 0


def test_csv_has_all_curves(rosette, back):
    """A row for each angle of each curve."""
    lines = rosette('evaluate', back, '--joint', '--csv').out.splitlines()
    head = dict(line[2:].split(': ', 1) for line in lines if line.startswith('# '))
    assert head['level'] and head['verdict'] and 'unknowns' in head['model']
    assert float(head['U_range_ctx_um of the table clockwise']) > 0
    rows = list(csv.DictReader(line for line in lines if not line.startswith('#')))
    assert [row['curves'] for row in rows] == [
        name for name in ('table counter-clockwise', 'table clockwise', 'reversal') for _ in range(6)]
    assert float(rows[0]['u_ctx_um']) > 0


def test_a_sharing_file_declares(rosette, tmp_path):
    """Frames that are the same; parts that are not named follow the runs."""
    share = tmp_path / 'share.yaml'
    share.write_text(SHARED + 'frame: shared\nplate: [first, second]\nplate_turned_deg: [0, 0]\n')
    got = json.loads(rosette('evaluate', simulated_table(), simulated_table(order='diagonal'), '--share', share,
                             '--json').out)
    assert [one['shares']['plate'] for one in got['runs']] == ['first', 'second']
    assert [(test['item'], test['declared']) for test in got['tests']] == [
        ('table', False), ('cmm', False), ('frame', True)]


def test_a_wrong_declaration_is_told(rosette, tmp_path):
    """It is used, in red, and what to do."""
    moved = tmp_path / 'moved.csv'
    run = simulated_run()
    write_csv(run.replace(centre=run.centre + np.outer(run.ball == 3, [0, 0, 2e-6])), moved)
    share = tmp_path / 'share.yaml'
    share.write_text(SHARED + 'plate: shared\n')
    out = ' '.join(rosette('evaluate', simulated_table(), moved, '--share', share).out.split())
    assert 'CONTRADICT it' in out


def about(folder, axis, order):
    """Return the table of a run of a table about an axis, None where none is stated."""
    path = folder / f'{order}_{axis}.csv'
    write_csv(simulated_run(order=order).replace(rotation=axis and axis_rotation(axis), run_id=order), path)
    return path


def test_two_runs_about_x_have_the_names_of_an_a_axis(rosette, tmp_path):
    """ISO 230-1: EXA is the axial motion of a table along x."""
    out = rosette('evaluate', *(about(tmp_path, [1, 0, 0], order) for order in ('random', 'diagonal')), '--joint').out
    assert all(f'({name})' in out for name in ('EYA', 'EZA', 'EXA', 'EBA', 'ECA', 'EAA'))
    assert 'EXC' not in out


def test_runs_about_different_axes_are_refused(refused, tmp_path):
    """One set of curves has one axis; what states none is taken as upright."""
    along_x = about(tmp_path, [1, 0, 0], 'random')
    assert ('expected runs of a table about one axis, found (1, 0, 0) in random and (0, 1, 0) in diagonal; evaluate '
            'them '
            'apart') in refused('evaluate', along_x, about(tmp_path, [0, 1, 0], 'diagonal'), '--joint')
    assert 'found (1, 0, 0) in random and (0, 0, 1), as none is stated, in column; evaluate them apart' in refused(
        'report', along_x, about(tmp_path, None, 'column'), '--joint')


@pytest.mark.parametrize(('text', 'words'), [
    ('table: shared\n', 'expected a mapping with "schema: rosette-sharing/1"'),
    (SHARED + 'tabel: shared\n', "found 'tabel'; did you mean 'table'"),
    (SHARED + 'table: [a]\n', r'table: expected shared, separate, or a name for each of 2 runs such as [1, 2]'),
    (SHARED + 'seat: cone\n', "seat: expected one of free, plane, pilot, both, found 'cone'"),
    (SHARED + 'seat: [1]\n', 'seat: expected one of free, plane, pilot, both, found [1]'),
    (SHARED + 'by_sense: 1\n', 'by_sense: expected true or false, found 1'),
    (SHARED + 'plate_turned_deg: [0, .nan]\n', 'plate_turned_deg: expected an angle in degrees for each of 2 runs'),
    (SHARED + 'plate_turned_deg: [0, 10]\n', 'turned by 10 deg: expected whole pitches of 60 deg')])
def test_sharing_files_that_mean_nothing_are_refused(refused, tmp_path, text, words):
    """In one line with the key."""
    share = tmp_path / 'share.yaml'
    share.write_text(text)
    assert words in refused('evaluate', simulated_table(), simulated_table(order='diagonal'), '--share', share)


def test_options_that_do_not_go_together_are_refused(refused, back):
    """Several runs without --joint; a model or a run_id with it."""
    assert 'expected one RUN, found 2; --joint evaluates several as one' in refused('evaluate', back, back)
    assert 'expected no --model' in refused('evaluate', back, '--joint', '--model', 'model.yaml')
    assert 'found --run-id' in refused('evaluate', back, back, '--joint', '--run-id', 'x')

# SPDX-License-Identifier: Apache-2.0
"""`rosette evaluate --refit-spheres`: what the touches of a run show, as text and as JSON."""

import json
import re

import pytest
from simulated import simulated_table
from touched_log import write_touched_log

from rosette_ros.simulation import MachineConfig

CELL = MachineConfig().changed(plate={'balls': 6})
LOBES = {'kind': 'ball_lobes', 'ball': 3, 'height_um': 0.6, 'order': 2}
LOBING = {'kind': 'probe_lobing', 'height_um': 0.4, 'order': 2}


@pytest.fixture(scope='module')
def lobed(tmp_path_factory):
    """Return the log of a cell with a lobed ball and a lobed probe."""
    folder = tmp_path_factory.mktemp('touches') / 'lobed'
    write_touched_log(folder, CELL.changed(hidden=[LOBES, LOBING]))
    return folder


@pytest.fixture(scope='module')
def clean(tmp_path_factory):
    """Return the log of a cell that hides nothing; of its third answer the centre is not that of its touches."""
    folder = tmp_path_factory.mktemp('touches') / 'clean'

    def displace(answer, touches):
        answer.centre.x += 3e-6 * (answer.seq == 3)
        return touches

    write_touched_log(folder, CELL, change=displace)
    return folder


def test_forms_of_ball_and_probe_are_named(rosette, lobed):
    """The ball with its size, the probe with its direction; the centres are those that were sent."""
    answer = rosette('evaluate', lobed, '--refit-spheres')
    assert answer.code == 0
    text = ' '.join(answer.out.split())
    assert 'Spheres 36 ball centres from 720 touches' in text
    assert 'Centres those that were sent, to 0.001 nm' in text
    assert re.search(r'0\.3\d\d µm rms over the directions of the probe, largest \+0\.4\d\d µm at azimuth (0|180)°',
                     text)
    assert 'rms over the surface: ball 3 0.3' in text
    assert 'Spheres through the touches, by ball' in text


def test_noise_is_no_form(rosette, clean):
    """And a centre that does not belong to its touches is named, by place and size."""
    text = ' '.join(rosette('evaluate', clean, '--refit-spheres').out.split())
    assert text.count('none that stands out of the noise') == 2
    assert '1 of 36 more than 1 nm from those that were sent, at most 3.00 µm (table position' in text


def test_json_has_every_touch(rosette, lobed):
    """Residuals per touch, radius and centres per reading, and the curves as without the option."""
    found = json.loads(rosette('evaluate', lobed, '--refit-spheres', '--json').out)
    sent = json.loads(rosette('evaluate', lobed, '--json').out)
    spheres = found.pop('spheres')
    assert found.keys() == sent.keys()
    assert found['ctx_m'] == pytest.approx(sent['ctx_m'], abs=1e-14)
    assert (spheres['fitted'], spheres['touches'], spheres['as_sent']) == (36, 720, {})
    assert spheres['moved_max_m'] < 1e-12
    assert all(len(one['residual_m']) == 20 for one in spheres['readings'])
    assert [one['ball'] for one in spheres['balls'] if one['p'] < 1e-6] == [3]
    assert spheres['lobing']['p'] < 1e-6
    assert spheres['radius_m'] == pytest.approx(7.5e-3, abs=1e-6)


def test_a_table_has_no_touches(refused):
    """One line, with what to give instead."""
    assert refused('evaluate', simulated_table(), '--refit-spheres').endswith(
        '.csv: expected touches to fit the spheres again, found none: a table holds ball centres only; give the log of '
        'the run\n')


def test_a_table_with_a_plate_file_has_no_touches(refused, tmp_path):
    """It is one run, and not several; what is wrong is that it is a table."""
    table = tmp_path / 'run.csv'
    table.write_text('# schema: rosette-ball-centres/1\n# plate: plate.yaml\n')
    assert refused('evaluate', table, '--refit-spheres') == (
        'rosette: --refit-spheres: expected the log of a run, which has its touches, found the table '
        f'{table} with ball centres only; leave the option out\n')


def test_several_runs_are_not_refitted(refused, lobed, clean):
    """One run at a time."""
    assert refused('evaluate', lobed, clean, '--joint', '--refit-spheres') == (
        'rosette: --refit-spheres: expected one run, found several as one; leave --joint out\n')

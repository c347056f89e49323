# SPDX-License-Identifier: Apache-2.0
"""Plates of any pitch: the plate file, the table of ball centres beside it, and what they determine."""

import json
import os

import numpy as np
import pytest
import yaml

from rosette_ros.cli.main import main
from rosette_ros.core.joint.joint_evaluation import evaluate_jointly
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.io.ball_centre_table import read_csv
from rosette_ros.io.open_run import has_plate, open_readings
from rosette_ros.io.plate_file import read_plate
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.joint_words import part_words

SCHEMA = 'schema: rosette-plate/1\n'
HEAD = 'seq,table_position,ball,table_angle_deg,x_mm,y_mm,z_mm,time_s'
FINE = {'fine_orders': (11, 13, 17), 'fine_share': 0.5, 'translation_um': 0.3, 'rotation_urad': 2.0}
"""A table whose errors have harmonics that 12 positions cannot tell from lower ones."""
MOVED = (0, 30, 60, 90, 130, *range(150, 360, 30))


def simulated(folder, azimuths, seed=1, silent=False, name='run.csv', positions=36, **heading):
    """Measure balls at some azimuths at 36 table positions; return the machine, its frame and the table."""
    quiet = {'probing': {'repeatability_um': 0.0}} if silent else {}
    machine = Machine(MachineConfig().changed(seed=seed, plate={'balls': 36}, table=FINE, **quiet))
    frame = machine.align().frame
    steps = 36 // positions
    position = np.repeat(np.arange(0, 36, steps), len(azimuths))
    ball = np.tile(np.array(azimuths) // 10, positions)
    aim = frame.to_outer(np.stack([0.1825 * np.cos(2 * np.pi * (position + ball) / 36),
                                   0.1825 * np.sin(2 * np.pi * (position + ball) / 36), 0 * ball], axis=-1))
    read = machine.measure_many(position + 1, ball + 1, np.ones(ball.size), aim)
    lines = ['# schema: rosette-ball-centres/1', *(f'# {key}: {value}' for key, value in {
        'plate': 'plate.yaml', 'table_positions': positions, 'repeatability_um': 0.1, **heading}.items()), HEAD]
    number = np.tile(np.arange(1, len(azimuths) + 1), positions)
    for row, (x, y, z) in enumerate(1e3 * frame.to_inner(read.centre)):
        lines.append(f'{row + 1},{position[row] // steps + 1},{number[row]},{10 * position[row]},{x:.9f},{y:.9f},'
                     f'{z:.9f},{40 * row}')
    (folder / 'plate.yaml').write_text(f'{SCHEMA}azimuth_deg: {list(azimuths)}\nradius_mm: 182.5\n')
    path = folder / name
    path.write_text('\n'.join(lines) + '\n')
    return machine, frame, path


def errors(machine, frame, path):
    """Return the JointResult of a table, and its curves less the truth at the table angles used."""
    result = evaluate_jointly([open_readings(path)])
    ((one, motions),) = result.curves
    return result, motions.values - remove_gauge(machine.table_truth(one.angle, frame), one.angle), motions


@pytest.mark.parametrize(('azimuths', 'u_ctx'), [(MOVED, 0.31), ((0, 10, 50, 120, 190, 290), 0.44)])
def test_irregular_plates_know_a_fine_table(tmp_path, azimuths, u_ctx):
    """Harmonics to 18 with 12 balls, one of them 10 degrees off, and with 6: the truth within its uncertainty."""
    result, error, motions = errors(*simulated(tmp_path, azimuths))
    assert 'harmonics up to 18, at 36 table angles' in part_words(result.knowledge.known)
    assert result.solution.hidden_in_curves == 10
    assert np.mean(motions.u[:, 0]) / result.sigma == pytest.approx(u_ctx, abs=0.03)
    assert 0.7 < np.sqrt(np.mean((error / motions.u)**2)) < 1.3


def test_an_ordinary_run_takes_fine_harmonics_for_others(tmp_path):
    """Without noise: at 12 positions of 12 balls harmonics 11, 13 and 17 stand in lower ones; at 36 all are right."""
    _, error, _ = errors(*simulated(tmp_path, MOVED, silent=True))
    assert np.abs(error[:, :3]).max() < 5e-9
    machine, _, coarse = simulated(tmp_path, tuple(range(0, 360, 30)), silent=True, positions=12)
    ((one, motions),) = evaluate_jointly([open_readings(coarse)]).curves
    orders = machine.table.residual.orders
    keep = orders <= 6
    low = np.exp(1j * one.angle[:, None] * orders[keep])
    smooth = remove_gauge(low.real @ machine.table.residual.cosine[keep] + low.imag @ machine.table.residual.sine[keep])
    assert np.abs(motions.values - smooth)[:, :3].max() > 1e-7
    assert np.abs(error[:, :3]).max() < 0.05 * np.abs(motions.values - smooth)[:, :3].max()


def test_an_equal_pitch_says_which_harmonics_it_lacks(tmp_path):
    """36 positions of 12 equally spaced balls: three groups of positions that nothing joins."""
    result, _, _ = errors(*simulated(tmp_path, tuple(range(0, 360, 30))))
    assert (result.solution.model.unknowns, result.solution.rank) == (360, 335)
    assert 'harmonics 12' in part_words(result.knowledge.hidden)
    assert 'harmonics up to 18 except 12, at 36 table angles' in part_words(result.knowledge.known)


def test_normalised_errors_of_irregular_plates(tmp_path):
    """Six balls, 20 machines: 0.8 to 1.2."""
    normalised = []
    for seed in range(20):
        _, error, motions = errors(*simulated(tmp_path, (0, 10, 50, 120, 190, 290), seed))
        normalised.append(error / motions.u)
    assert 0.8 < np.sqrt(np.mean(np.square(normalised))) < 1.2


@pytest.mark.parametrize('is_true', [True, False])
def test_a_calibrated_plate_gives_the_scale_if_the_readings_agree(tmp_path, is_true):
    """True coordinates are used; nominal ones of a plate that is 20 µm off are found out, and not used."""
    machine, _, path = simulated(tmp_path, MOVED)
    plate = {'azimuth_deg': list(MOVED), 'radius_mm': 182.5, 'height_mm': 0.0}
    if is_true:
        x, y, z = 1e3 * machine.plate.balls[np.array(MOVED) // 10].T
        plate = {'azimuth_deg': np.rad2deg(np.arctan2(y, x)).tolist(), 'radius_mm': np.hypot(x, y).tolist(),
                 'height_mm': z.tolist()}
    (tmp_path / 'plate.yaml').write_text(f'{SCHEMA}calibrated: true\n' + yaml.safe_dump(plate))
    result = evaluate_jointly([open_readings(path)])
    (test,) = result.tests
    assert (test.item, test.is_used, test.is_contradicted) == ('calibrated plate', is_true, not is_true)
    assert ('radial scale of plate and CMM' in part_words(result.knowledge.known)) == is_true
    assert result.lack_of_fit_p > 1e-3


def calibrated(machine, path, turn=0.0):
    """Write the true balls of a simulated plate of twelve as its plate file, in axes that are turned, deg."""
    x, y, z = 1e3 * machine.plate.balls[::3].T
    azimuth = np.rad2deg(np.arctan2(y, x)) % 360 + turn
    (path.parent / 'plate.yaml').write_text(f'{SCHEMA}calibrated: true\n' + yaml.safe_dump({
        'azimuth_deg': azimuth.tolist(), 'radius_mm': np.hypot(x, y).tolist(), 'height_mm': z.tolist()}))


def test_the_deviations_of_a_calibrated_plate_tell_no_means(tmp_path):
    """Twelve balls of equal pitch, some 10 um off: 102 of 114 unknowns, as of the plate on the drawing."""
    machine, _, path = simulated(tmp_path, tuple(range(0, 360, 30)), positions=12)
    calibrated(machine, path)
    result = evaluate_jointly([open_readings(path)])
    solution = result.solution
    assert (solution.model.unknowns, solution.rank, solution.hidden_in_curves) == (114, 102, 10)
    assert part_words(result.knowledge.known) == ('radial scale of plate and CMM',)
    ((_, motions),) = result.curves
    assert np.abs(motions.values.mean(axis=0)).max() < 1e-12
    assert motions.u[:, 3:5].max() < 3e-7


def test_the_axes_of_a_calibration_may_be_turned(tmp_path):
    """By 0.3 deg, 1 mm at the balls: this is how the plate lies, no deviation of the CMM, and the fit stays good."""
    machine, _, path = simulated(tmp_path, tuple(range(0, 360, 30)), positions=12)
    found = []
    for turn in (0.0, -0.3):
        calibrated(machine, path, turn)
        found.append(evaluate_jointly([open_readings(path)]))
    straight, turned = found
    assert np.abs(turned.deviations('cmm')[1]).max() < 1e-6
    assert turned.rms == pytest.approx(straight.rms, rel=1e-3)
    assert np.abs(turned.curves[0][1].values - straight.curves[0][1].values)[:, :3].max() < 1e-9


def test_other_verbs_take_plates_whose_balls_are_on_steps_of_the_table(tmp_path):
    """As some balls of a plate of 36: the same curves; of another plate they say who takes it."""
    _, _, path = simulated(tmp_path, MOVED)
    assert has_plate(path)
    run = read_csv(path)
    assert (run.n, run.size, run.radius) == (36, 432, 0.1825)
    assert set(run.ball) == {angle // 10 + 1 for angle in MOVED}
    assert 'the balls have the numbers of their places of 36: 1, 4, 7, 10, 14, 16' in run.notes[0]
    ((_, motions),) = evaluate_jointly([open_readings(path)]).curves
    off = fit(run, Model()).error_motions.values - motions.values
    assert np.abs(off / motions.u).max() < 0.05  # the clamping is 0.2 mm and 0.3 mrad off nominal
    (tmp_path / 'plate.yaml').write_text((tmp_path / 'plate.yaml').read_text().replace('130', '130.5'))
    with pytest.raises(InvalidData, match=r'plate.yaml: ball 5: expected it within 1 mm of a multiple of 10 deg.*found '
                       r'130.5 deg, 182.5 mm, 0 mm; tables of ball centres take any plate \(rosette evaluate'):
        read_csv(path)


@pytest.mark.parametrize(('edit', 'words'), [
    (lambda text: text.replace('# table_positions: 36\n', ''), 'expected "# table_positions: ...".*found none'),
    (lambda text: text.replace('plate: plate', 'plate: other'), r'other.yaml: expected a plate file that can be read'),
    (lambda text: text.replace('# plate', '# balls: 11\n# plate'), 'balls: expected 12, as the plate file'),
    (lambda text: text.replace('plate: plate', 'plate: ../plate'), 'plate: expected the name of a file beside the '
                                                                   'table'),
    (lambda text: text.replace('plate: plate', 'plate: pipe'), 'plate: expected the name of a file beside the table'),
    (lambda text: text.replace('\n1,1,1,', '\n1,1,13,'), r'column ball: expected 1..12, found 13'),
    (lambda text: text.replace('\n1,1,1,', '\n1,1,2,').replace('\n2,1,2,', '\n2,1,1,'), 'expected a place within'),
    (lambda text: text.replace('\n2,1,2,', '\n2,1,1,'), 'expected each pair of table position and ball once')])
def test_tables_that_do_not_fit_their_plate_are_refused(tmp_path, edit, words):
    """With file, line and column."""
    _, _, path = simulated(tmp_path, MOVED)
    os.mkfifo(tmp_path / 'pipe.yaml')
    path.write_text(edit(path.read_text()))
    with pytest.raises(InvalidData, match=words):
        open_readings(path)


def test_a_number_for_all_balls_or_one_for_each(tmp_path):
    """Azimuths, radii and heights."""
    (tmp_path / 'a.yaml').write_text(
        f'{SCHEMA}calibrated: true\nazimuth_deg: [0, 100, 210.5]\nradius_mm: [100, 110, 120]\nheight_mm: 5\n')
    plate = read_plate(tmp_path / 'a.yaml')
    assert plate.is_calibrated
    assert plate.centres[1] == pytest.approx([0.11 * np.cos(np.deg2rad(100)), 0.11 * np.sin(np.deg2rad(100)), 0.005])


@pytest.mark.parametrize(('text', 'words'), [
    ('azimuth_deg: [0, 1, 2]\n', 'expected a mapping with "schema: rosette-plate/1"'),
    (SCHEMA + 'azimuth_deg: [0, 90]\nradius_mm: 100\n', 'azimuth_deg: expected a list of 3 to 720 angles'),
    (SCHEMA + 'azimuth_deg: [0, 90, x]\nradius_mm: 100\n', "azimuth_deg: ball 3: expected a finite number, found 'x'"),
    (SCHEMA + 'azimuth_deg: [0, 90, 180]\n', 'radius_mm: ball 1: expected a finite number, found None'),
    (SCHEMA + f'azimuth_deg: [0, 90, 180]\nradius_mm: 1{"0" * 400}\n', 'ball 1: expected a finite number, found 1000'),
    (SCHEMA + 'azimuth_deg: [0, 90, 180]\nradius_mm: [100, 90]\n', 'radius_mm: expected a number, or one for each '
                                                                   'of 3'),
    (SCHEMA + 'azimuth_deg: [0, 90, 180]\nradius_mm: -1\n', 'radius_mm: expected positive numbers, found -1'),
    (SCHEMA + 'azimuth_deg: [0, 90, 360]\nradius_mm: 100\n', 'found balls 1 and 3 at one'),
    (SCHEMA + 'calibrated: 1\n', 'calibrated: expected true or false, found 1'),
    (SCHEMA + 'azimut_deg: [0]\n', "found 'azimut_deg'; did you mean 'azimuth_deg'"),
    ('[1, 2]', 'expected a mapping')])
def test_plates_that_are_none_are_refused(tmp_path, text, words):
    """In one line with the key."""
    path = tmp_path / 'plate.yaml'
    path.write_text(text)
    with pytest.raises(InvalidData) as caught:
        read_plate(path)
    assert words in str(caught.value)


def test_evaluate_takes_such_a_table(tmp_path, capsys):
    """Without an option: the plate says it."""
    _, _, path = simulated(tmp_path, MOVED)
    assert main(['evaluate', str(path), '--json']) == 0
    got = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert [got[key] for key in ('unknowns', 'rank', 'hidden')] == [360, 347, 13]
    assert len(got['curves'][0]['ctx_m']) == 36

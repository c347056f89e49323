# SPDX-License-Identifier: Apache-2.0
"""Laws that the library lacks, put together of a motion and a course: each is found where it is written by hand."""

import numpy as np
import pytest
from synthetic import RADIUS, synthetic_run

from rosette_ros.core.diagnosis.diagnosis import find
from rosette_ros.core.effects.composed import COMPOSED, GOING, LAWS, MOVING
from rosette_ros.core.effects.library import EFFECTS

SIGMA = 1e-7


def hidden(run, name):
    """Return what a law does to each reading, (N, 3), m, written out from the pose of the machine."""
    along = run.phi + run.beta
    out, hours = np.zeros((run.size, 3)), (run.time - run.time[0]) / 3600
    match name:
        case 'axis_tilt_pulse':  # 3 urad about x for a quarter of the run: z = R theta_x sin(alpha)
            there = (np.arange(run.size) >= run.size // 4) & (np.arange(run.size) < run.size // 2)
            out[:, 2] = 3e-6 * RADIUS * np.sin(along) * there
        case 'table_zero_asynchronous':  # 2 urad at 0.37 cycles a turn
            turn = 2e-6 * np.sin(0.37 * run.table_travel + 0.4)
            out[:, 0], out[:, 1] = -RADIUS * turn * np.sin(along), RADIUS * turn * np.cos(along)
        case 'cmm_squareness_warmup':  # 15 urad: x goes with y
            out[:, 0] = 15e-6 * RADIUS * np.sin(along) * -np.expm1(-hours / 0.12)
        case 'plate_oval_step':  # 3 ppm longer along its own x, as much shorter along its own y
            x, y = RADIUS * np.cos(run.beta), -RADIUS * np.sin(run.beta)
            turned = np.stack([x * np.cos(run.phi) - y * np.sin(run.phi), x * np.sin(run.phi) + y * np.cos(run.phi)])
            out[:, :2] = (3e-6 * turned * (np.arange(run.size) >= run.size // 3)).T
        case 'plate_tilt_cycle':  # 4 urad about its x, five times in the run
            out[:, 2] = 4e-6 * RADIUS * np.sin(run.beta) * np.sin(2 * np.pi * 5 * np.arange(run.size) / run.size)
        case 'cmm_deformation_cycle':  # 0.8 um along z, 0.7 um along x, two waves around the positions
            cycle = np.sin(2 * np.pi * 5.3 * np.arange(run.size) / run.size)
            out[:, 2], out[:, 0] = 8e-7 * np.cos(2 * along - 0.4) * cycle, 7e-7 * np.sin(2 * along) * cycle
        case 'table_zero_play':  # 4 urad, used up within 150 degrees, in the middle at first
            centre, angle = run.table_travel[0], []
            for travel in run.table_travel:
                centre = min(max(centre, travel - np.radians(75)), travel + np.radians(75))
                angle.append(4e-6 * (travel - centre) / np.radians(150))
            out[:, 0], out[:, 1] = -RADIUS * np.sin(along) * angle, RADIUS * np.cos(along) * angle
        case 'plate_warp_warmup':  # 1 um in two waves around it
            out[:, 2] = 1e-6 * np.cos(2 * run.beta - 0.7) * -np.expm1(-hours / 0.12)
    return out


@pytest.mark.parametrize('name', [
    'axis_tilt_pulse', 'table_zero_asynchronous', 'cmm_squareness_warmup', 'plate_tilt_cycle', 'cmm_deformation_cycle',
    'table_zero_play',
    *(pytest.param(name, marks=pytest.mark.long) for name in ('plate_oval_step', 'plate_warp_warmup'))])
def test_a_composed_law_is_found(name):
    """Each stands 12 times and more above the noise, in an order that shows it."""
    order = 'interleaved' if name.endswith('play') else 'random'  # which turns the table one way only
    run, *_ = synthetic_run(7, order, seed=5, noise=SIGMA, repeatability=SIGMA)
    found = find(run.replace(centre=run.centre + hidden(run, name)))
    assert found.missing == (name,)


def test_a_period_of_seven_readings_has_any_shape():
    """A compressor fills quickly and empties slowly: so many readings show three harmonics."""
    run, *_ = synthetic_run(7, 'random', seed=5, noise=SIGMA, repeatability=SIGMA)
    phase = np.arange(run.size) / 7.1 % 1
    height = 1e-6 * np.where(phase < 0.15, phase / 0.15, (1 - phase) / 0.85)
    found = find(run.replace(centre=run.centre + height[:, None] * [0.0, 0.0, 1.0]))
    assert found.missing == ('frame_periodic',)
    assert found.terms[0].fixed['period'] == pytest.approx(7.1 * np.median(np.diff(run.time)), rel=0.01)


def test_one_scale_is_told_from_both():
    """The scale along y alone changes: the law says which."""
    run, *_ = synthetic_run(7, 'random', seed=6, noise=SIGMA, repeatability=SIGMA)
    off = np.zeros((run.size, 3))
    off[:, 1] = 5e-6 * RADIUS * np.sin(run.phi + run.beta) * run.time / run.time.max()
    found = find(run.replace(centre=run.centre + off))
    assert found.missing == ('cmm_scale_drift',)
    assert found.terms[0].fixed['scales'] == 'second'


def test_either_axis_of_the_cmm_may_turn():
    """Along y by the place along x is no turn of the table beside a squareness along x."""
    run, *_ = synthetic_run(7, 'random', seed=6, noise=SIGMA, repeatability=SIGMA)
    off = np.zeros((run.size, 3))
    off[:, 1] = 6e-6 * RADIUS * np.cos(run.phi + run.beta) * run.time / run.time.max()
    found = find(run.replace(centre=run.centre + off))
    assert found.missing == ('cmm_squareness_drift',)
    assert found.terms[0].fixed['axis'] == 'second'


def test_a_step_has_readings_before_and_after_it():
    """Three at least, however it is refined: fewer are wrong readings."""
    run, *_ = synthetic_run(7, 'random', seed=6)
    step, time = LAWS['plate_warp_step'], run.time - run.time[0]
    for setting in step.settings(run):
        for moment in (setting['t0'], *step.brackets(run, setting)['t0']):
            assert 3 <= np.count_nonzero(time < moment) <= run.size - 3


def test_every_motion_goes_with_every_course():
    """Each pair is a law, of the library or composed; what turns with the table is the table's alone."""
    kinds = {(type(one.motion), type(one.course)) for one in LAWS.values()}
    lacking = {(one.name, how.name) for one in MOVING for how in GOING
               if (type(one.motion), type(how.course(one.unit))) not in kinds}
    assert lacking == {  # the library has these with more: a turn, either driver, supports, radial and axial
        ('plate_slide', 'step'), ('plate_growth', 'drift'), ('plate_growth', 'temperature'), ('plate_tilt', 'step'),
        ('plate_tilt', 'warmup'), ('axis_tilt', 'asynchronous'),
        *((one.name, 'periodic') for one in MOVING[1:]),  # a period of any shape is looked for in the probe
        # of time and CMM position a free course describes all but cycles
        *(('cmm_deformation', how.name) for how in GOING if how.name not in ('cycle', 'periodic')),
        *((name, 'play') for name in ('frame', 'cmm_scale', 'cmm_squareness')),  # the table turns itself and the plate
        *((name, 'asynchronous') for name in ('frame', 'plate_tilt', 'plate_slide', 'plate_growth', 'plate_oval',
                                              'plate_warp', 'cmm_scale', 'cmm_squareness'))}
    assert not COMPOSED.keys() & EFFECTS.keys()

# SPDX-License-Identifier: Apache-2.0
"""How a table stands in the machine: the taught frame, the names of its curves, the axes of the CMM."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import synthetic_run

from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run import axes
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import rotation_matrix
from rosette_ros.core.run.records import ErrorMotions

CURVES = ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')
DIRECTIONS = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda one: np.linalg.norm(one) > 1e-3)


@given(DIRECTIONS, st.floats(-7, 7))
def test_a_taught_frame_is_a_frame_about_its_axis(axis, azimuth):
    """Right-handed, z along the axis, ball 1 turned by the azimuth about it."""
    frame = axes.taught_frame([1, 2, 3], axis, azimuth)
    r = frame.rotation
    assert r @ r.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(r) == pytest.approx(1)
    assert r[:, 2] == pytest.approx(np.asarray(axis) / np.linalg.norm(axis), abs=1e-12)
    assert np.exp(1j * axes.azimuth(r)) == pytest.approx(np.exp(1j * azimuth), abs=1e-9)
    start = axes.axis_rotation(axis)
    assert start @ rotation_matrix([0, 0, azimuth]) == pytest.approx(r, abs=1e-12)


@pytest.mark.parametrize(('axis', 'x', 'y'), [
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), ((0, 7, 0), (0, 0, 1), (1, 0, 0)),
    ((0, 0, -1), (1, 0, 0), (0, -1, 0)), ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    ((0.5, 0, 0.75**0.5), (0.75**0.5, 0, -0.5), (0, 1, 0))])
def test_azimuth_0_is_the_next_axis_of_the_machine(axis, x, y):
    """x, y, z, x: put across the axis where that is oblique; a vertical axis gives the machine's own axes exactly."""
    found = axes.axis_rotation(axis)
    assert found[:, 0] == pytest.approx(x)
    assert found[:, 1] == pytest.approx(y)
    assert np.array_equal(axes.axis_rotation((0, 0, 1)), np.eye(3))


NAMES = {
    (0, 0, 1): 'EXC EYC EZC EAC EBC ECC', (1, 0, 0): 'EYA EZA EXA EBA ECA EAA',
    (0, 1, 0): 'EZB EXB EYB ECB EAB EBB', (0, 0, -1): 'EXC -EYC -EZC EAC -EBC -ECC',
    (-1, 0, 0): 'EYA -EZA -EXA EBA -ECA -EAA', (0.5, 0, 0.866): 'EXC EYC EZC EAC EBC ECC',
    (0.05, 0, 1): 'EXC EYC EZC EAC EBC ECC', (1, 0.1, 0): 'EYA EZA EXA EBA ECA EAA'}


@pytest.mark.parametrize('axis', NAMES)
def test_iso_names_follow_the_axis(axis):
    """EXA is the axial motion of an A axis, EAA its positioning; the signs are those of the machine's axes."""
    rotation = axes.axis_rotation(axis)
    assert axes.iso_names(rotation) == dict(zip(CURVES, NAMES[axis].split()))
    letters = {'X': 0, 'Y': 1, 'Z': 2, 'A': 0, 'B': 1, 'C': 2}
    if axes.machine_axis(rotation) is None:
        return
    for curve, name in axes.iso_names(rotation).items():
        sign, letter = (-1 if name[0] == '-' else 1), name.lstrip('-')[1]
        along = rotation[:, 'xyz'.index(curve[-1])]
        assert sign * along[letters[letter]] > 0.98, f'{name} counts along {letter} of the machine'


def test_names_without_a_rotation_are_those_of_a_vertical_axis():
    """As for every run before there was one."""
    assert list(axes.iso_names(None).values()) == NAMES[0, 0, 1].split()
    motions = ErrorMotions(np.arange(3.0), np.zeros((3, 6)), np.ones((3, 6)), axes.axis_rotation([0, 1, 0]))
    assert motions.iso_names['ctz'] == 'EYB'


@pytest.mark.parametrize(('axis', 'words'), [
    ((0, 0, 0), r'expected 3 numbers that are not all 0, found \[0.0, 0.0, 0.0\]'), ((0, float('nan'), 1), 'nan'),
    ((1, 0), r'found \[1.0, 0.0\]'), ((float('inf'), 0, 0), 'inf')])
def test_what_is_no_direction_is_refused(axis, words):
    """A zero vector, NaN, infinity, two numbers."""
    with pytest.raises(InvalidData, match=words):
        axes.unit_axis(axis)


def test_a_rotation_of_axis_and_x():
    """x has to be perpendicular; small errors of rounding are taken out."""
    assert axes.rotation_of([0, 0, 2], [0, 1, 1e-5])[:, 0] == pytest.approx([0, 1, 0])
    assert np.array_equal(axes.rotation_of([1, 0, 0]), axes.axis_rotation([1, 0, 0]))
    with pytest.raises(InvalidData, match='expected x perpendicular to the axis, found 45.00 deg between them'):
        axes.rotation_of([0, 0, 1], [0, 1, 1])


def test_a_run_with_what_is_no_rotation_is_refused():
    """Neither a mirror nor a skew matrix."""
    run = synthetic_run(4)[0]
    for wrong in (np.diag([1.0, 1.0, -1.0]), np.eye(3) + 0.1, np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(InvalidData, match='run: rotation: expected a rotation matrix of the table frame'):
            run.replace(rotation=wrong)


@pytest.mark.parametrize('azimuth_deg', [10.0, 30.0, 45.0])
@pytest.mark.parametrize('axis', [(0, 0, 1), (1, 0, 0), (0, 0, -1), (0.5, 0, 0.866)])
def test_reversal_is_along_the_axes_of_the_cmm(axis, azimuth_deg):
    """Half the reversal error by the sense of each machine axis that goes to and fro, whatever way the table stands."""
    rotation = axes.taught_frame([0, 0, 0], axis, np.deg2rad(azimuth_deg)).rotation
    run = synthetic_run(12, 'sensitive', rotation=rotation)[0]
    place = run.radius * np.stack([np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=-1) @ rotation.T
    sense = np.zeros((run.size, 3))
    for row in range(1, run.size):
        move = place[row] - place[row - 1]
        sense[row] = np.where(np.abs(move) > 1e-4, np.sign(move), sense[row - 1])
    free = np.argmax(np.abs(rotation[:, 2]))
    moving = [one for one in range(3) if one != free]
    sense[:, free] = 0
    assert np.array_equal(run.cmm_sense, sense)
    first = Setting(first='unknown')
    columns = EFFECTS['cmm_reversal'].columns(run, first)
    assert columns @ [2.0, 3.0] == pytest.approx(sense[:, moving] * [1.0, 1.5] @ rotation[moving], abs=1e-12)
    names = [one.name for one in EFFECTS['cmm_reversal'].amplitudes(run, first)]
    assert names == [f'r_{"xyz"[one]}' for one in moving]


def test_small_misalignments_change_nothing():
    """Table and machine that are parallel to within 2 mrad are taken as parallel: moves that are nil are nil."""
    run = synthetic_run(12, 'sensitive')[0]
    off = run.replace(rotation=rotation_matrix([2e-4, -3e-4, 1e-3]))
    assert np.array_equal(off.cmm_sense, run.cmm_sense)
    for name in ('cmm_reversal', 'cmm_scale_drift', 'cmm_squareness_drift', 'frame_drift'):
        setting = EFFECTS[name].settings(run)[0]
        assert np.array_equal(EFFECTS[name].columns(off, setting), EFFECTS[name].columns(run, setting))
    turned = run.replace(rotation=axes.taught_frame([0, 0, 0], [0, 0, 1], np.pi / 6 + 1e-3).rotation)
    exact = run.replace(rotation=axes.taught_frame([0, 0, 0], [0, 0, 1], np.pi / 6).rotation)
    assert np.array_equal(turned.cmm_sense, exact.cmm_sense)


def test_drift_of_the_frame_is_along_the_machine():
    """A drift along z of the machine moves a table along x across its axis."""
    run = synthetic_run(6, rotation=axes.axis_rotation([1, 0, 0]))[0]
    columns = EFFECTS['frame_drift'].columns(run, Setting(axes='z'))[..., 0]
    assert columns == pytest.approx((run.time - run.time[0])[:, None] * [0, 1, 0])


def test_the_curves_do_not_depend_on_how_the_table_stands():
    """Everything inside is in the table frame; only the names follow."""
    run = synthetic_run(6)[0]
    upright, lying = fit(run), fit(run.replace(rotation=axes.axis_rotation([1, 0, 0])))
    assert np.array_equal(upright.error_motions.values, lying.error_motions.values)
    assert lying.error_motions.iso_names['crz'] == 'EAA'

# SPDX-License-Identifier: Apache-2.0
"""The taught pose has an axis: where balls are asked for, from which side, and what a wrong axis is told."""

import math

import numpy as np
import pytest
import yaml
from sequences import answer_to, last_ask, moved, nominal

from rosette_ros.calibration.settings import LIMITS, PLANNED, format_settings, limits_of, parse_settings, plan_of
from rosette_ros.calibration.state_machine import Ask, Finish, Limits, Locate, Sequence
from rosette_ros.core.run.axes import refuse_other_sense, taught_frame
from rosette_ros.core.run.errors import InvalidConfig, NotDeterminable
from rosette_ros.core.run.geometry import Frame, rotation_matrix, table_frame
from rosette_ros.io.messages import MACHINE_FRAME, Phase
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.simulation import Machine, MachineConfig

DEFAULTS = {wanted.name: wanted.default for wanted in PLANNED + LIMITS}
AXIS = next(wanted for wanted in PLANNED if wanted.name == 'table.axis')
ORIGIN = (0.1, 0.2, 0.3)


def values(axis, azimuth=0.0, balls=4):
    """Return settings with a taught axis."""
    return {**DEFAULTS, 'plate.balls': balls, 'table.axis': axis, 'table.azimuth_deg': azimuth,
            'table.origin_m': ORIGIN, 'repeats': 2}


def answered(sequence, true, frame_id='machine', each=lambda answer: answer):
    """Answer all targets as a perfect CMM whose table is at the Frame `true`; return all commands in order."""
    commands = list(sequence.begin(0.0))
    ask = last_ask(commands)
    while ask:
        centre = nominal(ask) if frame_id == 'table' else true.to_outer(nominal(ask))
        step = sequence.answer(each(answer_to(ask, frame_id, centre=tuple(centre.tolist()))), 0.0)
        commands += step
        ask = last_ask(step)
    return commands


@pytest.mark.parametrize('given', [[0, 0, 0], [0, math.nan, 1], [1, 0], 'x', [1, 0, math.inf], 1.0])
def test_what_is_no_axis_is_refused_in_one_line(given):
    """Zero vector, NaN, not three numbers."""
    with pytest.raises(InvalidConfig) as caught:
        AXIS.check(given, 'node sequencer: parameter')
    words = str(caught.value)
    assert words.startswith('node sequencer: parameter: table.axis: expected a list of 3 numbers in -1e+06 .. 1e+06, '
                            'not '
                            'all 0 (direction of the table axis in machine coordinates, about which table and balls')
    assert words.endswith(f'found {given!r}')


def test_the_axis_travels_with_the_settings():
    """As every setting that decides the targets; logs from before there was one have a vertical axis."""
    text = format_settings(values((1.0, 0.0, 0.0), 30.0))
    assert parse_settings(text, 'log')['table.axis'] == (1.0, 0.0, 0.0)
    older = {name: value for name, value in yaml.safe_load(text).items() if name != 'table.axis'}
    assert parse_settings(yaml.safe_dump(older), 'log')['table.axis'] == (0.0, 0.0, 1.0)


@pytest.mark.parametrize('axis', [(1, 0, 0), (0, -1, 0), (0, 0, -1), (0.5, 0, 0.866), (0, 0, 1)])
def test_balls_are_asked_for_about_the_taught_axis(axis):
    """Centres and pole follow the taught pose; the alignment finds the true one; the pole stays as taught."""
    plan = plan_of(values(axis, 20.0))
    taught = taught_frame(ORIGIN, axis, np.deg2rad(20.0))
    true = Frame(taught.rotation @ rotation_matrix([2e-3, -1e-3, 3e-3]), taught.origin + 1e-4)
    sequence = Sequence('run_a', plan, limits_of(DEFAULTS))
    commands = answered(sequence, true)
    asked = [one.target for one in commands if isinstance(one, Ask)]
    unit = np.array(axis) / np.linalg.norm(axis)
    for target in asked:
        frame = taught if target.phase < Phase.RUN else true
        assert target.centre == pytest.approx(frame.to_outer(nominal(target)), abs=1e-9)
        assert target.pole == pytest.approx(unit, abs=1e-12)
    found = next(one.frame for one in commands if isinstance(one, Locate))
    assert found.rotation == pytest.approx(true.rotation, abs=1e-12)
    if axis == (0, 0, 1):
        assert {target.pole for target in asked} == {(0.0, 0.0, 1.0)}


def test_a_cmm_that_knows_the_table_is_told_the_pole_in_its_frame():
    """z of the table; the rotation of the run is that of the taught pose."""
    sequence = Sequence('run_a', plan_of(values((1, 0, 0), 20.0)), limits_of(DEFAULTS))
    asked = [one.target for one in answered(sequence, None, 'table') if isinstance(one, Ask)]
    assert {one.pole for one in asked if one.phase == Phase.RUN} == {(0.0, 0.0, 1.0)}
    rotation = RunAssembly(sequence.answers).run().rotation
    assert rotation == pytest.approx(taught_frame(ORIGIN, (1, 0, 0), np.deg2rad(20.0)).rotation, abs=1e-12)


def test_the_run_knows_the_rotation_that_was_found():
    """That of the transform, not the taught one; without either there is none."""
    sequence = Sequence('run_a', plan_of(values((0, 1, 0))), limits_of(DEFAULTS))
    true = Frame(taught_frame(ORIGIN, (0, 1, 0), 0.0).rotation @ rotation_matrix([1e-3, 0, 0]), np.array(ORIGIN))
    answered(sequence, true)
    sequence.answers.frames.append(type('Found', (tuple,), {'stamp_ns': 0, 'frame': true})((0, true)))
    assert np.array_equal(RunAssembly(sequence.answers).rotation(), true.rotation)
    assert RunAssembly(RunAnswers('none')).rotation() is None


def test_a_table_that_turns_the_other_way_is_told():
    """Ball 1 is found at table angle 0, the next one is not: the axis points the wrong way."""
    plan = plan_of(values((0, 0, -1)))
    true = taught_frame(ORIGIN, (0, 0, 1), 0.0)
    sequence = Sequence('run_a', plan, Limits(attempts=1))
    end = answered(sequence, true)[-1]
    assert isinstance(end, Finish)
    assert end.text.startswith('target 4 (table position 2, ball 1): asked once, last: expected a ball within 20 mm')
    assert ('; ball 1 is where it was taught at table angle 0: check that the table counts counter-clockwise about '
            'table.axis, taught as (0, 0, -1)') in end.text
    assert '\n' not in end.text


def test_another_axis_than_taught_ends_the_run_in_one_line():
    """Where the search is so wide that the balls of another axis are found."""
    plan = plan_of({**values((1, 0, 1)), 'plate.radius_m': 0.03})
    sequence = Sequence('run_a', plan, Limits(search=0.1))
    end = answered(sequence, taught_frame(ORIGIN, (1, 0, 0), 0.0))[-1]
    assert end == Finish(Phase.FAILED, 'alignment: expected the table to turn counter-clockwise about the taught axis '
                         '(0.707, 0, 0.707), found (1, 0, 0) from the ball centres; correct table.axis')


def test_an_outlier_of_the_first_ball_does_not_blame_the_axis():
    """Before ball 1 is found, nothing is said of the axis."""
    sequence = Sequence('run_a', plan_of(values((0, 0, 1))), Limits(attempts=1))
    end = answered(sequence, taught_frame(ORIGIN, (0, 0, 1), 0.0), each=lambda answer: moved(answer, 1.0, 0, 0))[-1]
    assert 'axis' not in end.text
    assert sequence.answers.last_target(1).frame_id == MACHINE_FRAME


@pytest.mark.parametrize('n', [4, 5, 6, 12])
@pytest.mark.parametrize('correction', [True, False])
def test_a_table_whose_angle_counts_the_other_way(n, correction):
    """At every place there is a ball, but another one; a poor CMM or table does not look like that."""
    machine = Machine(MachineConfig().changed(plate={'balls': n}, cmm={'correction': correction}, table={
        'translation_um': 1.0, 'rotation_urad': 10.0, 'angular_correction': False, 'axial_correction': False}))
    every, ones = np.arange(n), np.ones(n, dtype=int)
    plane = machine.measure_many(ones, every + 1, ones).centre
    right = machine.measure_many(every + 1, ones, ones).centre
    wrong = machine.measure_many(-every % n + 1, 2 * every % n + 1, ones).centre
    refuse_other_sense(table_frame(right, plane), right, plane)
    refuse_other_sense(table_frame(right, plane), right[:-1], plane)  # not every position: nothing is said
    with pytest.raises(NotDeterminable, match=(
            r'expected ball 1 at one place of the plate as the table turns, found places \d+ um apart, and balls to '
            r'[\d.e+-]+ um for a table that turns the other way; correct the sense in which the angle of the table '
            r'counts \(I\+\+: table.sign\), or table.axis')):
        refuse_other_sense(table_frame(wrong, plane), wrong, plane)

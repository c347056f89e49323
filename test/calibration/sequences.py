# SPDX-License-Identifier: Apache-2.0
"""A sequence of three balls and a CMM without errors that answers it."""

import numpy as np

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.calibration.state_machine import Ask, Limits, Results, Sequence
from rosette_ros.core.run.geometry import Frame, rotation_matrix
from rosette_ros.core.run.scheme import nominal_places, plan
from rosette_ros.io.messages import Answer

RUN_ID = 'run_a'
TRUE = Frame(rotation_matrix(np.array([2e-4, -1e-4, 3e-4])), np.array([0.1003, 0.2, -0.0002]))
TAUGHT = Frame(np.eye(3), np.array([0.1, 0.2, 0.0]))
LIMITS = Limits(answer_timeout=2.0, attempts=3, skips=0, evaluation_timeout=5.0)


def make_sequence(n=3, order='diagonal', limits=LIMITS, repeats=2):
    return Sequence(RUN_ID, plan_calibration(plan(n, order), 0.1, TAUGHT, repeats), limits)


def nominal(target):
    return nominal_places(target.balls, target.radius, target.table_position, target.ball)


def answer_to(target, frame_id='machine', **changes):
    """Answer as a perfect CMM whose table truly is at TRUE."""
    centre = nominal(target) if frame_id.endswith('table') else TRUE.to_outer(nominal(target))
    right = Answer(
        RUN_ID, target.seq, target.table_position, target.ball, target.cmm_position, 0, '', target.table_angle,
        target.table_angle, 1, tuple(centre.tolist()), 0.0, 20.0, frame_id, 0)
    return right._replace(**changes)


def moved(answer, *by):
    """Return an answer whose centre lies elsewhere, by m."""
    return answer._replace(centre=tuple(np.add(answer.centre, by).tolist()))


def last_ask(commands):
    """Return the Target that is asked for, None where none is."""
    asks = [command.target for command in commands if isinstance(command, Ask)]
    assert len(asks) <= 1
    return asks[0] if asks else None


def results_of(sequence):
    """Return the Results of an evaluator that has the run."""
    return Results(99, sequence.answers.readings_hash, 'hash', True)


def run_through(sequence, frame_id='machine'):
    """Answer everything at once; return all commands in order."""
    commands = list(sequence.begin(0.0))
    ask = last_ask(commands)
    while ask:
        step = sequence.answer(answer_to(ask, frame_id), 0.0)
        commands += step
        ask = last_ask(step)
    return commands

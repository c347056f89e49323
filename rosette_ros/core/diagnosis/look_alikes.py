# SPDX-License-Identifier: Apache-2.0
"""Look-alikes of a claim: what would look nearly the same in this run, so that one of them is there."""

from collections.abc import Iterator, Sequence

import numpy as np

from rosette_ros.core.diagnosis.right_shape import IN_TIME, free_instead
from rosette_ros.core.diagnosis.scores import UNNAMED_PRIOR
from rosette_ros.core.diagnosis.search import Member, Problem, Selection
from rosette_ros.core.effects.courses import Curve, Cycle, Drift, Onset, WarmUp
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free_forms import TURNING
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.effects.run_functions import temperature_step
from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.model.least_squares import FittedEffect
from rosette_ros.core.records import Run

LOOK_ALIKE = 8.0
"""Difference of scores (twice the log Bayes factor) below which two effects cannot be distinguished."""
NEAR = 30.0
"""The same before all that is searched is found again beside the rival."""
HALF = 0.5
"""An axis that moves less than so much of the one that moves most, U (k = 2) included, is not told."""
UNSEEN = 0.01
"""What of a curve is seen less than so much of what is seen best is left out of its size."""
MOSTLY = 0.9
"""Share of the square sum that the temperature explains to be alike: no record tells it at the right place."""
CURVED_AS = {'radial': 'plate_expansion', 'tangential': 'table_zero_drift', 'plate xy': 'plate_creep'}
"""What moves along a curve in time in a turning direction; the frame does along its axes."""
SMOOTH = (Drift, Onset, Curve, WarmUp, Cycle)
"""Functions of time as temperatures can have them: without jumps."""


def look_alikes(problem: Problem, chosen: Selection, claims: Sequence[FittedEffect]) -> dict[int, tuple[str, ...]]:
    """Return the names of the look-alikes by the place of each named member; claims: these, fitted, in order."""
    out, fitted, least = {}, iter(claims), chosen.score - LOOK_ALIKE
    for place, member in enumerate(chosen.members):
        if member.named:
            rest = problem.select(chosen.without(place))
            found = [rival.name for rival, score, _ in problem.rivals(rest)
                     if rival.named and rival.name != member.name and rest.score + score > least - NEAR
                     and _is_alike(problem, chosen, rest, rival, least)]
            found += _alike_curves(problem, rest, member, least)
            if member.name == 'asynchronous_motion':  # travel is nearly time
                cycle = free_instead(problem, chosen, [place], ())
                if cycle and cycle.members[-1].name == 'free_cycle' and cycle.score + UNNAMED_PRIOR > least:
                    found.append('frame_cycle')
            found += _of_temperature(problem.run, next(fitted), claims)
            out[place] = tuple(dict.fromkeys(name for name in found if name != member.name))
    return out


def axis_open(problem: Problem, chosen: Selection, place: int) -> str:
    """Return x or y where a curve in time along the other one may go along it, too; '' where that is excluded.

    It is where, with curves along all axes, that one's size is below half of the largest along the axes told, twice its
    standard uncertainty included: the table turns x into y, and an ordered run tells a course along one from another
    course along the other hardly.
    """
    member = chosen.members[place]
    own = member.setting.word('axes')
    others = {*'xy'} - {*own}
    if member.name != 'free_time' or not {*own} <= {*'xyz'} or len(others) != 1:
        return ''
    rest, axis = problem.select(chosen.without(place)), others.pop()
    columns = np.moveaxis(member.effect.columns(problem.run, Setting({**member.setting, 'axes': 'xyz'})), -1, 0)
    seen = np.asarray(problem.project(columns), dtype=float).reshape(len(columns), -1)
    left, size, right = np.linalg.svd(seen - (seen @ rest.rows.T) @ rest.rows, full_matrices=False)
    keep = size > UNSEEN * size[0]
    courses = columns.reshape(3, -1, problem.run.size, 3)
    inverse = (left[:, keep] / size[keep]).reshape(*courses.shape[:2], -1)
    amplitude = inverse @ (right[keep] @ rest.residual)
    sizes, u = {}, {}
    for number, name in enumerate('xyz'):
        course = courses[number, :, :, number] - courses[number, :, :, number].mean(axis=1, keepdims=True)
        of_axis = inverse[number] @ inverse[number].T * chosen.rss / problem.dof
        sizes[name] = float(np.sqrt(np.mean((amplitude[number] @ course)**2)))
        u[name] = float(np.sqrt(np.mean(np.einsum('an,ab,bn->n', course, of_axis, course))))
    return axis if sizes[axis] + COVERAGE_FACTOR * u[axis] > HALF * max(sizes[name] for name in own) else ''


def _is_alike(problem: Problem, chosen: Selection, rest: Selection, rival: Member, least: float) -> bool:
    """Return whether a rival in place of a member fits as well, or, as the temperature, explains most of it.

    rest: what is chosen without that member; least: the score that is as good.
    """
    best = problem.polish(problem.select((*rest.members, rival)))
    return best.score > max(rest.score, least) or (
        'temperature' in rival.effect.depends_on and rest.rss - best.rss > MOSTLY * (rest.rss - chosen.rss))


def _alike_curves(problem: Problem, rest: Selection, member: Member, least: float) -> Iterator[str]:
    """Yield the effects that a curve in time stands for which fits as well as a claim of another direction, or angle.

    rest: what is chosen without it; least: the score that is as good. In an ordered run angles may be times.
    """
    if member.name == 'outlier':
        return
    own = [axes for _, axes in IN_TIME.get(member.name, ('', ()))[1]]
    is_of_frame = 'time' in member.effect.depends_on and member.name.startswith('frame_')
    for offer in problem.offers([rest], ('free_time',), allow_repeats=True)[0]:
        axes = offer.setting.word('axes')
        if rest.score + offer.score + UNNAMED_PRIOR > least and axes not in own:
            if axes in TURNING or not is_of_frame:
                yield CURVED_AS.get(axes, 'frame_drift_curved')


def _of_temperature(run: Run, claim: FittedEffect, claims: Sequence[FittedEffect]) -> Iterator[str]:
    """Yield what follows the temperature and can be a smooth course of the frame in time, one of all claims.

    That is any where no temperature is known to change; beside a coarse record, what is smaller than a step of it
    makes.
    """
    function = getattr(EFFECTS.get(claim.name), 'course', None)
    step = temperature_step(run)
    if not step or not claim.name.startswith('frame_') or not isinstance(function, SMOOTH):
        return
    if step == np.inf:
        yield 'frame_temperature'
    size = np.abs(claim.displacement - claim.displacement.mean(axis=0)).max(axis=0)
    for other in claims if np.isfinite(step) else ():
        if 'temperature' in other.name:
            rate = np.sqrt(sum(one.value**2 for one in other.parameters if one.name.startswith('d_')))
            if np.linalg.norm(size) < rate * step:
                yield other.name

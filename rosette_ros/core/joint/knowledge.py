# SPDX-License-Identifier: Apache-2.0
"""What a joint evaluation determines, and what it does not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from rosette_ros.core.joint.joint_model import TableSet, tilts
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.run.geometry import SAME_ANGLE, Floats, Ints, wrap
from rosette_ros.core.run.remarks import Remark, remark

SEEN = 1e-6
"""Part of a hidden direction below which a quantity is not touched by it."""


class Part(StrEnum):
    """What several runs may determine; words/joint_words.py says it."""

    RADIAL = 'mean of ctx and cty'
    AXIAL = 'mean of ctz'
    TILT = 'mean of crx and cry'
    ANGULAR = 'mean of crz'
    ECCENTRICITY = 'once-per-turn part of (ctx, cty)'
    WOBBLE = 'once-per-turn part of (crx, cry)'
    HARMONICS = 'harmonics'
    HARMONICS_UP_TO = 'harmonics up to the highest'
    REVERSAL = 'the reversal of all six curves'
    SCALE = 'radial scale of plate and CMM'
    HEIGHT = 'height and turn about z between plate and CMM'


class JointRemark(StrEnum):
    """What is said of runs that are evaluated as one; words/joint_words.py says it."""

    FRAMES_APART = 'each run has its own table frame'
    ONE_SENSE = 'too little of one sense of turning'
    TURNED = 'the plate was turned between runs'
    NO_REVERSAL = 'angles without a reversal'
    NOT_IN_U = 'what the order of a run hides is not in U'
    EFFECTS = 'effects of a run are in its model'
    NOISE = 'the noise of a run is not white and equal'


_PARTS = ((Part.RADIAL, 'radial', 0), (Part.AXIAL, 'axial', 0), (Part.TILT, 'tilt', 0), (Part.ANGULAR, 'angular', 0),
          (Part.ECCENTRICITY, 'radial', 1), (Part.WOBBLE, 'tilt', 1))
MEANS = tuple(name for name, _, order in _PARTS if order == 0)
REVERSAL = 'reversal'
"""In place of a table, for what is not known of its reversal."""


@dataclass(frozen=True)
class Knowledge:
    """known, beyond what one run of a regular plate knows; hidden, what stays unknown: kinds of Part, `of` a table, ''
    where it holds for all."""

    known: tuple[Remark, ...]
    hidden: tuple[Remark, ...]


def knowledge(solution: JointSolution) -> Knowledge:
    """Return what a solution determines; harmonics are those of the table error at the angles of a set."""
    known, hidden = list[Remark](), list[Remark]()
    sets, balls = solution.model.sets, max(run.plate.balls for run in solution.model.runs)
    found = [_of_curves(solution.hidden[one.place], one.angle) for one in sets]
    are_alike = all(one == found[0] for one in found)
    for one, (parts, waves) in zip(sets, found):
        of = '' if are_alike else one.words
        hidden += [remark(name, of=of) for name in parts]
        known += [remark(name, of=of) for name, *_ in _PARTS if name not in parts]
        hidden += [remark(Part.HARMONICS, of=of, waves=tuple(waves))] if waves else []
        half = one.angle.size // 2
        if one.angle.size > balls and not {*range(2, half + 1)} <= {*waves}:
            known.append(remark(Part.HARMONICS_UP_TO, of=of, highest=half, without=tuple(waves),
                                angles=one.angle.size))
    for forwards, back in pairs_of_senses(solution):
        parts, waves = _of_curves(solution.hidden[back.place] - solution.hidden[forwards.place], forwards.angle)
        known.append(remark(Part.REVERSAL, of='', without=tuple(parts), waves=tuple(waves)))
        hidden += [remark(name, of=REVERSAL) for name in parts]
        hidden += [remark(Part.HARMONICS, of=REVERSAL, waves=tuple(waves))] if waves else []
    for name in (Part.SCALE, Part.HEIGHT):
        (hidden if _is_hidden(solution, name) else known).append(remark(name, of=''))
    return Knowledge(_distinct(known), _distinct(hidden))


def _distinct(every: Sequence[Remark]) -> tuple[Remark, ...]:
    return tuple(one for place, one in enumerate(every) if one not in every[:place])


def pairs_of_senses(solution: JointSolution) -> list[tuple[TableSet, TableSet]]:
    """Return the sets of both senses of the same table at the angles that both have, counter-clockwise first."""
    found = []
    for one, other in _both_senses(solution):
        rows, other_rows = np.nonzero(np.abs(wrap(one.angle[:, None] - other.angle)) <= SAME_ANGLE)
        if rows.size:
            found.append((_at(one, rows), _at(other, other_rows)))
    return found


def angles_of_one_sense(solution: JointSolution) -> list[Remark]:
    """Return which angles, rad, of a table that was measured in both senses have no reversal, for lack of which."""
    return [remark(JointRemark.NO_REVERSAL, of=one.words, angles=tuple(one.angle[alone].tolist()), lacks=other.sense)
            for pair in _both_senses(solution) for one, other in (pair, pair[::-1])
            if (alone := np.abs(wrap(one.angle[:, None] - other.angle)).min(axis=1) > SAME_ANGLE).any()]


def _both_senses(solution: JointSolution) -> list[tuple[TableSet, TableSet]]:
    sets = solution.model.sets
    return [(one, other) for one in sets for other in sets
            if (one.name, one.sense, other.sense) == (other.name, 1, -1)]


def _at(one: TableSet, rows: Ints) -> TableSet:
    place = np.arange(one.place.start, one.place.stop) if isinstance(one.place, slice) else one.place
    return replace(one, angle=one.angle[rows], place=place.reshape(-1, 6)[rows].ravel())


def _of_curves(hidden: Floats, angle: Floats) -> tuple[list[Part], list[int]]:
    """Return those of _PARTS and other harmonics that hidden directions (6 m, h) of curves change."""
    size = angle.size
    orders = np.arange(-((size - 1) // 2), size // 2 + 1)
    to_harmonics = np.linalg.inv(np.exp(1j * angle[:, None] * orders))
    x, y, z, rx, ry, rz = hidden.reshape(size, 6, -1).swapaxes(0, 1)
    found = {}
    for name, values in (('radial', x + 1j * y), ('axial', z), ('tilt', rx + 1j * ry), ('angular', rz)):
        touched = np.abs(to_harmonics @ values).max(axis=1, initial=0) > SEEN
        found[name] = {*orders[touched].tolist()}
    parts = [name for name, kind, order in _PARTS if order in found[kind]]
    usual = {'radial': {0, 1}, 'axial': {0}, 'tilt': {0, 1}, 'angular': {0}}
    return parts, sorted({abs(order) for kind, orders_found in found.items() for order in orders_found - usual[kind]})


def _is_hidden(solution: JointSolution, name: Part) -> bool:
    """Return whether a common size or place of CMM deviations, or of plate deviations where those are known, is."""
    model = solution.model
    for group, at in model.at.items():
        place = model.groups[group]
        if model.free[place].all():
            shift, scale = np.broadcast_to(np.eye(3), (len(at), 3, 3)), at[:, :, None] * [[[1], [1], [0]]]
            columns = np.concatenate([shift, tilts(at) / model.lever, scale / model.lever], axis=2).reshape(-1, 7)
            touched = np.abs(np.linalg.pinv(columns) @ solution.hidden[place]).max(axis=1, initial=0) > SEEN
            return bool(touched[6] if name is Part.SCALE else touched[2] or touched[5])
    return False

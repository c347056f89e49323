# SPDX-License-Identifier: Apache-2.0
"""What a joint evaluation determines, and what it does not, in words."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rosette_ros.core.joint.joint_model import JointSolution, TableSet, tilts
from rosette_ros.core.run.geometry import SAME_ANGLE, Floats, Ints, wrap

SEEN = 1e-6
"""Part of a hidden direction below which a quantity is not touched by it."""
ECCENTRICITY, TILT = 'once-per-turn part of (ctx, cty): eccentricity', 'once-per-turn part of (crx, cry): tilt'
SCALE, HEIGHT = 'radial scale of plate and CMM', 'height and turn about z between plate and CMM'
_PARTS = (('mean of ctx and cty', 'radial', 0), ('mean of ctz', 'axial', 0), ('mean of crx and cry', 'tilt', 0),
          ('mean of crz', 'angular', 0), (ECCENTRICITY, 'radial', 1), (TILT, 'tilt', 1))

MEANS = tuple(name for name, _, order in _PARTS if order == 0)


@dataclass(frozen=True)
class Knowledge:
    """In words: known, beyond what one run of a regular plate knows; hidden, what stays unknown."""

    known: tuple[str, ...]
    hidden: tuple[str, ...]


def knowledge(solution: JointSolution) -> Knowledge:
    """Return what a solution determines; harmonics are those of the table error at the angles of a set."""
    known, hidden = list[str](), list[str]()
    sets, balls = solution.model.sets, max(run.plate.balls for run in solution.model.runs)
    found = [_of_curves(solution.hidden[one.place], one.angle) for one in sets]
    are_alike = all(one == found[0] for one in found)
    for one, (parts, waves) in zip(sets, found):
        prefix = '' if are_alike else f'{one.words}: '
        hidden += [prefix + name for name in parts]
        known += [prefix + name for name, *_ in _PARTS if name not in parts]
        hidden += [f'{prefix}harmonics {_numbers(waves)}'] if waves else []
        half = one.angle.size // 2
        if one.angle.size > balls and not {*range(2, half + 1)} <= {*waves}:
            except_words = f' except {_numbers(waves)}' if waves else ''
            known.append(f'{prefix}harmonics up to {half}{except_words}, at {one.angle.size} table angles')
    for forwards, back in pairs_of_senses(solution):
        parts, waves = _of_curves(solution.hidden[back.place] - solution.hidden[forwards.place], forwards.angle)
        known.append(f'the reversal of all six curves, {_with_or_but(parts, waves)}')
        hidden += [f'reversal: {name}' for name in parts]
        hidden += [f'reversal: harmonics {_numbers(waves)}'] if waves else []
    common = [name for name in (SCALE, HEIGHT) if _is_hidden(solution, name)]
    known += [name for name in (SCALE, HEIGHT) if name not in common]
    return Knowledge(tuple(dict.fromkeys(known)), tuple(dict.fromkeys([*hidden, *common])))


def _with_or_but(parts: Sequence[str], waves: Sequence[int]) -> str:
    """Return that a reversal is known with its means, or what of it is not: parts of _PARTS, harmonics."""
    if not parts and not waves:
        return 'with its means'
    but = ['means', *[name for name in parts if name not in MEANS]] if {*MEANS} <= {*parts} else [*parts]
    return f'but for its {", ".join([*but, *[f"harmonics {_numbers(waves)}"] * bool(waves)])}'


def pairs_of_senses(solution: JointSolution) -> list[tuple[TableSet, TableSet]]:
    """Return the sets of both senses of the same table at the angles that both have, counter-clockwise first."""
    found = []
    for one, other in _both_senses(solution):
        rows, other_rows = np.nonzero(np.abs(wrap(one.angle[:, None] - other.angle)) <= SAME_ANGLE)
        if rows.size:
            found.append((_at(one, rows), _at(other, other_rows)))
    return found


def angles_of_one_sense(solution: JointSolution) -> list[str]:
    """Return which angles of a table that was measured in both senses have no reversal, in words."""
    return [f'{one.words}: no reversal at {", ".join(f"{angle:.6g}" for angle in np.rad2deg(one.angle[alone]))} deg, '
            f'where nothing was measured {("counter-" * (other.sense > 0))}clockwise'
            for pair in _both_senses(solution) for one, other in (pair, pair[::-1])
            if (alone := np.abs(wrap(one.angle[:, None] - other.angle)).min(axis=1) > SAME_ANGLE).any()]


def _both_senses(solution: JointSolution) -> list[tuple[TableSet, TableSet]]:
    sets = solution.model.sets
    return [(one, other) for one in sets for other in sets
            if (one.name, one.sense, other.sense) == (other.name, 1, -1)]


def _at(one: TableSet, rows: Ints) -> TableSet:
    place = np.arange(one.place.start, one.place.stop) if isinstance(one.place, slice) else one.place
    return replace(one, angle=one.angle[rows], place=place.reshape(-1, 6)[rows].ravel())


def _of_curves(hidden: Floats, angle: Floats) -> tuple[list[str], list[int]]:
    """Return names of _PARTS and other harmonics that hidden directions (6 m, h) of curves change."""
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


def _is_hidden(solution: JointSolution, name: str) -> bool:
    """Return whether a common size or place of CMM deviations, or of plate deviations where those are known, is."""
    model = solution.model
    for group, at in model.at.items():
        place = model.groups[group]
        if model.free[place].all():
            shift, scale = np.broadcast_to(np.eye(3), (len(at), 3, 3)), at[:, :, None] * [[[1], [1], [0]]]
            columns = np.concatenate([shift, tilts(at) / model.lever, scale / model.lever], axis=2).reshape(-1, 7)
            touched = np.abs(np.linalg.pinv(columns) @ solution.hidden[place]).max(axis=1, initial=0) > SEEN
            return bool(touched[6] if name == SCALE else touched[2] or touched[5])
    return False


def _numbers(waves: Iterable[int]) -> str:
    """Return rising numbers as text, such as 2, 5 to 8."""
    spans = list[list[int]]()
    for wave in waves:
        if spans and wave == spans[-1][1] + 1:
            spans[-1][1] = wave
        else:
            spans.append([wave, wave])
    return ', '.join(str(low) if low == high else f'{low} to {high}' for low, high in spans)

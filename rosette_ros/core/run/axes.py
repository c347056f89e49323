# SPDX-License-Identifier: Apache-2.0
"""How the table stands in the machine: its taught pose, the CMM's own axes seen from it, the names that follow.

A rotation (3, 3) is that of the table frame in the machine frame, its columns are the axes of the table; points go
through `Frame`. None: not known, taken as upright, the axes of the table along those of the machine.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.geometry import Floats, Frame, nominal_angles, rotate_z, rotation_along, rotation_matrix

LETTERS = 'xyz'
ALONG = np.deg2rad(10.0)
"""A table axis that is off an axis of the machine by no more is called after it, rad."""
OTHER = np.deg2rad(30.0)
"""A table axis that is off the taught one by more is another one, rad."""
APART = 5e-6
"""What is taken for one ball of the plate is no farther from its place, rms, m: table and CMM err by less."""
UPRIGHT = np.deg2rad(1.0)
"""A table axis that is off the vertical by no more is vertical, rad."""
ALIGNED = 2e-3
"""Axes of table and machine that are apart by no more, rad, are meant to be parallel: 1 % of a reversal is 0.2 %."""


def unit_axis(axis: ArrayLike) -> Floats:
    """Return a direction (3,) with the length 1; raises InvalidData where it is none."""
    made: Floats = np.asarray(axis, dtype=float)
    if made.shape != (3,) or not np.isfinite(made).all() or not made.any():
        raise InvalidData(f'expected 3 numbers that are not all 0, found {made.tolist()!r:.80}')
    made = made / np.abs(made).max()
    return np.asarray(made / np.linalg.norm(made))


def words(direction: Floats) -> str:
    """Return a direction (3,) in words: (0.5, 0, 0.866)."""
    return f'({", ".join(f"{value + 0.0:.3g}" for value in np.round(direction, 6).tolist())})'


def refuse_other_axis(found: Frame, taught: Frame) -> None:
    """Raise NotDeterminable where the table turns about another axis than taught, or the other way."""
    axis, wanted = found.rotation[:, 2], taught.rotation[:, 2]
    if axis @ wanted < np.cos(OTHER):
        raise NotDeterminable(f'expected the table to turn counter-clockwise about the taught axis {words(wanted)}, '
                              'found '
                              f'{words(axis)} from the ball centres; correct table.axis')


def refuse_other_sense(found: Frame, axis: ArrayLike, plane: ArrayLike) -> None:
    """Raise NotDeterminable where the table turns the other way than its angle says.

    found: the table frame; axis: (n, 3) what was found as ball 1 at the n table positions; plane: (n, 3) the balls at
    table position 1, m. Then a ball of a regular plate stands at every place too, but at table position i ball 1 + 2
    (i - 1), turned by -phi_i: what was taken for ball 1 is not always at one place of the plate. 3 balls do not tell.
    """
    first, balls = found.to_inner(axis), found.to_inner(plane)
    if len(first) != len(balls):
        return
    angle, places = nominal_angles(len(balls)), np.arange(len(balls))
    same = rotate_z(-angle, first)
    other = rotate_z(angle, first) - balls[2 * places % len(balls)]
    apart, left = (float(np.sqrt(np.square(off - off.mean(axis=0)).sum(axis=-1).mean())) for off in (same, other))
    if apart > APART and left < 0.2 * apart:
        raise NotDeterminable(
            f'expected ball 1 at one place of the plate as the table turns, found places {1e6 * apart:.3g} um apart, '
            'and '
            f'balls to {1e6 * left:.2g} um for a table that turns the other way; correct the sense in which the angle '
            'of the table counts (I++: table.sign), or table.axis')


def nearest_axis(direction: Floats) -> int:
    """Return which axis of the machine, 0..2, a direction (3,) is nearest to; of two that are as near the last."""
    return 2 - int(np.argmax(np.round(np.abs(direction[::-1]), 2)))


def axis_rotation(axis: ArrayLike) -> Floats:
    """Return the rotation of a table whose z is along `axis` and whose x is at azimuth 0.

    There x is the axis of the machine that follows, x y z x, the one nearest to `axis`, put across it: a table along z
    counts from x, one along x from y, one along y from z. Raises InvalidData as unit_axis."""
    z = unit_axis(axis)
    return rotation_along(z, np.eye(3)[(nearest_axis(z) + 1) % 3])


def taught_frame(origin: ArrayLike, axis: ArrayLike, azimuth: float) -> Frame:
    """Return the table frame as taught: origin (3,), m, axis (3,), azimuth of ball 1 at table angle 0, rad."""
    return Frame(axis_rotation(axis) @ rotation_matrix([0.0, 0.0, azimuth]), np.asarray(origin, dtype=float))


def azimuth(rotation: Floats) -> float:
    """Return where ball 1 is at table angle 0, as of taught_frame, in -pi..pi, rad."""
    across = axis_rotation(rotation[:, 2]).T @ rotation[:, 0]
    return float(np.arctan2(across[1], across[0]))


def rotation_of(axis: ArrayLike, x: ArrayLike | None = None) -> Floats:
    """Return the rotation of a table of which axis and x are known as directions (3,) in the machine.

    x: None for azimuth 0. Raises InvalidData where one is no direction, or they are not perpendicular to 1 mrad."""
    z = unit_axis(axis)
    if x is None:
        return axis_rotation(z)
    along = unit_axis(x)
    if abs(z @ along) > 1e-3:
        raise InvalidData(f'expected x perpendicular to the axis, found {np.rad2deg(np.arccos(z @ along)):.2f} deg '
                          'between '
                          'them')
    return rotation_along(z, along)


def table_axis(rotation: Floats | None) -> Floats:
    """Return the direction of the table axis in the machine, (3,)."""
    return np.array([0.0, 0.0, 1.0]) if rotation is None else rotation[:, 2]


def refuse_other_axes(tables: Sequence[tuple[str, Floats | None]]) -> None:
    """Refuse tables, name and rotation, that point in different directions: curves are named by the first of them."""
    (first, one), *others = tables
    for name, other in others:
        if table_axis(other) @ table_axis(one) < np.cos(ALONG):
            raise InvalidData('expected runs of a table about one axis, found ' + ' and '.join(
                f'{words(table_axis(rotation))}{"" if rotation is not None else ", as none is stated,"} in {which}'
                for which, rotation in ((first, one), (name, other))) + '; evaluate them apart')


def cmm_axes(rotation: Floats | None) -> Floats:
    """Return the directions of the CMM's axes x, y, z in the table frame, (3, 3), one a row.

    Where table and machine are aligned to within ALIGNED, they are exactly along the axes of the table."""
    if rotation is None:
        return np.eye(3)
    near = np.round(rotation)
    return near if np.abs(rotation - near).max() <= ALIGNED else rotation


def moving_axes(rotation: Floats | None) -> tuple[int, int]:
    """Return which axes of the CMM, 0..2, go to and fro between the balls.

    Along the third, nearest to the table axis, the probe comes to every ball from the free side of the plate."""
    free = 2 if rotation is None else nearest_axis(rotation[:, 2])
    first, second = (axis for axis in range(3) if axis != free)
    return first, second


def tilt(rotation: Floats | None) -> float:
    """Return the angle between table axis and the vertical, z of the machine, up or down, 0..pi/2, rad."""
    return 0.0 if rotation is None else float(np.arccos(min(abs(rotation[2, 2]), 1.0)))


def machine_axis(rotation: Floats | None) -> tuple[int, int] | None:
    """Return (0..2, sense) of the machine's axis along which the table axis is, sense -1 for against it.

    None where it is along none, to within ALONG."""
    if rotation is None:
        return 2, 1
    axis = rotation[:, 2]
    near = nearest_axis(axis)
    return (near, 1 if axis[near] > 0 else -1) if abs(axis[near]) >= np.cos(ALONG) else None


def iso_names(rotation: Floats | None) -> dict[str, str]:
    """Return the names of the six curves after ISO 230-1, by those of VDI/VDE 2617: EXC for ctx of a C axis.

    A table along x has an A axis (EXA is its axial motion), along y a B axis, along z a C axis; the two letters across
    it are those that x and y of the table have at azimuth 0. `-EYC`: the curve counts against y of the machine, where
    the axis points against its own. An oblique axis has no letter: X, Y, Z, A, B, C are then those of the table's own
    frame, and it is called C."""
    axis, sense = machine_axis(rotation) or (2, 1)
    out = {}
    for place, name in enumerate(LETTERS):
        letter, sign = (axis + 1 + place) % 3, '-' if sense < 0 and place else ''
        out[f'ct{name}'] = f'{sign}E{"XYZ"[letter]}{"ABC"[axis]}'
        out[f'cr{name}'] = f'{sign}E{"ABC"[letter]}{"ABC"[axis]}'
    return {name: out[name] for name in ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')}

# SPDX-License-Identifier: Apache-2.0
"""Ball centres of one run of any plate at any table angles, as a joint evaluation takes them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Bools, Floats, Frame, Ints, nominal_angles, radial
from rosette_ros.core.run.records import Run

OFF_PLACE = 1e-3
"""How far a ball may be from its place on a circle of equal steps, m: less is a deviation of the plate."""


@dataclass(frozen=True, eq=False)
class Plate:
    """Nominal ball centres of a plate in its own axes.

    azimuth, radius, height: (b,) rad, m, m; is_calibrated: whether they are known so well that only the placement of
    the plate is to be found; is_regular: equal pitch, balls counted from the one next to +x, however it was put on.
    """

    azimuth: Floats
    radius: Floats
    height: Floats
    is_calibrated: bool = False
    is_regular: bool = False
    source: str = ''

    @staticmethod
    def regular(n: int, radius: float) -> 'Plate':
        """Return the plate of n balls of equal pitch on a circle of a radius, m."""
        return Plate(nominal_angles(n), np.full(n, radius), np.zeros(n), is_regular=True)

    @property
    def balls(self) -> int:
        """Number of balls."""
        return self.azimuth.size

    @cached_property
    def centres(self) -> Floats:
        """(b, 3) nominal centres, m."""
        return self.turned(0.0)

    def turned(self, turn: float) -> Floats:
        """Return the nominal centres with the plate turned on the table by an angle, rad, (b, 3), m."""
        return np.asarray(self.radius[:, None] * radial(self.azimuth + turn) + self.height[:, None] * np.eye(3)[2])

    def places(self, positions: int) -> tuple[int, ...]:
        """Return which of equally spaced places on the circle the balls are, from 1, for so many table positions.

        As balls of a plate of `positions` balls of which only these exist, they take part in plans, runs and models of
        equal pitch. Raises InvalidData where a ball is more than 1 mm off its place, or none is on x.
        """
        step = 360 / positions
        place = np.rint(np.rad2deg(self.azimuth) / step).astype(np.int64)
        wanted = Plate.regular(positions, self.circle)
        off = np.linalg.norm(self.centres - wanted.centres[place % positions] - [0, 0, self.height.mean()], axis=1)
        other = 'tables of ball centres take any plate (rosette evaluate, rosette report --joint)'
        for ball in np.flatnonzero(off > OFF_PLACE).tolist():
            raise InvalidData(
                f'{self.source}: ball {ball + 1}: expected it within 1 mm of a multiple of {step:.6g} deg, the step of '
                f'{positions} table positions, on a circle of {1e3 * self.circle:.6g} mm at one height, found '
                f'{np.rad2deg(self.azimuth[ball]):.6g} deg, {1e3 * self.radius[ball]:.6g} mm, '
                f'{1e3 * self.height[ball]:.6g} mm; {other}')
        found: list[int] = (place % positions + 1).tolist()
        if 1 not in found:
            raise InvalidData(f'{self.source}: expected a ball at azimuth 0, from which balls are counted, found none; '
                              f'{other}')
        if len({*found}) < len(found):
            raise InvalidData(f'{self.source}: expected each ball at a place of its own of {positions}, found two at '
                              'one')
        return tuple(found)

    @property
    def circle(self) -> float:
        """Mean radius to the picometre, m."""
        return round(float(self.radius.mean()), 12)

    def is_like(self, other: 'Plate') -> bool:
        """Return whether the nominal centres of both agree within 0.1 mm."""
        return self.balls == other.balls and bool(np.abs(self.centres - other.centres).max() < 1e-4)


@dataclass(frozen=True, eq=False)
class Readings:
    """N ball centres of one run.

    plate; angle: (m,) nominal table angle of each table position, rad; table_position, ball: (N,) one-based; centre:
    (N, 3) in the table frame, m; angle_deviation: (N,) actual minus nominal table angle, rad; approach: (N,) as of Run;
    repeatability, repeatability_dof: as of Run; frame: the table frame in the machine frame where it is known;
    simulated, rotation, rounding: as of Run; run: where the readings are those of one, with times and senses.

    Raises InvalidData where an index does not exist.
    """

    plate: Plate
    angle: Floats
    table_position: Ints
    ball: Ints
    centre: Floats
    angle_deviation: Floats
    approach: Ints
    repeatability: float | None = None
    repeatability_dof: float | None = None
    frame: Frame | None = None
    run_id: str = ''
    source: str = 'run'
    notes: tuple[str, ...] = ()
    simulated: bool = False
    rotation: Floats | None = None
    run: Run | None = None
    rounding: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (('table_position', self.angle.size), ('ball', self.plate.balls)):
            bad = np.flatnonzero((getattr(self, name) < 1) | (getattr(self, name) > most))
            if bad.size:
                raise InvalidData(f'{self.source}: reading {bad[0] + 1}: {name}: expected 1..{most}, found '
                                  f'{getattr(self, name)[bad[0]]}')

    @staticmethod
    def of(run: Run, frame: Frame | None = None) -> 'Readings':
        """Return the readings of a Run; frame: its table frame in the machine frame where that is known."""
        centre, rotation = run.from_angle_zero()
        return Readings(Plate.regular(run.n, run.radius), nominal_angles(run.n) + run.table_offset, run.table_position,
                        run.ball, centre, run.angle_deviation, run.approach, run.repeatability, run.repeatability_dof,
                        frame, run.run_id, run.source, run.notes, run.simulated, rotation, run, run.rounding)

    @property
    def size(self) -> int:
        """N, the number of readings."""
        return self.ball.size

    @property
    def name(self) -> str:
        """What it is called in words."""
        return self.run_id or self.source

    @property
    def backwards(self) -> Bools:
        """(N,) whether the table came clockwise; what is unknown is taken as counter-clockwise."""
        return self.approach < 0

    def turned(self, turn: float) -> tuple[Ints, Floats]:
        """Return which balls of the plate, from 0, (N,), and their nominal centres (N, 3) with the plate turned, m.

        turn: rad; that of a regular plate is whole pitches, as its ball next to +x is counted as ball 1. Raises
        InvalidData for another one.
        """
        plate, ball = self.plate, self.ball - 1
        if not plate.is_regular:
            return ball, plate.turned(turn)[ball]
        pitches = turn * plate.balls / (2 * np.pi)
        if abs(pitches - round(pitches)) > 1e-6:
            raise InvalidData(f'{self.source}: plate turned by {np.rad2deg(turn):.6g} deg: expected whole pitches of '
                              f'{360 / plate.balls:.6g} deg, as ball 1 is the one next to +x; describe the plate by a '
                              'plate file for other angles')
        return (ball - round(pitches)) % plate.balls, plate.centres[ball]

    def seen_from(self, frame: Frame) -> 'Readings':
        """Return the readings in another table frame, given, as their own one, in the machine frame."""
        if self.frame is None:
            raise InvalidData(f'{self.source}: expected its table frame, found none')
        return replace(self, centre=frame.to_inner(self.frame.to_outer(self.centre)), frame=frame,
                       rotation=frame.rotation)

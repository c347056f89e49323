# SPDX-License-Identifier: Apache-2.0
"""The spheres of a run fitted again to its touches, and what single touches show: ball form and probe lobing."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.run.geometry import Floats, Ints, rotate_z
from rosette_ros.core.run.touches import LEAST_TOUCHES, fit_spheres, sphere_factors

FLAT = 1e-4
"""Touches that span less of a direction than this share of the widest one determine no sphere."""
SMALLEST, FARTHEST = 1e-5, 1.0
"""Touches nearer together, or farther from the centre that was sent, m, are none of a ball."""
UNIT = 0.01  # by which a unit vector may be off
REFIT_STEPS = 12
"""Of Gauss-Newton: rounding is left for forms of up to 2 % of the radius."""
RING, SECTOR = 12, 15
"""Directions are gathered in fields of so many degrees from the pole and around it."""
ROUNDING = 1e-12
"""Means that are smaller are none, m."""
OUTLIER, MOST_OUTLIERS = 6.0, 0.05
"""An outlier is that far from its sphere, in standard deviations; such a share of the readings may have one."""
RINGS, SECTORS = 180 // RING, 360 // SECTOR


@dataclass(frozen=True, eq=False)
class TouchedBalls:
    """The touches of M readings of balls, T in all, in the frame of the CMM.

    seq, table_position, ball: (M,); table_angle: (M,) rad; sent: (M, 3) centres as the CMM sent them, m; tip: (M,)
    radius of the tip that the fitted radii contain, m, 0 where it was taken off, NaN where it is unknown; owner: (T,)
    row of the reading of each touch, rising; point: (T, 3) m; normal: (T, 3) unit vectors against which the probe came;
    time: (T,) s after the stamp of the reading; rotation: (3, 3), its columns are the axes of the table frame;
    left_out: how many readings are not among the M, by reason.
    """

    seq: Ints
    table_position: Ints
    ball: Ints
    table_angle: Floats
    sent: Floats
    tip: Floats
    owner: Ints
    point: Floats
    normal: Floats
    time: Floats
    rotation: Floats
    left_out: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def touches(self) -> Ints:
        """Number of touches of each reading, (M,)."""
        return np.bincount(self.owner, minlength=self.seq.size)

    @cached_property
    def first(self) -> Ints:
        """Place of the first touch of each reading, (M,)."""
        return np.cumsum(self.touches) - self.touches

    def select(self, chosen: Ints, why: str) -> 'TouchedBalls':
        """Return those of some readings, rows (K,); why: of the others, in words."""
        kept = np.flatnonzero(np.isin(self.owner, chosen))
        place = np.full(self.seq.size, -1)
        place[chosen] = np.arange(chosen.size)
        others = {why: self.seq.size - chosen.size + self.left_out.get(why, 0)} if chosen.size < self.seq.size else {}
        return replace(
            self, seq=self.seq[chosen], table_position=self.table_position[chosen], ball=self.ball[chosen],
            table_angle=self.table_angle[chosen], sent=self.sent[chosen], tip=self.tip[chosen],
            owner=place[self.owner[kept]], point=self.point[kept], normal=self.normal[kept], time=self.time[kept],
            left_out={**self.left_out, **others})


@dataclass(frozen=True, eq=False)
class DirectionMap:
    """Mean residuals by direction: mean (..., RINGS, SECTORS), m, NaN without touch; count: of touches there.

    Rings count from the pole, sectors are centred on multiples of SECTOR degrees from +x.
    """

    mean: Floats
    count: Ints
    scatter: float

    @property
    def systematic(self) -> Floats:
        """Root mean square of the means, freed of what the scatter of single touches adds to them, (...), m."""
        total = np.maximum(self.count.sum(axis=(-2, -1)), 1)
        seen = (self.count > 0).sum(axis=(-2, -1))
        square = (self.count * np.nan_to_num(self.mean)**2).sum(axis=(-2, -1)) / total
        return np.asarray(np.sqrt(np.maximum(square - self.scatter**2 * seen / total, 0.0)))

    @property
    def p(self) -> Floats:
        """Probability that noise alone gives means as large (F test), (...); 1 where there are none but of rounding."""
        seen = (self.count > 0).sum(axis=(-2, -1))
        square = (self.count * np.nan_to_num(self.mean)**2).sum(axis=(-2, -1)) / np.maximum(seen, 1)
        freedom = max(int(self.count.sum() - seen.sum()), 1)
        p = scipy.special.fdtrc(seen, freedom, square / max(self.scatter, ROUNDING)**2)
        return np.asarray(np.where(square > ROUNDING**2, p, 1.0))

    @property
    def largest(self) -> tuple[float, float, float]:
        """The largest mean by size, m, its azimuth and its elevation above the equator, degrees."""
        ring, sector = np.unravel_index(int(np.nanargmax(np.abs(self.mean))), self.mean.shape)
        return float(self.mean[ring, sector]), float(sector * SECTOR), 90 - (float(ring) + 0.5) * RING

    def at(self, cell: Ints) -> Floats:
        """Return the mean in the field of each touch, cell as of `fields`, (T,), m."""
        return np.asarray(self.mean.reshape(-1)[cell])


def fields(direction: Floats) -> Ints:
    """Return the number of the field of each direction, (T, 3) unit vectors, (T,)."""
    polar = np.degrees(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)))
    around = np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
    ring = np.minimum(polar // RING, RINGS - 1).astype(np.int64)
    return np.asarray(ring * SECTORS + np.rint(around / SECTOR).astype(np.int64) % SECTORS)


def direction_map(residual: Floats, cell: Ints, group: Ints | None = None, groups: int = 1) -> DirectionMap:
    """Return the DirectionMap of residuals (T,), m, of each of the groups that `group` (T,) numbers from 0."""
    place = cell if group is None else group * RINGS * SECTORS + cell
    size = groups * RINGS * SECTORS
    count = np.bincount(place, minlength=size)
    with np.errstate(invalid='ignore'):
        mean = np.bincount(place, residual, size) / count
    seen = int((count > 0).sum())
    scatter = float(np.sqrt(((residual - mean[place])**2).sum() / max(residual.size - seen, 1)))
    shape = (RINGS, SECTORS) if group is None else (groups, RINGS, SECTORS)
    return DirectionMap(mean.reshape(shape), count.reshape(shape), scatter)


@dataclass(frozen=True, eq=False)
class SphereRefit:
    """Least-squares spheres through the touches of readings.

    touched: what was fitted; centre: (M, 3) m, in the frame of the CMM; radius: (M,) of the balls, m; residual: (T,) of
    each touch from its sphere, outwards positive, m.
    """

    touched: TouchedBalls
    centre: Floats
    radius: Floats
    residual: Floats

    @property
    def centres(self) -> dict[int, tuple[float, float, float]]:
        """The fitted centres by seq."""
        return dict(zip(self.touched.seq.tolist(), map(tuple, self.centre.tolist()), strict=True))

    @property
    def moved(self) -> Floats:
        """Distance of each fitted centre from the one that was sent, (M,), m."""
        return np.asarray(np.linalg.norm(self.centre - self.touched.sent, axis=1))

    @cached_property
    def form(self) -> Floats:
        """Range of the residuals of each reading, (M,), m."""
        low, high = (one.reduceat(self.residual, self.touched.first) for one in (np.minimum, np.maximum))
        return np.asarray(high - low)

    @cached_property
    def rms(self) -> Floats:
        """Standard deviation of a touch by each reading, (M,), m: four of its touches determine the sphere."""
        touched = self.touched
        squares = np.bincount(touched.owner, self.residual**2, touched.seq.size)
        return np.asarray(np.sqrt(squares / np.maximum(touched.touches - LEAST_TOUCHES, 1)))

    @property
    def sigma(self) -> float:
        """Standard deviation of a touch along its normal, m, of all readings."""
        return float(np.sqrt((self.residual**2).sum() / max(self.residual.size - LEAST_TOUCHES * self.radius.size, 1)))

    @property
    def radius_u(self) -> float:
        """Standard uncertainty of a radius by the scatter of the touches, m; of the first sphere."""
        return float(self.sigma * sphere_factors(self.direction[self.touched.owner == 0])[3])

    @cached_property
    def direction(self) -> Floats:
        """Unit vectors from the balls' centres to their touches, in the table frame at rest, (T, 3)."""
        off = self.touched.point - self.centre[self.touched.owner]
        return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True) @ self.touched.rotation)

    @cached_property
    def approach(self) -> Floats:
        """Unit vectors against which the probe came, in the table frame at rest, (T, 3).

        Where they are unknown, or no unit vectors, those to the touches.
        """
        with np.errstate(all='ignore'):
            size = np.linalg.norm(self.touched.normal, axis=1, keepdims=True)
            normal = self.touched.normal / size @ self.touched.rotation
        return np.where(np.abs(size - 1) < UNIT, normal, self.direction)

    @cached_property
    def outliers(self) -> Ints:
        """Of each reading with a touch far off its sphere, the place (0..T-1) of the one that is farthest off.

        Far: in standard deviations of a touch of its ball, as the median tells it.
        None where so many readings have one that they are no exceptions.
        """
        size, ball = np.abs(self.residual), np.searchsorted(self.balls, self.touched.ball[self.touched.owner])
        usual = np.array([np.median(size[ball == one]) for one in range(self.balls.size)])
        place = np.flatnonzero(size > OUTLIER * np.maximum(1.4826 * usual, ROUNDING)[ball])
        place = place[np.argsort(-size[place], kind='stable')]
        place = place[np.unique(self.touched.owner[place], return_index=True)[1]]
        return place if place.size <= MOST_OUTLIERS * self.radius.size else place[:0]

    @cached_property
    def _regular(self) -> Ints:
        """Places of the touches of readings without an outlier."""
        return np.flatnonzero(~np.isin(self.touched.owner, self.touched.owner[self.outliers]))

    @cached_property
    def lobing(self) -> DirectionMap:
        """Mean residual of all balls by the direction against which the probe came: what the probe adds.

        Readings with an outlier are left out.
        """
        return direction_map(self.residual[self._regular], fields(self.approach[self._regular]))

    @cached_property
    def balls(self) -> Ints:
        """Numbers of the balls that were touched, (B,)."""
        return np.unique(self.touched.ball)

    @cached_property
    def ball_forms(self) -> DirectionMap:
        """Mean residual of each ball, (B, RINGS, SECTORS), by direction on the plate, which turns: form of the balls.

        The mean of all balls by the direction of the probe (lobing) is taken off before.
        """
        chosen = self._regular
        owner = self.touched.owner[chosen]
        own = rotate_z(-self.touched.table_angle[owner], self.direction[chosen])
        left = self.residual[chosen] - self.lobing.at(fields(self.approach[chosen]))
        group = np.searchsorted(self.balls, self.touched.ball[owner])
        return direction_map(left, fields(own), group, self.balls.size)


def refit_spheres(touched: TouchedBalls) -> SphereRefit:
    """Return the SphereRefit of touches; readings whose touches determine no sphere are left out, and counted."""
    with np.errstate(over='ignore', invalid='ignore'):
        away = np.linalg.norm(touched.point - touched.sent[touched.owner], axis=1)
    far = np.unique(touched.owner[~(away < FARTHEST)])
    touched = touched.select(np.setdiff1d(np.arange(touched.seq.size), far), f'touches over {FARTHEST:g} m off')
    touched = touched.select(np.flatnonzero(touched.touches >= LEAST_TOUCHES), f'fewer than {LEAST_TOUCHES} touches')
    touched = touched.select(_solid(touched), 'touches in a plane')
    centre, radius, residual = np.empty((touched.seq.size, 3)), np.empty(touched.seq.size), np.empty(touched.owner.size)
    with np.errstate(all='ignore'):  # what is on no sphere is left out
        for rows, places in _alike(touched):
            found = fit_spheres(touched.point[places], REFIT_STEPS)
            centre[rows], radius[rows], residual[places] = found.centre, found.radius, found.residual
    is_sphere = np.isfinite(centre).all(axis=1) & (radius < FARTHEST)
    if not is_sphere.all():
        return refit_spheres(touched.select(np.flatnonzero(is_sphere), 'touches on no sphere'))
    return SphereRefit(touched, centre, radius - np.nan_to_num(touched.tip), residual)


def _alike(touched: TouchedBalls) -> list[tuple[Ints, Ints]]:
    """Return (rows (K,), places of their touches (K, Q)) of the readings with as many touches each."""
    out = []
    for count in np.unique(touched.touches).tolist():
        rows = np.flatnonzero(touched.touches == count)
        out.append((rows, touched.first[rows, None] + np.arange(count)))
    return out


def _solid(touched: TouchedBalls) -> Ints:
    """Return the rows of the readings whose touches span all directions."""
    is_solid = np.zeros(touched.seq.size, dtype=bool)
    for rows, places in _alike(touched):
        off = touched.point[places] - touched.point[places].mean(axis=1, keepdims=True)
        spread = np.linalg.svd(off, compute_uv=False)
        is_solid[rows] = spread[:, -1] > FLAT * np.maximum(spread[:, 0], SMALLEST)
    return np.flatnonzero(is_solid)

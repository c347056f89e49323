# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo of an uncertainty budget (GUM S1, S2): readings drawn anew through exact rigid bodies, fitted again.

It uses no sensitivity of the budget. In each trial balls of random form grow with the temperature and are carried by
the table with its errors, by rotation matrices, in a frame that moves; each is touched, a sphere is fitted to the
touches, the centre is seen in a table frame that is off; the least squares of the run gives the curves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.model.base_space import BaseParameters
from rosette_ros.core.model.least_squares import observed
from rosette_ros.core.model.second_order import beyond_linear
from rosette_ros.core.run.geometry import radial, rotate_z, rotation_matrix
from rosette_ros.core.run.records import Floats
from rosette_ros.core.run.touches import fit_spheres
from rosette_ros.core.uncertainty.budget_inputs import temperature_course
from rosette_ros.core.uncertainty.budget_lines import root_mean
from rosette_ros.core.uncertainty.form_field import form_basis, standard_height
from rosette_ros.core.uncertainty.uncertainty_budget import PROBABILITY, Budget, form_directions

REACH = 0.01
"""Distance of the tip's centre from that of the ball when it touches, m: a ball of 15 mm, a tip of 5 mm."""
CHUNK = 500_000
"""Numbers that are drawn at once."""
STEPS = 2
"""Of the second-order terms: each leaves about 1e-4 of what the one before left."""
GROUPS = 10
LEAST_GROUP = 100
"""The scatter of the end points is that between so many groups, of so many trials at least."""
SURE = 3
"""Standard deviations of an end point by which it has to be within the tolerance, or beyond it."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """Whether Monte Carlo confirms the budget of one curve (GUM S1, 8).

    expected, found: standard uncertainty, root mean square over the points; low, high: end points of the interval of
    probability 0.9545 about the curve, from Monte Carlo; scatter: standard deviation of the end points by the number
    of trials; tolerance: half a unit of the leading digit of `expected`; all m or rad.
    """

    expected: float
    found: float
    low: float
    high: float
    scatter: float
    tolerance: float

    @property
    def distance(self) -> float:
        """Largest distance of an end point from k = 2."""
        return max(abs(self.low + 2 * self.expected), abs(self.high - 2 * self.expected))

    @property
    def agrees(self) -> bool | None:
        """Whether both end points are within the tolerance; None where there are too few trials to say."""
        if self.distance + SURE * self.scatter <= self.tolerance:
            return True
        return None if self.distance - SURE * self.scatter <= self.tolerance else False


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """The scatter of the curves.

    u: (n, 6), standard deviations; agreements: of the curves; covariance: (n, 6, 6), of the six curves of a point, m
    and rad; reach: (n,), standard deviations that the ellipsoid of this covariance reaches which contains the six
    errors of a point together with probability 0.9545 (GUM S2, 7.7.2).
    """

    trials: int
    seed: int
    u: Floats
    agreements: tuple[Agreement, ...]
    covariance: Floats
    reach: Floats

    @property
    def correlation(self) -> Floats:
        """The correlation of the six curves of each point, (n, 6, 6), 0 where an error does not scatter."""
        product = self.u[:, :, None] * self.u[:, None, :]
        return np.divide(self.covariance, product, out=np.zeros_like(product), where=product > 0)

    @property
    def agrees(self) -> bool | None:
        """Whether all curves agree; None where none disagrees but some are undecided."""
        every = [one.agrees for one in self.agreements]
        return False if False in every else None if None in every else True


def monte_carlo(made: Budget, trials: int, seed: int = 0, on_step: Callable[[int], object] | None = None) -> MonteCarlo:
    """Return what `trials` repetitions of the run give; on_step: called with how many more are done."""
    rng, simulated = np.random.default_rng(seed), _SimulatedReadings(made)
    run = made.fit.run
    most = max(1, CHUNK // (3 * run.size * (simulated.touches or 1)))
    curves = np.empty((trials, run.n, 6))
    for start in range(0, trials, most):
        count = min(most, trials - start)
        curves[start:start + count] = simulated.refitted(simulated.readings(rng, count))
        if on_step:
            on_step(count)
    off = curves - made.fit.error_motions.values
    expected = made.combined(with_hidden=False)
    scatter = off - off.mean(axis=0)
    covariance = np.einsum('mia,mib->iab', scatter, scatter, optimize=True) / trials
    agreements = tuple(_agreement(off[:, :, place], expected[:, place]) for place in range(6))
    return MonteCarlo(trials, seed, off.std(axis=0), agreements, covariance, _reach(scatter, covariance))


def _reach(scatter: Floats, covariance: Floats) -> Floats:
    """Return the distances, in standard deviations, within which the six curves of a point lie together, (n,)."""
    unit = np.sqrt(np.maximum(np.einsum('iaa->ia', covariance), np.finfo(float).tiny))
    inverse = np.linalg.pinv(covariance / (unit[:, :, None] * unit[:, None, :]), hermitian=True)
    scaled = scatter / unit
    square = np.einsum('mia,iab,mib->mi', scaled, inverse, scaled, optimize=True)
    return np.asarray(np.sqrt(np.quantile(square, PROBABILITY, axis=0)))


def _agreement(off: Floats, expected: Floats) -> Agreement:
    """Return the Agreement of deviations (M, n) of one curve with its standard uncertainties (n,)."""
    mean = float(root_mean(expected[:, None])[0])
    if not mean:
        return Agreement(0.0, float(off.std()), 0.0, 0.0, 0.0, 0.0)
    ends, scaled = ((1 - PROBABILITY) / 2, (1 + PROBABILITY) / 2), off / expected * mean
    groups = np.array_split(scaled, GROUPS)
    is_enough = len(scaled) >= GROUPS * LEAST_GROUP
    scatter = np.std([np.quantile(one, ends) for one in groups], axis=0, ddof=1).max() / GROUPS**0.5 if (
        is_enough) else np.inf
    low, high = np.quantile(scaled, ends)
    return Agreement(mean, float(np.sqrt(np.mean(off.var(axis=0)))), float(low), float(high),
                     float(scatter), float(0.5 * 10.0**np.floor(np.log10(mean))))


class _SimulatedReadings:
    """What is drawn, and how readings follow from it; what stays the same in all trials."""

    def __init__(self, made: Budget) -> None:
        self.made, self.fit, run = made, made.fit, made.fit.run
        self.inputs, self.run = made.inputs, run
        self.place = run.centre - self.fit.residual  # where the model has each ball, (N, 3)
        curves = self.fit.error_motions.values[run.table_position - 1]
        self.body = rotation_matrix(curves[:, 3:])  # (N, 3, 3)
        self.spoke, self.angle = radial(run.beta), run.phi + run.angle_deviation
        self.ball = run.radius * self.spoke + self.fit.plate[run.ball - 1]
        self.course, self.is_recorded = temperature_course(run)
        self.basis, self.touches = None, 0
        is_touched = made.touch is not None and self.fit.joint.whitening.by_axis
        if is_touched or 'ball_form' in self.inputs:
            self.direction = form_directions(self.inputs, made.touch)
            self.touches = len(self.direction)
            self.basis = form_basis(rotate_z(-run.phi[:, None], self.direction[None]))
        self.touch_sigma = made.touch.sigma if made.touch and is_touched else 0.0
        self.rest = np.sqrt(1 - made.touch_share) if self.touch_sigma else np.ones(3)
        self.nominal = run.centre - observed(run)
        fit = self.fit
        self.of_fit = beyond_linear(run, fit.mean_radius, BaseParameters(
            fit.error_motions.values[None], fit.plate[None], fit.cmm[None]))

    def readings(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the ball centres of `count` runs in the table frame as it is found, (B, N, 3), m."""
        made, run, inputs = self.made, self.run, self.inputs
        noise = made.sigma * _student(rng, made.dof, count) * self.rest * self.fit.joint.whitening.inverse(
            rng.standard_normal((count, run.size, 3)))
        centre = self.place + self._grown(rng, count)
        if 'frame_expansion' in inputs:
            motion = self._drawn(rng, 'frame_expansion', 'u_um_per_K', (count, 1, 3))
            centre = centre + motion * self._change(rng, count, 'frame_expansion')
        if self.touches:
            centre = self._touched(rng, centre, count)
        return self._seen(rng, centre + noise)

    def _drawn(self, rng: np.random.Generator, section: str, entry: str, shape: tuple[int, int, int]) -> Floats:
        """Return values of a standard uncertainty, drawn for each trial, in SI units."""
        factor = _student(rng, self.inputs.dof.get(section, np.inf), shape[0])
        return np.asarray(self.inputs.value(section, entry) * factor * rng.standard_normal(shape))

    def _change(self, rng: np.random.Generator, count: int, section: str) -> Floats:
        """Return the course of the temperature in each trial, (B or 1, N, 1), K."""
        if self.is_recorded:
            return self.course[None, :, None]
        size = self.inputs.value(section, 'range_K')
        return np.asarray(rng.uniform(-size, size, (count, 1, 1)) * self.course[None, :, None])

    def _grown(self, rng: np.random.Generator, count: int) -> Floats:
        """Return how growth and another radius of the plate move the balls, (B or 1, N, 3), m.

        The CMM shows the radius that it showed: its radial deviation takes up what the plate has more."""
        inputs, off = self.inputs, np.zeros((1, self.run.size, 3))
        if 'plate_expansion' in inputs:
            known = inputs.value('plate_expansion', 'coefficient_um_per_m_K')
            each = self._drawn(rng, 'plate_expansion', 'u_um_per_m_K', (count, 1, 1))
            each = each + known * (rng.standard_normal((count, 1, 1)) if self.is_recorded else 1.0)
            grown = each * self._change(rng, count, 'plate_expansion') * (self.ball * np.array([1.0, 1.0, 0.0]))
            off = off + self._carried(grown)
        if 'radius' in inputs:
            more = self._drawn(rng, 'radius', 'u_um', (count, 1, 1))
            off = off + self._carried(more * self.spoke) - more * radial(self.run.alpha)
        return off

    def _carried(self, on_plate: Floats) -> Floats:
        """Return displacements on the plate (B, N, 3) as the turning table with its errors carries them."""
        return np.asarray(np.einsum('nij,bnj->bni', self.body, rotate_z(self.angle, on_plate)))

    def _touched(self, rng: np.random.Generator, centre: Floats, count: int) -> Floats:
        """Return the centres of spheres through the touches of balls of random form, (B, N, 3), m."""
        run = self.run
        height = np.zeros((count, run.size, self.touches))
        if 'ball_form' in self.inputs and self.basis is not None:
            size = standard_height(self.inputs.value('ball_form', 'form_um'))
            drawn = size * rng.standard_normal((count, run.n, self.basis.shape[-1]))
            height = np.einsum('nqh,bnh->bnq', self.basis, drawn[:, run.ball - 1])
        if self.touch_sigma:
            height = height + self.touch_sigma * rng.standard_normal(height.shape)
        points = (REACH + height)[..., None] * self.direction
        found = fit_spheres(points.reshape(-1, self.touches, 3), 1).centre.reshape(count, run.size, 3)
        return np.asarray(centre + found)

    def _seen(self, rng: np.random.Generator, centre: Floats) -> Floats:
        """Return centres (B, N, 3) in a table frame whose origin and axes are off: R'(p - o)."""
        if 'alignment' not in self.inputs:
            return centre
        count, value = len(centre), self.inputs.value
        factor = _student(rng, self.inputs.dof.get('alignment', np.inf), count)[:, 0]
        size = np.array([value('alignment', name) for name in ('tilt_urad', 'tilt_urad', 'azimuth_urad')])
        turned = rotation_matrix(factor * size * rng.standard_normal((count, 3)))
        origin = factor * value('alignment', 'origin_um') * rng.standard_normal((count, 3))
        return np.asarray((centre - origin[:, None]) @ turned)

    def refitted(self, centre: Floats) -> Floats:
        """Return the curves of runs (B, N, 3), (B, n, 6): second-order terms included, all parameters fitted anew."""
        y, fit = centre - self.nominal, self.fit
        offset = np.broadcast_to(fit.beyond, (len(y), *fit.beyond.shape)) if 'alignment' not in self.inputs else (
            self._second_order(y))
        return fit.joint.curves(y - offset)

    def _second_order(self, y: Floats) -> Floats:
        """Return the second-order terms of displacements (B, N, 3), m: those of the fit, and how they change."""
        run, fit, offset = self.run, self.fit, np.broadcast_to(self.fit.beyond, y.shape)
        effects = sum((one.displacement for one in fit.effects), start=np.zeros(3))
        for _ in range(STEPS):
            found = fit.joint.space.described(y - offset - effects)[0]
            offset = fit.beyond + beyond_linear(run, fit.mean_radius, found) - self.of_fit
        return offset


def _student(rng: np.random.Generator, dof: float, count: int) -> Floats:
    """Return factors (B, 1, 1) that make normal numbers those of Student's distribution (GUM S1, 6.4.9)."""
    if not np.isfinite(dof):
        return np.ones((count, 1, 1))
    return np.asarray(np.sqrt(dof / rng.chisquare(dof, (count, 1, 1))))

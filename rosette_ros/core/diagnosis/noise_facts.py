# SPDX-License-Identifier: Apache-2.0
"""In what the noise of a run is other than white and equal."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rosette_ros.core.run.records import UNLIKELY, Floats

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.model.least_squares import Fit
    from rosette_ros.core.model.noise import Group

WANDERING = 0.85
"""Correlation from reading to reading above which noise is told as a wander of the frame."""
UNEQUAL = 1.3
"""Ratio of the noise of axes from which on it is told beside what is larger."""


@dataclass(frozen=True)
class NoiseFacts:
    """In what the noise of a run is other than white and equal.

    step, rounded: to which readings are rounded, m, where that is of account, and its share in the variance, which is
    known and no other noise; worse: axes that repeat worse than others, `than`, and how many times;
    scatter: then the standard deviations along x, y, z, m; tail, tail_dof: what stands out by itself, `reading` or
    `coordinate`, and degrees of freedom of its Student distribution; noisiest, factor: groups of which one scatters so
    many times as much as the others; walk: of the frame over the run, m; wander, readings: of the frame, m, within so
    many readings; correlation: of neighbouring readings.
    """

    step: float = 0.0
    rounded: float = 0.0
    worse: tuple[tuple[str, float], ...] = ()
    than: str = ''
    scatter: tuple[float, ...] = ()
    tail: str = ''
    tail_dof: float = 0.0
    noisiest: 'tuple[Group, ...]' = ()
    factor: float = 1.0
    walk: float = 0.0
    wander: float = 0.0
    readings: float = 0.0
    correlation: float = 0.0

    @property
    def is_correlated(self) -> bool:
        """Whether each reading depends on the one before it."""
        return bool(self.walk or self.wander or self.correlation)

    @property
    def is_other(self) -> bool:
        """Whether it is other than white and equal in anything but what the digits of the readings make of it."""
        return replace(self, step=0.0, rounded=0.0) != NoiseFacts()


def noise_facts(fit: 'Fit', is_moved: bool = False) -> NoiseFacts:
    """Return in what the noise of a fit is other than white and equal.

    is_moved: whether its residual has a motion without a name, which makes neighbouring readings alike in any noise.
    """
    noise, sigma, run = fit.noise, fit.sigma, fit.run
    size = (noise.axes**2 + noise.wander * (noise.phi < 1))**0.5
    worse, than = _unequal(size, bool(noise.wander.any()))
    scatter = tuple((sigma * size).tolist()) if worse else ()
    facts = NoiseFacts(fit.step, fit.rounded * bool(fit.step), worse, than, scatter, noise.tail,
                       noise.tail_dof if noise.tail else 0.0)
    if noise.by:
        typical = sorted(noise.factors)[noise.factors.size // 2]
        facts = replace(facts, noisiest=tuple(noise.noisiest(run)), factor=float(noise.factors.max() / typical))
    if noise.wander.any():
        axis = int(noise.wander.argmax())
        step, white = float(noise.wander[axis]), float(noise.axes[axis]**2)
        if noise.phi == 1:
            facts = replace(facts, walk=sigma * (step * run.size)**0.5)
        elif noise.phi > WANDERING:
            facts = replace(facts, wander=sigma * step**0.5, readings=1 / (1 - noise.phi))
        else:
            facts = replace(facts, correlation=noise.phi * step / (step + white))
    elif not (is_moved or fit.step) and fit.neighbours[1] < UNLIKELY:  # errors of rounding repeat as a coordinate does
        facts = replace(facts, correlation=fit.neighbours[0])
    return facts


def _unequal(size: Floats, wanders: bool) -> tuple[tuple[tuple[str, float], ...], str]:
    """Return which axes repeat worse, how many times, and than which; size: of the noise along x, y, z."""
    x, y, z = map(float, size)
    if x == y:
        if z == x or (wanders and max(z / x, x / z) < UNEQUAL):
            return (), ''
        return ((('z', z / x),), 'xy') if z > x else ((('xy', x / z),), 'z')
    best, *others = size.argsort().tolist()
    worse = sorted(place for place in others if place == others[-1] or size[place] >= UNEQUAL * size[best])
    return tuple(('xyz'[place], float(size[place] / size[best])) for place in worse), 'xyz'[best]

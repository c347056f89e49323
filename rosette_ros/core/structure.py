# SPDX-License-Identifier: Apache-2.0
"""Shapes without a physical name, for what no named effect explains.

They compete with the named effects in the same search. One that wins is never claimed as a cause: it
says in words what the residual depends on.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import Effect, Quantity, Setting, duration, seconds

IN_PLANE, AXIAL = 'x and y', 'z'
EVERYWHERE = 'x, y and z'
DIRECTIONS = {IN_PLANE: (0, 1), AXIAL: (2,)}
ALL_DIRECTIONS = {**DIRECTIONS, EVERYWHERE: (0, 1, 2), 'x': (0,), 'y': (1,)}
ANGLES = {'CMM position': 'alpha', 'table position': 'phi', 'ball': 'beta'}
HIGHEST = 8


def _spread(direction, scalars):
    """Return each of the scalars (m, N) along each axis of a direction, (N, 3, q)."""
    scalars = np.asarray(scalars)
    axes = ALL_DIRECTIONS[direction]
    out = np.zeros((scalars.shape[1], 3, len(axes), len(scalars)))
    for place, axis in enumerate(axes):
        out[:, axis, place] = scalars.T
    return out.reshape(len(out), 3, -1)


def _waves(angle, order):
    """Return cos and sin of an order, or cos alone where sin is zero everywhere."""
    c, s = np.cos(order * angle), np.sin(order * angle)
    return [c] if np.abs(s).max() < 1e-9 else [c, s]


@dataclass(frozen=True)
class Structure(Effect):
    """A shape without a physical name; `describe` says what it depends on."""

    def describe(self, setting):
        """Return what the shape depends on, in words."""
        raise NotImplementedError

    def scalars(self, run, setting):
        """Return what each axis of the direction follows, (m, N)."""
        raise NotImplementedError

    def width(self, run, setting):
        """Return the number of scalars times that of axes."""
        return len(ALL_DIRECTIONS[setting['direction']]) * len(self.scalars(run, setting))

    def amplitudes(self, run, setting):
        """Return unnamed amplitudes."""
        return tuple(Quantity(f'c{k + 1}', '', 'amplitude') for k in range(self.width(run, setting)))

    def columns(self, run, setting):
        """Return every scalar along every axis of the direction, (N, 3, q)."""
        return _spread(setting['direction'], self.scalars(run, setting))


@dataclass(frozen=True)
class CurvedTime(Structure):
    """A smooth curve in time, Legendre polynomials 2 to 6."""

    name: str = 'curve in time'
    depends_on: tuple[str, ...] = ('time',)

    def describe(self, setting):
        """Say: time."""
        return f'it changes with time along a curve, in {setting["direction"]}'

    def settings(self, run):
        """Try polynomials up to degree 2 ... 6 in each direction."""
        return tuple(Setting(direction=d, degree=k)
                     for d in ALL_DIRECTIONS for k in (2, 3, 4, 6))

    def scalars(self, run, setting):
        """Return Legendre polynomials of time, degrees 1 to `degree`."""
        u = 2 * seconds(run) / duration(run) - 1
        return np.polynomial.legendre.legvander(u, setting['degree'])[:, 1:].T


@dataclass(frozen=True)
class GrowingWave(Structure):
    """A wave around a circle that grows with time: t cos(m angle), t sin(m angle)."""

    name: str = 'wave that grows with time'
    depends_on: tuple[str, ...] = ('time',)

    def describe(self, setting):
        """Say: product of time and position."""
        return (f'it is a product of time and {setting["of"]} ({setting["order"]} waves per turn), '
                f'in {setting["direction"]}')

    def settings(self, run):
        """Try every angle and order that no named effect has."""
        named = {('CMM position', 1, AXIAL), ('ball', 2, AXIAL), ('ball', 3, AXIAL)}
        return tuple(
            Setting(of=of, order=m, direction=d)
            for of in ANGLES for m in range(1, min(run.n // 2, HIGHEST) + 1) for d in DIRECTIONS
            if (of, m, d) not in named)

    def scalars(self, run, setting):
        """Return t times cosine and sine."""
        angle = getattr(run, ANGLES[setting['of']])
        u = seconds(run) / duration(run) - 0.5
        return [u * w for w in _waves(angle, setting['order'])]


@dataclass(frozen=True)
class ProductWave(Structure):
    """A wave in table position times a wave in CMM position, off the base model's lines."""

    name: str = 'product of table and CMM position'

    def describe(self, setting):
        """Say: product of two positions."""
        return (f'it is a product of table position ({setting["p"]} waves) and CMM position '
                f'({setting["q"]} waves), in {setting["direction"]}')

    def settings(self, run):
        """Try all products of low orders."""
        top = min((run.n - 1) // 2, 5)
        return tuple(Setting(p=p, q=q, direction=d) for d in DIRECTIONS
                     for p in range(1, top + 1) for q in range(-top, top + 1) if q)

    def scalars(self, run, setting):
        """Return cos and sin of p phi + q alpha."""
        return _waves(setting['p'] * run.phi + setting['q'] * run.alpha, 1)


@dataclass(frozen=True)
class ApproachWave(Structure):
    """A reversal that depends on the angle."""

    name: str = 'reversal that depends on the angle'
    depends_on: tuple[str, ...] = ('approach',)

    def describe(self, setting):
        """Say: sense of the table move."""
        return f'it depends on the sense of the last table move, in {setting["direction"]}'

    def settings(self, run):
        """Try orders 0 to 3."""
        return tuple(Setting(direction=d, order=m) for d in DIRECTIONS for m in range(4))

    def scalars(self, run, setting):
        """Return approach times cosine and sine of alpha."""
        return [run.approach * w for w in _waves(run.alpha, setting['order'])]


@dataclass(frozen=True)
class CurvedTemperature(Structure):
    """A curve in temperature: powers 2 and 3."""

    name: str = 'curve in temperature'
    depends_on: tuple[str, ...] = ('temperature',)

    def describe(self, setting):
        """Say: temperature."""
        return f'it follows the temperature along a curve, in {setting["direction"]}'

    def settings(self, run):
        """Try each direction, where the temperature changes."""
        if np.ptp(run.temperature) == 0:
            return ()
        return tuple(Setting(direction=d) for d in ALL_DIRECTIONS)

    def scalars(self, run, setting):
        """Return powers 1 to 3 of the temperature, scaled to [-1, 1]."""
        low, high = run.temperature.min(), run.temperature.max()
        u = (2 * run.temperature - low - high) / (high - low)
        return [u, u**2, u**3]


STRUCTURES = (CurvedTime(), GrowingWave(), ProductWave(), ApproachWave(), CurvedTemperature())

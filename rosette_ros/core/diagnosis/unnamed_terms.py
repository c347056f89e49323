# SPDX-License-Identifier: Apache-2.0
"""Shapes without a physical name, for what no named effect explains.

They compete with the named effects in the same search. One that wins is never claimed as a cause: it states in words
what the residual depends on.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from rosette_ros.core.effects.effect import Effect, Quantity, Setting
from rosette_ros.core.effects.run_functions import duration, seconds
from rosette_ros.core.records import Floats, Run

DIRECTIONS = {'x and y': (0, 1), 'z': (2,)}
ALL_DIRECTIONS = {**DIRECTIONS, 'x, y and z': (0, 1, 2), 'x': (0,), 'y': (1,)}
ANGLES = {'CMM position': 'alpha', 'table position': 'phi', 'ball': 'beta'}
HIGHEST = 8


class UnnamedTerm(Effect):
    """A shape without a physical name: scalars of the reading along every axis of a direction.

    dependence: what it depends on, with the values of a setting in braces; grid: the settings to try; scalars: what
    each axis of the direction follows, (m, N).
    """

    def __init__(self, name: str, dependence: str, grid: Callable[[Run], Iterable[Setting]],
                 scalars: Callable[[Run, Setting], Sequence[Floats]], depends_on: tuple[str, ...] = ()) -> None:
        self.name, self.dependence, self.depends_on = name, dependence, depends_on
        self.grid, self.scalars = grid, scalars

    def describe(self, setting: Setting) -> str:
        """Return what the shape depends on, in words."""
        return f'{self.dependence}, in {{direction}}'.format(**setting).replace('(-', '(−')

    def settings(self, run: Run) -> tuple[Setting, ...]:
        return tuple(self.grid(run))

    def width(self, run: Run, setting: Setting) -> int:
        return len(ALL_DIRECTIONS[setting.word('direction')]) * len(self.scalars(run, setting))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(Quantity(f'c{k + 1}', '', 'amplitude') for k in range(self.width(run, setting)))

    def columns(self, run: Run, setting: Setting) -> Floats:
        """Return every scalar along every axis of the direction, (N, 3, q)."""
        scalars = np.asarray(self.scalars(run, setting))
        axes = ALL_DIRECTIONS[setting.word('direction')]
        out = np.zeros((run.size, 3, len(axes), len(scalars)))
        for place, axis in enumerate(axes):
            out[:, axis, place] = scalars.T
        return out.reshape(run.size, 3, -1)


def _waves(angle: Floats, order: int) -> list[Floats]:
    """Return cos and sin of an order, or cos alone where sin is zero everywhere."""
    c, s = np.cos(order * angle), np.sin(order * angle)
    return [c] if np.abs(s).max() < 1e-9 else [c, s]


def _curved_time(run: Run, setting: Setting) -> list[Floats]:
    """Return Legendre polynomials of time, degrees 1 to `degree`."""
    u = 2 * seconds(run) / duration(run) - 1
    return list(np.polynomial.legendre.legvander(u, setting.whole('degree'))[:, 1:].T)


def _growing_waves(run: Run) -> Iterable[Setting]:
    """Return every angle and order that no named effect has."""
    named = {('CMM position', 1, 'z'), ('ball', 2, 'z'), ('ball', 3, 'z')}
    return (Setting(of=of, order=m, direction=d) for of in ANGLES for m in range(1, min(run.n // 2, HIGHEST) + 1)
            for d in DIRECTIONS if (of, m, d) not in named)


def _growing_wave(run: Run, setting: Setting) -> list[Floats]:
    """Return t cos(m angle) and t sin(m angle)."""
    u = seconds(run) / duration(run) - 0.5
    return [u * wave for wave in _waves(getattr(run, ANGLES[setting.word('of')]), setting.whole('order'))]


def _product_waves(run: Run) -> Iterable[Setting]:
    """Return all products of low orders, off the base model's lines."""
    top = min((run.n - 1) // 2, 5)
    return (Setting(p=p, q=q, direction=d) for d in DIRECTIONS
            for p in range(1, top + 1) for q in range(-top, top + 1) if q)


def _curved_temperature(run: Run, setting: Setting) -> list[Floats]:
    """Return powers 1 to 3 of the temperature, scaled to [-1, 1]."""
    low, high = run.temperature.min(), run.temperature.max()
    u = (2 * run.temperature - low - high) / (high - low)
    return [u, u**2, u**3]


UNNAMED_TERMS = (
    UnnamedTerm('curve in time', 'it changes with time along a curve',
                lambda run: (Setting(direction=d, degree=k) for d in ALL_DIRECTIONS for k in (2, 3, 4, 6)),
                _curved_time, ('time',)),
    UnnamedTerm('wave that grows with time', 'it is a product of time and {of} ({order} waves per turn)',
                _growing_waves, _growing_wave, ('time',)),
    UnnamedTerm('product of table and CMM position',
                'it is a product of table position ({p} waves) and CMM position ({q} waves)', _product_waves,
                lambda run, setting: _waves(setting.whole('p') * run.phi + setting.whole('q') * run.alpha, 1)),
    UnnamedTerm('reversal that depends on the angle', 'it depends on the sense of the last table move',
                lambda run: (Setting(direction=d, order=m) for d in DIRECTIONS for m in range(4)),
                lambda run, setting: [run.approach * wave for wave in _waves(run.alpha, setting.whole('order'))],
                ('approach',)),
    UnnamedTerm('curve in temperature', 'it follows the temperature along a curve',
                lambda run: (Setting(direction=d) for d in ALL_DIRECTIONS if np.ptp(run.temperature) > 0),
                _curved_temperature, ('temperature',)))

# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement can show: visible share, bias on the curves, smallest amplitude.

For an effect with columns D the visible part is D_perp = D - Q Q' D; what is not visible is taken up by plate and CMM,
harmlessly, or by the table, as a bias on the six curves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rosette_ros.core.diagnosis.candidates import HIDDEN_SHARE, families, why_not_judged
from rosette_ros.core.diagnosis.projection import Projection
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.model.base_model import BaseSpace
from rosette_ros.core.model.base_space import base_space
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.records import Floats, Run

DETECTABLE = 6.0
"""Norm of the visible part, in sigma, that the search finds nearly always."""
SAME_SHAPE = 0.95


@dataclass(frozen=True, eq=False)
class Share:
    """The visible share of one effect on a run.

    share: of its best setting; typical_share: median over its settings; setting: the typical one; reason: why the
    effect cannot be judged at all, empty where it can.
    """

    name: str
    share: float
    typical_share: float
    setting: Setting
    reason: str

    @property
    def hidden(self) -> bool:
        """Whether this order hides the effect."""
        return not self.reason and self.share < HIDDEN_SHARE


@dataclass(frozen=True, eq=False)
class Visibility(Share):
    """What a run shows of one effect.

    bias: (6,) largest change of each curve, m or rad, for an effect that moves the balls by one metre rms; detectable:
    rms displacement of the balls that is found nearly always, m, inf where hidden; alike: effects whose visible part
    has the same shape.
    """

    bias: Floats
    detectable: float
    alike: tuple[str, ...] = ()


def visibility(run: Run, sigma: float = 1e-7, terms: tuple[str, ...] = BASE_TERMS,
               names: Sequence[str] = ()) -> tuple[Visibility, ...]:
    """Return the Visibility of every effect of the library on a run.

    Only indices, angles, times, temperatures and senses of the run count, not the ball centres. sigma: standard
    deviation of a coordinate, m; terms: of the base model; names: of the effects to look at, all if none.
    """
    return tuple(replace(entry, detectable=sigma * entry.detectable)
                 for entry in _of_unit_noise(run, tuple(terms), tuple(names)))


@lru_cache(maxsize=64)
def visible_shares(run: Run, terms: tuple[str, ...] = BASE_TERMS, names: tuple[str, ...] = ()) -> tuple[Share, ...]:
    """Return the Share of effects; arguments as of `visibility`. Runs of one cell are compared with the same plans."""
    project = Projection(base_space(run, run.radius, terms), run.size)
    out = []
    for name, effect in effects_of(run).items():
        if names and name not in names:
            continue
        if reason := why_not_judged(effect, run):
            out.append(Share(name, 0.0, 0.0, Setting(), reason))
            continue
        every = sorted(((setting, float(share)) for family in families(run, (effect,), project, keep_hidden=True)
                        for setting, share in zip(family.settings, family.shares)), key=lambda pair: pair[1])
        setting, share = every[len(every) // 2]
        out.append(Share(name, every[-1][1], share, setting, ''))
    return tuple(out)


@lru_cache(maxsize=64)
def _of_unit_noise(run: Run, terms: tuple[str, ...], names: tuple[str, ...]) -> tuple[Visibility, ...]:
    """Return the Visibility of effects for sigma = 1 m."""
    space, effects = base_space(run, run.radius, terms), effects_of(run)
    out, shapes = [], {}
    for one in visible_shares(run, terms, names):
        bias, detectable = np.zeros(6), np.inf
        if not one.reason:
            bias, detectable, shapes[one.name] = _consequences(run, effects[one.name], one.setting, space)
        out.append(Visibility(**vars(one), bias=bias, detectable=detectable))
    return tuple(replace(entry, alike=_alike(entry, shapes)) for entry in out)


def _consequences(run: Run, effect: Effect, setting: Setting, space: BaseSpace) -> tuple[Floats, float, Floats]:
    """Return bias on the curves per metre rms, detectable rms size per sigma, and visible directions."""
    columns = np.moveaxis(effect.columns(run, setting), -1, 0)
    columns = columns - columns.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean(np.sum(columns**2, axis=2), axis=1))
    columns = columns[size > 0] / size[size > 0][:, None, None]
    if not len(columns):
        return np.zeros(6), np.inf, np.zeros((0, 3 * run.size))
    bias: Floats = np.abs(space.parameters(columns).curves).max(axis=(0, 1))
    visible = space.residual(columns).reshape(len(columns), -1)
    singular, rows = np.linalg.svd(visible, full_matrices=False)[1:]
    weakest = np.linalg.norm(visible, axis=1).max()
    detectable = DETECTABLE / weakest if weakest > 1e-6 else np.inf
    return bias, float(detectable), rows[singular > 1e-3 * max(singular[0], 1e-12)]


def _alike(entry: Visibility, shapes: dict[str, Floats]) -> tuple[str, ...]:
    """Return the effects that can displace the balls as another one can: by the largest principal cosine."""
    own = shapes.get(entry.name)
    if own is None or not len(own) or entry.hidden:
        return ()
    return tuple(name for name, rows in shapes.items() if name != entry.name and _reaches(own @ rows.T, SAME_SHAPE))


def _reaches(product: Floats, least: float) -> bool:
    """Return whether the largest singular value is above `least`; it is at most the root of the sum of squares."""
    return bool(product.size and np.vdot(product, product) > least**2 and np.linalg.norm(product, 2) > least)

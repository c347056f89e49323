# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement can show: sensitivity, bias on the curves, smallest amplitude.

For an effect with columns D what is not absorbed is D_perp = D - Q Q' D; the rest is taken up by plate and CMM,
harmlessly, or by the table, as a bias on the six curves.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.effects.library import effects_of
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.sight.bank import Bank, CauseFamily, CoordinateSpace, why_not_judged
from rosette_ros.core.sight.limits import ALIKE, DETECTABLE

GOOD_SHARE = 0.3
"""Sensitivity from which an order shows an effect well."""
MOST_CHOICES = 60
"""Choices of an effect, such as the reading that is wrong, whose bias on the curves is looked at."""


@dataclass(frozen=True, eq=False)
class Share:
    """The sensitivity of one effect on a run.

    share: of its best setting; typical_share: median over its settings; setting: the typical one; of_choices: the
    typical one of each choice (of axes, ball ...), of many every second or so; reason: why the effect cannot be judged
    at all, empty where it can.
    """

    name: str
    share: float
    typical_share: float
    setting: Setting
    of_choices: tuple[Setting, ...]
    reason: str

    @property
    def hidden(self) -> bool:
        """Whether this order hides the effect."""
        return not self.reason and self.share < HIDDEN_SHARE


@dataclass(frozen=True, eq=False)
class Visibility(Share):
    """What a run shows of one effect.

    bias: (6,) largest change of each curve, m or rad, by an amplitude of any choice that moves the balls by one metre
    rms; detectable: rms displacement of the balls, by the amplitude that is seen best, that is found nearly always, m,
    inf where hidden; alike: effects of which the same shape is left.
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


def visible_shares(run: Run, terms: tuple[str, ...] = BASE_TERMS, names: tuple[str, ...] = ()) -> tuple[Share, ...]:
    """Return the Share of effects; arguments as of `visibility`."""
    return tuple(visible_share(run, name, terms) for name in effects_of(run) if not names or name in names)


def strongest_first(run: Run, names: Sequence[str], terms: tuple[str, ...] = BASE_TERMS) -> tuple[str, ...]:
    """Return effects of one size by what they do to the curves of a run, at a ball, the largest bias first.

    Effects of one bias, to a millionth of what moves the balls, stay in the order of the library."""
    if not names:
        return ()
    bias = {one.name: float(np.max(one.bias * np.repeat([1.0, run.radius], 3)))
            for one in _of_unit_noise(run, tuple(terms), tuple(names))}
    return tuple(sorted(names, key=lambda name: -round(bias[name], 6)))


@lru_cache(maxsize=4096)
def visible_share(run: Run, name: str, terms: tuple[str, ...] = BASE_TERMS) -> Share:
    """Return the Share of one effect. Runs of one cell are compared with the same plans, so it is kept."""
    effect = effects_of(run)[name]
    if reason := why_not_judged(effect, run):
        return Share(name, 0.0, 0.0, Setting(), (), reason)
    settings, space = effect.settings(run), _space(run, terms)
    bank = Bank(run, [CauseFamily(effect, name, settings)])
    every = list(zip(settings, bank.shares(bank.left(space))[0].tolist()))
    setting, share = _typical(every)
    choices = [one.name for one in effect.searched if one.kind == 'choice']
    alike = defaultdict[tuple[object, ...], list[tuple[Setting, float]]](list)
    for one in every:
        alike[tuple([one[0].get(name) for name in choices])].append(one)
    typical = tuple(_typical(some)[0] for some in alike.values())
    best = max(share for _, share in every)
    return Share(name, best, share, setting, typical[::-(-len(typical) // MOST_CHOICES)], '')


@lru_cache(maxsize=1)
def _space(run: Run, terms: tuple[str, ...]) -> CoordinateSpace:
    """Return the space of the base model; of the run that is looked at now only."""
    return CoordinateSpace(BaseSpace(run, run.radius, terms), np.zeros((0, run.size, 3)))


def _typical(every: Sequence[tuple[Setting, float]]) -> tuple[Setting, float]:
    """Return the first setting of the median share, and that share."""
    median = sorted(share for _, share in every)[len(every) // 2]
    return next(setting for setting, share in every if is_same_share(share, median)), median


def is_same_share(one: float, other: float) -> bool:
    """Return whether the squares of two shares are equal to half the digits of the columns, which are single.

    What lies nearer together is in another order on each kind of processor."""
    return bool(abs(one**2 - other**2) < np.sqrt(np.finfo(np.float32).eps))


@lru_cache(maxsize=64)
def _of_unit_noise(run: Run, terms: tuple[str, ...], names: tuple[str, ...]) -> tuple[Visibility, ...]:
    """Return the Visibility of effects for sigma = 1 m."""
    space, effects = BaseSpace(run, run.radius, terms), effects_of(run)
    out, shapes = [], {}
    for one in visible_shares(run, terms, names):
        bias, detectable = np.zeros(6), np.inf
        if not one.reason:
            bias = _bias(run, effects[one.name], one.of_choices, space)
            detectable, shapes[one.name] = _visible_part(run, effects[one.name], one.setting, space)
        out.append(Visibility(**vars(one), bias=bias, detectable=detectable))
    return tuple(replace(entry, alike=_alike(entry, shapes)) for entry in out)


def _of_unit_size(columns: Floats) -> Floats:
    """Return columns (q, N, 3) less their means that move the balls by one metre rms, without those that do not."""
    columns = columns - columns.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean(np.sum(columns**2, axis=2), axis=1))
    return np.asarray(columns[size > 0] / size[size > 0][:, None, None])


def _bias(run: Run, effect: Effect, settings: Sequence[Setting], space: BaseSpace) -> Floats:
    """Return the largest change of each curve, (6,), by a column of unit size."""
    columns = np.concatenate([np.moveaxis(effect.columns(run, setting), -1, 0) for setting in settings])
    columns = _of_unit_size(columns)
    return np.abs(space.described(columns)[0].curves).max(axis=(0, 1)) if len(columns) else np.zeros(6)


def _visible_part(run: Run, effect: Effect, setting: Setting, space: BaseSpace) -> tuple[float, Floats]:
    """Return the detectable rms size per sigma of a setting, and its visible directions."""
    columns = _of_unit_size(np.moveaxis(effect.columns(run, setting), -1, 0))
    if not len(columns):
        return np.inf, np.zeros((0, 3 * run.size))
    visible = space.residual(columns).reshape(len(columns), -1)
    singular, rows = np.linalg.svd(visible, full_matrices=False)[1:]
    best_seen = np.linalg.norm(visible, axis=1).max()
    detectable = DETECTABLE / best_seen if best_seen > 1e-6 else np.inf
    return float(detectable), rows[singular > 1e-3 * max(singular[0], 1e-12)]


def _alike(entry: Visibility, shapes: dict[str, Floats]) -> tuple[str, ...]:
    """Return the effects that can displace the balls as another one can: by the largest principal cosine."""
    own = shapes.get(entry.name)
    if own is None or not len(own) or entry.hidden:
        return ()
    return tuple(name for name, rows in shapes.items() if name != entry.name and _reaches(own @ rows.T, ALIKE**0.5))


def _reaches(product: Floats, least: float) -> bool:
    """Return whether the largest singular value is above `least`; it is at most the root of the sum of squares."""
    return bool(product.size and np.vdot(product, product) > least**2 and np.linalg.norm(product, 2) > least)

# SPDX-License-Identifier: Apache-2.0
"""What the simulated machine can hide: physics of its own, to be found by the diagnosis alone."""

from typing import TYPE_CHECKING, Annotated, Literal, Self, Union

import numpy as np
from pydantic import Field, model_validator

from rosette_ros.simulation.hidden.hidden_effect import Draw, HiddenEffect, Situation, acting
from rosette_ros.simulation.hidden.hidden_kinds import KINDS, NAMED
from rosette_ros.simulation.setting_types import Positive, Seed, Settings

if TYPE_CHECKING:
    AnyHidden = HiddenEffect
    KindName = str
else:
    AnyHidden = Annotated[Union[tuple(KINDS.values())], Field(discriminator='kind')]  # noqa: UP007
    KindName = Literal[tuple(KINDS)]
HiddenList = Annotated[tuple[AnyHidden, ...], Field(strict=False, max_length=100)]


class HiddenDraw(Settings):
    """The order `hidden: {seed: N, ...}`: number, kinds and sizes of the effects to draw.

    Sizes are drawn evenly on a logarithmic scale between `smallest_sigma` and `largest_sigma` times the repeatability
    (0.1 um where that is zero). `readings_before`: number of readings before the run, so that steps fall into it
    (default: repeatability check and alignment).
    """

    seed: Seed
    kinds: Annotated[tuple[KindName, ...], Field(strict=False)] = ()
    fewest: Annotated[int, Field(ge=0, le=10)] = 1
    most: Annotated[int, Field(ge=0, le=10)] = 3
    smallest_sigma: Positive = 0.3
    largest_sigma: Positive = 30.0
    readings_before: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode='after')
    def _ordered(self) -> Self:
        if self.fewest > self.most:
            raise ValueError(f'fewest: wanted at most most = {self.most}, got {self.fewest}')
        if self.smallest_sigma > self.largest_sigma:
            raise ValueError(f'smallest_sigma: wanted at most largest_sigma = {self.largest_sigma:g}, '
                             f'got {self.smallest_sigma:g}')
        return self


def draw_hidden(order: HiddenDraw, situation: Situation) -> tuple[HiddenEffect, ...]:
    """Return effects that show in a situation, each kind at most once; the same for the same seed."""
    classes = [KINDS[kind] for kind in order.kinds or NAMED]
    rng = np.random.default_rng([order.seed, 0x61])
    most = min(order.most, len(classes))
    count = int(rng.integers(min(order.fewest, most), most + 1))
    chosen = rng.permutation(len(classes))[:count]
    low, high = np.log(order.smallest_sigma), np.log(order.largest_sigma)
    return tuple(classes[place].draw(Draw(rng, situation.scale_um * float(np.exp(rng.uniform(low, high))), situation))
                 for place in chosen)


__all__ = ['KINDS', 'NAMED', 'Draw', 'HiddenDraw', 'HiddenEffect', 'HiddenList', 'Situation', 'acting', 'draw_hidden']

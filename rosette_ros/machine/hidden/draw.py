# SPDX-License-Identifier: Apache-2.0
"""Draws hidden effects by lot: how many, which, how large, from below the noise to many sigma."""

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from rosette_ros.machine.settings import Positive, Seed, Settings


class HiddenDraw(Settings):
    """The order `hidden: {seed: N, ...}`.

    Sizes are drawn evenly on a logarithmic scale between `smallest_sigma` and `largest_sigma`
    times the repeatability (0.1 um where that is zero). `readings_before`: how many readings come
    before the run, so that steps fall into it (default: repeatability check and alignment).
    """

    seed: Seed
    kinds: Annotated[tuple[str, ...], Field(strict=False)] = ()
    fewest: Annotated[int, Field(ge=0, le=10)] = 1
    most: Annotated[int, Field(ge=0, le=10)] = 3
    smallest_sigma: Positive = 0.3
    largest_sigma: Positive = 30.0
    readings_before: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode='after')
    def _ordered(self):
        """Refuse ranges that run backwards."""
        if self.fewest > self.most:
            raise ValueError(f'fewest: wanted at most most = {self.most}, got {self.fewest}')
        if self.smallest_sigma > self.largest_sigma:
            raise ValueError('smallest_sigma: wanted at most largest_sigma = '
                             f'{self.largest_sigma:g}, got {self.smallest_sigma:g}')
        return self

    def drawn(self, classes, situation):
        """Return the drawn effects out of classes of hidden effects, each class at most once."""
        rng = np.random.default_rng([self.seed, 0x61])
        most = min(self.most, len(classes))
        count = int(rng.integers(min(self.fewest, most), most + 1))
        chosen = rng.permutation(len(classes))[:count]
        sigma_um = situation.sigma_um if situation.sigma_um > 0 else 0.1
        low, high = np.log(self.smallest_sigma), np.log(self.largest_sigma)
        return tuple(
            classes[place].draw(rng, sigma_um * float(np.exp(rng.uniform(low, high))), situation)
            for place in chosen)

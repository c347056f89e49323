# SPDX-License-Identifier: Apache-2.0
"""What earlier runs of a cell have taught: how often each of its causes is in a run."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class KnownCause:
    """A cause as earlier runs know it.

    name: of its law; rate: probability that a run of the cell has it; again: that it is a property of the cell;
    expected: number of runs that had it, judged: runs that say anything of it; size: m rms over all coordinates and the
    runs that had it, spread: standard deviation of its logarithm, NaN where none is known; constants: of its law, each
    with value and standard uncertainty, SI.
    """

    name: str
    rate: float
    again: float = 1.0
    expected: float = 0.0
    judged: int = 0
    size: float = float('nan')
    spread: float = float('nan')
    constants: tuple[tuple[str, float, float], ...] = ()

    @property
    def mean_square(self) -> float:
        """The expected square of its size in a run that has it, m^2: size^2 exp(2 spread^2), of few runs larger."""
        spread = self.spread if math.isfinite(self.spread) else 0.0
        return self.size**2 * math.exp(2 * spread**2)


@dataclass(frozen=True)
class Experience:
    """What earlier runs of a cell have taught.

    cell, table, cmm: name of the cell, serial numbers, empty where not stated; runs: how many; begin, end: days of the
    first and the last one; causes: those of which the cell makes another prior than any cell has.
    """

    causes: tuple[KnownCause, ...]
    cell: str = ''
    table: str = ''
    cmm: str = ''
    runs: int = 0
    begin: str = ''
    end: str = ''

    @cached_property
    def by_name(self) -> Mapping[str, KnownCause]:
        """The causes by their names."""
        return {one.name: one for one in self.causes}

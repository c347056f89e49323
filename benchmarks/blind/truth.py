# SPDX-License-Identifier: Apache-2.0
"""What is true of a run of the blind tests."""

from dataclasses import dataclass

from benchmarks.blind.cause import Names, Variables
from rosette_ros.core.run.records import Floats


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a run.

    hidden: names of the library; readings: of hidden outliers and of those of the noise, one-based; stray: the latter;
    right, part, family, body, variables: of a cause or of an effect left out, None for other runs; order: in which it
    was measured; share: visible, of each displacement; shift: what was hidden, (N, 3), m; curves: (n, 6), m and rad.
    """

    order: str
    hidden: Names
    readings: tuple[int, ...]
    stray: tuple[int, ...]
    shift: Floats
    curves: Floats
    share: tuple[float, ...] = ()
    right: Names = ()
    part: Names = ()
    family: Names = ()
    body: Names = ()
    variables: Variables | None = None

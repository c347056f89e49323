# SPDX-License-Identifier: Apache-2.0
"""Rows freed of a model: what the search for effects sees of a run and of simulated noise."""

from collections.abc import Callable
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import JointSpace
from rosette_ros.core.records import Ints

Reals = NDArray[np.floating[Any]]
"""Numbers in double precision, or in single where the search only compares."""
SMALL = 1000
"""Coordinates of a run up to which it is small."""
FEW = 32
"""Rows from which on single precision does."""


class Projection:
    """Rows (m, N, 3) freed of a model, in white coordinates; many rows of a small run in single precision.

    Single precision is for the search and simulated noise: the score of the best is computed anew in double precision.
    """

    def __init__(self, space: BaseSpace | JointSpace, size: int) -> None:
        self.basis, self.size, self.whitening = space.basis, size, space.whitening
        self._free = cast(Callable[[Reals], Reals], space.free)  # keeps the precision of its argument

    @cached_property
    def columns(self) -> Reals:
        """W' of the model's basis in single precision, (3 N, rank): what raw columns have of it."""
        return np.ascontiguousarray(self.adjoint(self.basis.rows).astype(np.float32).T)

    def adjoint(self, rows: Reals) -> Reals:
        """Return W' of white rows (m, 3 N): their products with raw columns are those of the whitened ones."""
        return self.whitening.adjoint(rows.reshape(len(rows), -1, 3)).reshape(len(rows), -1)

    def along(self, direction: Reals) -> tuple[Reals, Ints]:
        """Return what a unit along its direction (N, 3) at each reading has of the basis.

        As (N, some) in single precision and the numbers of these basis rows: the others have none.
        """
        basis = self.basis
        axial, plane = len(basis.axial), len(basis.axial) + len(basis.plane)
        direction = direction.astype(np.float32)
        parts, places = [], []
        columns = self.columns.reshape(self.size, 3, -1)
        for part, axes in ((slice(0, axial), (2,)), (slice(axial, plane), (0, 1)),
                           (slice(plane, basis.rank), (0, 1, 2))):
            used = [columns[:, axis, part] * direction[:, axis, None] for axis in axes if direction[:, axis].any()]
            if used:
                parts.append(sum(used[1:], used[0]))
                places.append(np.arange(part.start, part.stop))
        return np.concatenate(parts, axis=1), np.concatenate(places)

    def __call__(self, rows: Reals) -> Reals:
        """Return raw rows freed of the model, in white coordinates, same shape."""
        return self.free(self.whitening.apply(rows.astype(np.float32) if len(rows) >= FEW else rows))

    def free(self, rows: Reals) -> Reals:
        """Return white rows freed of the model, same shape."""
        if len(rows) >= FEW:
            rows = rows.astype(np.float32)
        return self.basis.residual(rows) if 3 * self.size <= SMALL else self._free(rows)

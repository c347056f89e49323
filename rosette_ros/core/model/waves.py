# SPDX-License-Identifier: Apache-2.0
"""Functions of the readings that columns are products of with directions; their sums by place need no column."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rosette_ros.core.model.noise import Real
from rosette_ros.core.run.records import Ints


@dataclass(frozen=True, eq=False)
class Waves:
    """Functions of the readings, (v, m, N), or (v, m, r) at the readings `at`, (v, r), beside which they are zero."""

    values: NDArray[np.floating[Any]]
    at: Ints | None = None

    @property
    def rows(self) -> int:
        """How many they are, v m."""
        return int(self.values.shape[0] * self.values.shape[1])

    def within(self, some: slice) -> 'Waves':
        """Return some of them."""
        return Waves(self.values[some], None if self.at is None else self.at[some])

    def times(self, right: NDArray[Real]) -> NDArray[Real]:
        """Return their products with something at each reading, (N, k), (v m, k), of its precision."""
        values = self.values.astype(right.dtype, copy=False)
        made = values.reshape(-1, len(right)) @ right if self.at is None else np.matmul(values, right[self.at])
        return np.asarray(made.reshape(self.rows, right.shape[1]))

    def sums(self, right: NDArray[np.float32], label: Ints, members: Ints) -> NDArray[np.float32]:
        """Return the same by label, of which there are n: (n, v m, k).

        right: (N + 1, k), 0 at the end; label: (N,) from 0; members: (n, r) readings of each, N where there are fewer.
        """
        if self.at is None:
            rows = self.values.reshape(-1, len(label))
            rows = np.concatenate([rows, np.zeros((len(rows), 1), rows.dtype)], axis=1)
            return np.asarray(np.matmul(rows.T[members].transpose(0, 2, 1), right[members]))
        (v, m, _), every = self.values.shape, np.arange(len(self.at))
        out = np.zeros((len(members), v, m, right.shape[1]), np.float32)
        for reading, value in zip(self.at.T, self.values.transpose(2, 0, 1)):
            out[label[reading], every] += value[:, :, None] * right[reading][:, None]
        return out.reshape(len(members), v * m, right.shape[1])

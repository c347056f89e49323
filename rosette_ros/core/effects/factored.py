# SPDX-License-Identifier: Apache-2.0
"""Effects that are functions of a reading times directions: what the search takes apart to be quick."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import Effect


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns of many settings as products w_vm(reading) e_d(reading).

    waves: (v, m, N); directions: (D, N, 3); of_setting: for each setting its v and the numbers d of
    its directions. Its columns are w_v1 e_d1, w_v1 e_d2 ... w_v2 e_d1 ...
    """

    waves: np.ndarray
    directions: np.ndarray
    of_setting: tuple[tuple[int, tuple[int, ...]], ...]


@dataclass(frozen=True)
class FactoredEffect(Effect):
    """An effect whose columns are f(reading; value) e(reading); subclasses give both factors."""

    def directions(self, run):
        """Return the directions in which the effect can act, (D, N, 3)."""
        raise NotImplementedError

    def which(self, setting):
        """Return the numbers of the directions in which a setting acts."""
        raise NotImplementedError

    def scalars(self, run, values):
        """Return the functions at each reading, (v, m, N).

        values: (v, 1) of the last searched parameter, zero where a setting has none.
        """
        raise NotImplementedError

    def factors(self, run, settings):
        """Return the Factors of many settings; each value is worked out once."""
        name = self.searched[-1].name if self.searched else ''
        every = [setting.get(name, 0.0) for setting in settings]
        every = [value if isinstance(value, (int, float)) else 0.0 for value in every]
        values = {value: place for place, value in enumerate(dict.fromkeys(every))}
        waves = self.scalars(run, np.array(list(values), dtype=float)[:, None])
        return Factors(waves, self.directions(run), tuple(
            (values[value], self.which(setting)) for value, setting in zip(every, settings)))

    def columns(self, run, setting):
        """Return each function along each direction, (N, 3, q)."""
        return np.moveaxis(self.blocks(run, [setting])[0], 0, -1)

    def blocks(self, run, settings):
        """Return the columns of settings that share their number of directions, (b, q, N, 3)."""
        factors = self.factors(run, settings)
        wave = np.array([place for place, _ in factors.of_setting])
        which = np.array([directions for _, directions in factors.of_setting])
        out = factors.waves[wave][:, :, None, :, None] * factors.directions[which][:, None]
        return out.reshape(len(settings), -1, run.size, 3)

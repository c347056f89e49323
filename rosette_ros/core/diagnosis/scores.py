# SPDX-License-Identifier: Apache-2.0
"""What candidates are worth beside a selection: the score of search.py for many blocks of columns at once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rosette_ros.core.diagnosis.candidates import NO_RESIDUAL, Family, products_of
from rosette_ros.core.diagnosis.projection import Projection, Reals
from rosette_ros.core.effects.effect import Effect
from rosette_ros.core.effects.free_forms import FreeForm
from rosette_ros.core.effects.library import OF_ANY_TABLE
from rosette_ros.core.records import Floats, Ints

UNNAMED_PRIOR = 10.0
"""An unnamed term must beat named effects by this score."""


def cost(energy: float | Floats, k: int | Ints) -> Floats:
    """Return the cost of k > 0 amplitudes of a square sum in sigma^2: k (1 + ln(energy / k)), or `energy` below k."""
    return np.where(energy > k, k * (1 + np.log(np.maximum(energy, k) / k)), energy)


def search_cost(effect: Effect, chances: float) -> float:
    """Return what the search of an effect with so many separate chances costs."""
    return float(2 * np.log(chances * OF_ANY_TABLE)) + UNNAMED_PRIOR * isinstance(effect, FreeForm)


@dataclass(frozen=True, eq=False)
class Group:
    """Families whose blocks have as many columns; those of all families one after the other. Each has a visible one."""

    families: tuple[Family, ...]

    @cached_property
    def _parts(self) -> tuple[Ints, Ints, Ints, Floats, Ints]:
        """Blocks by family and rank: their order, where each part begins, its rank and cost of the search, and where
        the parts of each family begin."""
        order, begins, ranks, costs, first = list[Ints](), list[int](), list[int](), list[float](), list[int]()
        size = offset = 0
        for family in self.families:
            first.append(len(begins))
            for rank in np.unique(family.ranks[family.ranks > 0]):
                places = np.flatnonzero(family.ranks == rank)
                order.append(places + offset)
                begins.append(size)
                ranks.append(int(rank))
                costs.append(search_cost(family.effect, family.chances))
                size += len(places)
            offset += len(family.ranks)
        return np.concatenate(order), np.array(begins), np.array(ranks), np.array(costs), np.array(first)

    def _scores(self, gain: Reals, rss: Floats, dof: int) -> Floats:
        """Return the best score gain of each part, (parts, m); of blocks of one rank that of the largest fall."""
        order, begins, ranks, costs, _ = self._parts
        fall = np.maximum.reduceat(gain[order], begins, axis=0).astype(float)
        rss = np.maximum(rss, NO_RESIDUAL)
        left = np.maximum(rss - fall, 1e-12 * rss)
        return np.asarray(dof * np.log(rss / left) - cost(fall * dof / left, ranks[:, None]) - costs[:, None])

    def best(self, gain: Reals, rss: float, dof: int) -> tuple[Floats, list[int]]:
        """Return the best score gain of each family and the number of its block.

        gain: (blocks,), the fall of the square sum rss, which has dof degrees of freedom, by each block.
        """
        order, begins, _, _, first = self._parts
        score = self._scores(gain[:, None], np.array([rss]), dof)[:, 0]
        ends, blocks, offset = [*begins[1:], len(order)], list[int](), 0
        for family, start, stop in zip(self.families, first, [*first[1:], len(begins)]):
            part = start + int(np.argmax(score[start:stop]))
            places = order[begins[part]:ends[part]]
            blocks.append(int(places[np.argmax(gain[places])]) - offset)
            offset += len(family.ranks)
        return np.maximum.reduceat(score, first), blocks

    def best_of_all(self, gain: Reals, rss: Floats, dof: int) -> Floats:
        """Return the best score gain of any family, (m,); gain: (blocks, m), the fall of square sums (m,)."""
        return np.asarray(self._scores(gain, rss, dof).max(axis=0))


def grouped(families: Sequence[Family]) -> tuple[Group, ...]:
    """Return families of which something is seen by their number of columns."""
    seen = [family for family in families if family.ranks.any()]
    return tuple(Group(tuple(family for family in seen if family.q == q)) for q in sorted({one.q for one in seen}))


def products_by_group(groups: Sequence[Group], rows: Reals, project: Projection) -> Iterator[tuple[Group, Reals]]:
    """Yield (group, U times white rows (m, 3 N)) with U as of candidates.py, for its blocks (blocks, q, m)."""
    every = [family for group in groups for family in group.families]
    by_bank = sorted(every, key=lambda family: id(family.bank))
    found = {id(family): products for family, products in products_of(by_bank, rows, project)}
    for group in groups:
        yield group, np.concatenate([found[id(family)] for family in group.families])

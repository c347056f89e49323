# SPDX-License-Identifier: Apache-2.0
"""The one score: the log evidence of a hypothesis about a run, members and noise together.

With y what the model leaves of the readings, m its degrees of freedom, and D_i the columns of member i, orthonormal in
the readings (of a free course: of the sizes of its process),

    y | H ~ N(0, sigma^2 [1 + sum_i tau_i^2 M D_i' D_i M]),   p(sigma) ~ 1 / sigma,   ln tau_i uniform over SIZES,

in white coordinates of the noise. Settings are uniform over their grid and summed over. The prior of a set of members
is a Poisson process, k of one family among k! orders, with the rates of core/sight/priors.py.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.columns import independent
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.run.records import Bools, Floats, Ints, Run
from rosette_ros.core.sight.bank import Bank, CauseFamily, CoordinateSpace, Key, Reals, columns_of, sensitivity
from rosette_ros.core.sight.linear_explanation import Solution, log_bayes_factor

Place = tuple[CauseFamily, Setting]
"""A family at a setting."""
NOISELESS = 1e-10
"""Noise, m, that no readings lack, and below which none is looked for: a tenth of a nanometre is negligible."""
MANY = 4
"""Columns over rows of members from which on these are the less work."""
ROUNDING = 1e-5
"""Square of the sensitivity to a direction below which single precision says nothing of it."""
NEAR = 9.0
"""Log evidence by which an estimate, on the grid or of a kind of noise, may be wrong: what is worse by more than this
is not looked at."""
ENOUGH = 0.1
"""Log evidence that another step of a search has to gain for one more to be tried."""
FURTHER = 32
"""Settings of a coarse grid among which another place to refine is looked for."""
SIZES = 2.0**np.arange(1, 15.25, 0.5)
"""Sizes of a member over sigma, the root of its square sum over all readings, that are summed over: from what can
hardly be seen to what a cell stops for."""


def log_mean(values: Floats) -> Floats:
    """Return the logarithm of the mean of exp of values along the last axis."""
    top = values.max(axis=-1, keepdims=True)
    return np.asarray(top[..., 0] + np.log(np.mean(np.exp(values - top), axis=-1)))


def of_sizes(gram: Reals, product: Reals, left: float, dof: int, sizes: Floats = SIZES) -> Floats:
    """Return the log Bayes factor of blocks for each size, (b, sizes), beside what leaves the square sum `left`.

    gram: (b, q, q), product: (b, q) of the blocks with themselves and with what is left.
    """
    value, vector = decomposed(gram)
    return beside(value, turned_by(vector, product[..., None])[..., 0], None, left, dof, sizes)


def decomposed(gram: Reals) -> tuple[Reals, Reals]:
    """Return eigenvalues (b, q) and eigenvectors (b, q, q) of products of blocks; hidden directions are zero."""
    value, vector = np.linalg.eigh(gram) if gram.shape[1] != 1 else (gram[:, 0], np.ones_like(gram))
    return np.maximum(value, 0), vector * (value > ROUNDING)[:, None]


def allowed(line: Floats, most: Reals | float) -> Floats:
    """Return log Bayes factors (b, sizes) for sizes of which none is above `most` (b,): the least one always is."""
    sizes = SIZES if line.shape[-1] == len(SIZES) else SIZES[::2]
    out = sizes > np.maximum(np.asarray(most)[..., None], sizes[0])
    return np.where(out, -np.inf, line + np.log(len(sizes) / np.sum(~out, axis=-1, keepdims=True)))


def turned_by(vector: Reals, rows: Reals) -> Reals:
    """Return the components (b, q, k) of products of blocks along their eigenvectors."""
    return np.asarray(vector.transpose(0, 2, 1) @ rows)


def within(value: Reals, fall: Reals, product: Reals, left: Reals) -> Reals:
    """Return the fall (b, sizes, k) of square sums `left` (k,) by blocks, no more than these have.

    The energies of what is left along the eigenvectors of a block, product^2 / value, are at most all of it: what is
    more is rounding in single precision."""
    energy = np.sum(product**2 / np.maximum(value, ROUNDING)[..., None] * (value > ROUNDING)[..., None], axis=1)
    return np.asarray(fall * np.minimum(left / np.maximum(energy, 1e-30), 1)[:, None])


def beside(value: Reals, product: Reals, across: Reals | None, left: float, dof: int, sizes: Floats) -> Floats:
    """Return the same as `of_sizes` of blocks of which the products are diag(value) - across across'.

    value, product: (b, q), the latter with what is left; across: (b, q, k), None for nothing. Woodbury's identity."""
    square = sizes**2
    grown = 1 + value[:, None] * square[:, None]
    shrunk = square[:, None] / grown
    log_det = np.log(grown).sum(axis=2, dtype=float)
    fall = within(value, (shrunk @ product[..., None]**2), product[..., None], np.array([left]))[..., 0]
    if across is not None:
        b, q, k = across.shape
        every = np.concatenate([across, product[..., None]], axis=2)
        both = (across[..., None] * every[:, :, None]).reshape(b, q, -1)
        # of what members leave, and products
        system = -(shrunk @ both).reshape(b, -1, k, k + 1).transpose(2, 3, 0, 1).astype(float)
        system[np.arange(k), np.arange(k)] += 1
        for j in range(k):  # elimination; a direction that nothing is left of is rounding
            pivot = np.maximum(system[j, j], ROUNDING)
            log_det += np.log(pivot)
            row = np.where(system[j, j] > ROUNDING, system[j], 0)
            fall = fall + row[k]**2 / pivot
            system[j + 1:, j + 1:] -= row[j + 1:k, None] / pivot * row[j + 1:]
    return log_bayes_factor(log_det, fall, left, dof)


@dataclass(eq=False)
class Member:
    """A family at a setting that is in a hypothesis, or may join one.

    volume: log of what the sum over all settings is worth over this one; gain: in log evidence where it may join, prior
    and all settings included; next: the best settings after this one, of families with several continuous parameters,
    of which the grid is coarse; size: the likeliest of SIZES.
    """

    evidence: 'Evidence'
    family: CauseFamily
    setting: Setting
    volume: float = 0.0
    gain: float = 0.0
    next: tuple[Setting, ...] = ()
    size: float = 16.0

    @cached_property
    def rows(self) -> Floats:
        """T M D of what the model leaves in white coordinates, (q, 3 N)."""
        run = self.evidence.run
        rows = self.evidence.space.residual(columns_of(self.family, run, self.setting))
        return rows.reshape(len(rows), 3 * run.size)

    @cached_property
    def most(self) -> float:
        """The largest size that physics allows."""
        most, run = self.family.effect.most(self.setting), self.evidence.run
        if np.isfinite(most):
            columns = self.family.effect.columns(run, self.setting)
            most *= float(np.sqrt(np.sum((columns - columns.mean(axis=0))**2, axis=(0, 1)).max())) / self.evidence.scale
        return most

    @property
    def sensitivity(self) -> float:
        """The share that the order shows of it."""
        return min(sensitivity(self.rows), 1.0)

    def at(self, setting: Setting) -> 'Member':
        """Return its family at another setting."""
        return self.evidence.member(self.family, setting, self.volume)

    def sized(self, size: float) -> 'Member':
        """Return the same of another size."""
        other = copy.copy(self)
        other.size = size
        return other

    @property
    def log_bf(self) -> float:
        """The log Bayes factor of its setting where it may join, all sizes included."""
        return self.gain - self.family.log_prior - self.volume

    @property
    def name(self) -> str:
        """The name of the effect, or the variables of a free course."""
        return self.family.name

    @property
    def place(self) -> Place:
        """The family and the setting."""
        return self.family, self.setting


@dataclass(frozen=True, eq=False)
class Blocks:
    """What a model leaves of the blocks of a group that are seen, (b,); number: of the setting in the bank.

    value, vector: (b, q), (b, q, q) of their products; product: (b, q) of vectors with what is left; most: (b,) largest
    size that physics allows.
    """

    seen: Ints
    number: Ints
    most: Floats
    value: Reals
    vector: Reals
    product: Reals

    def within(self, place: slice) -> 'Blocks':
        """Return those of a part of the group."""
        own = slice(*np.searchsorted(self.seen, (place.start, place.stop)).tolist())
        return Blocks(self.seen[own] - place.start, self.number[own], self.most[own], self.value[own],
                      self.vector[own], self.product[own])

    def log_bf(self, across: Reals | None, state: 'State') -> Floats:
        """Return the log Bayes factors of the blocks, all sizes included; across: their products with the members."""
        value, product, dof = self.value, self.product, state.evidence.dof
        if across is None:
            return log_mean(allowed(beside(value, product, None, state.left, dof, SIZES[::2]), self.most))
        used = turned_by(self.vector, across[self.seen]) @ state.root.astype(np.float32)
        product = product - used @ (state.root.T @ state.product).astype(np.float32)
        if MANY * used.shape[2] < value.shape[1]:
            return log_mean(allowed(beside(value, product, used, state.left, dof, SIZES[::2]), self.most))
        gram = value[:, None] * np.eye(value.shape[1], dtype=np.float32) - used @ used.transpose(0, 2, 1)
        return log_mean(allowed(of_sizes(gram, product, state.left, dof, SIZES[::2]), self.most))


Part = tuple[Ints, Blocks, Reals | None]
"""Numbers of settings in the bank, their Blocks, and the products of these with the members."""


class Evidence:
    """The readings of a run under a model and a noise, and the bank of candidates.

    y: (3 N,) what the model leaves, white, in units of its rms, or of the errors of rounding, where readings that are
    rounded alike leave less; dof: its degrees of freedom; total, least: its square sum, and that of the noise that no
    readings lack; shares: sensitivity to each block of each group of the bank.
    """

    def __init__(self, run: Run, bank: Bank, space: CoordinateSpace, residual: Floats, dof: int) -> None:
        self.run, self.bank, self.space, self.dof = run, bank, space, dof
        self._scale_to(residual)
        self.products = bank.products(self.y[None], space.whitening)
        left = bank.left(space)
        self.shares = bank.seen(left)
        self.named = self._blocks_of(left, self.shares)

    @cached_property
    def free(self) -> dict[Key, Blocks]:
        """What the model leaves of the free courses, by the key of their group."""
        left = self.bank.left(self.space, of_free=True)
        return self._blocks_of(left, self.bank.seen(left))

    @property
    def blocks(self) -> dict[Key, Blocks]:
        """What the model leaves of all, by the key of their group."""
        return {**self.named, **self.free}

    def _blocks_of(self, left: dict[Key, Reals], shares: Mapping[Key, Floats]) -> dict[Key, Blocks]:
        out = {}
        for key, share in shares.items():
            seen = np.flatnonzero(share >= HIDDEN_SHARE)
            value, vector = decomposed(left.pop(key)[seen])
            judged = np.count_nonzero(value > ROUNDING, axis=1) < self.dof  # what describes everything explains nothing
            seen, value, vector = seen[judged], value[judged], vector[judged]
            turned = turned_by(vector, self.products[key][seen])[..., 0]
            group = self.bank.groups[key]
            out[key] = Blocks(seen, group.number[seen], group.most[seen] / self.scale, value, vector, turned)
        return out

    def _scale_to(self, residual: Floats) -> None:
        self.scale = max(float(np.sqrt(np.sum(residual**2) / self.dof)), self.run.rounding, NOISELESS)
        self.y: Floats = residual.reshape(-1) / self.scale
        rounded, no_less = (self.dof * (size / self.scale)**2 for size in (self.run.rounding, NOISELESS))
        self.least = rounded + no_less
        self.total = max(float(self.y @ self.y) + no_less, self.least)

    def on(self, residual: Floats) -> 'Evidence':
        """Return the same for another residual (N, 3) of the same model; what is made of the bank is shared."""
        other = copy.copy(self)
        for name in ('empty', 'glance'):
            other.__dict__.pop(name, None)
        other._scale_to(residual)
        other.products = self.bank.products(other.y[None], self.space.whitening)
        for name in ('named', 'free'):
            if name in self.__dict__:
                other.__dict__[name] = {key: replace(
                    one, product=turned_by(one.vector, other.products[key][one.seen])[..., 0],
                    most=one.most * self.scale / other.scale) for key, one in self.__dict__[name].items()}
        return other

    @cached_property
    def glance(self) -> tuple[Ints, Floats] | None:
        """Numbers of the free courses that are seen and their log Bayes factors, as far as they matter where nothing
        is likely; None where something is, so that all have to be solved.

        They are estimated as if the columns of a course were apart; those that may be likely are solved one by one."""
        bank, numbers, estimates = self.bank, [], []
        if not (self.space.whitening.is_diagonal and any(one.is_free for one in bank.families)) or any(
                one.gain > 0 for one in self.empty.offers(is_open=False)):
            return None
        for key, square in bank.squares_left(self.space).items():
            group = bank.groups[key]
            seen = np.flatnonzero(np.sum(square, axis=1) >= HIDDEN_SHARE**2 * np.maximum(group.rank, 1))
            line = beside(np.maximum(square[seen], 0), self.products[key][seen, :, 0], None, self.total, self.dof,
                          SIZES[::2])
            numbers.append(group.number[seen])
            estimates.append(log_mean(allowed(line, group.most[seen] / self.scale)))
        number, log_bf = np.concatenate(numbers), np.concatenate(estimates)
        first = np.array(bank.ends)
        family = np.searchsorted(first, number, side='right') - 1
        prior = np.array([one.log_prior for one in bank.families])[family] - np.log(np.diff(first)[family])
        for k in np.argsort(-(log_bf + prior)).tolist():
            if log_bf[k] + prior[k] < -NEAR:
                break
            one = bank.families[family[k]]
            member = self.member(one, one.settings[number[k] - first[family[k]]])
            log_bf[k] = log_mean(allowed(self.empty.line(member.rows)[::2], member.most))
            if log_bf[k] + prior[k] > 0:
                return None
        return number, log_bf

    @cached_property
    def sensitivities(self) -> dict[str, float]:
        """The largest share that the run shows of each family that has a name, by this."""
        best = np.zeros(len(self.bank.families))
        for key, seen in self.shares.items():
            np.maximum.at(best, self.bank.groups[key].family, seen)
        return {one.name: share for one, share in zip(self.bank.families, best.tolist()) if not one.is_free}

    def member(self, family: CauseFamily, setting: Setting, volume: float = 0.0) -> Member:
        """Return a family at any setting as a Member."""
        return Member(self, family, setting, volume)

    @cached_property
    def empty(self) -> 'State':
        """The state of nothing."""
        return State(self, ())


class State:
    """A set of members and its log evidence; ends: where the rows of each begin, and end, among those of all.

    is_sized: whether the members keep their sizes, as they have them beside another one.
    """

    def __init__(self, evidence: Evidence, members: Sequence[Member], is_sized: bool = False) -> None:
        self.evidence = evidence
        rows = [one.rows for one in members]
        self.ends = np.cumsum([0, *map(len, rows)])
        self.rows = np.concatenate([np.zeros((0, evidence.y.size)), *rows])
        self._gram, self.product = self.rows @ self.rows.T, self.rows @ evidence.y
        sizes = np.array([one.size for one in members])
        occam = np.zeros(len(members))
        for _ in members:  # until each has its likeliest size beside those of the others
            before = sizes.copy()
            for k in reversed(range(len(members))):  # the newest one first, as the others may have theirs already
                whole = self._line(k, sizes)
                line = allowed(whole, members[k].most)
                best = int(np.searchsorted(SIZES, sizes[k]) if is_sized else np.argmax(line))
                sizes[k], occam[k] = SIZES[best], float(log_mean(line)) - whole[best]
            if np.array_equal(sizes[:-1], before[:-1]):
                break
        self.members = tuple(one.sized(float(size)) for one, size in zip(members, sizes))
        self.root, log_det = self._root(range(len(members)), sizes)
        self.inverse = self.root @ self.root.T
        self.left = evidence.total - float(self.product @ self.inverse @ self.product)
        fall = evidence.total - self.left
        self.likelihood = float(log_bayes_factor(log_det, fall, evidence.total, evidence.dof))
        names = [one.name for one in members]
        self.log_evidence = float(self.likelihood + occam.sum() + sum(
            one.volume + one.family.log_prior_beside(names[:place].count(one.name))
            for place, one in enumerate(members)))

    def _root(self, which: Sequence[int], sizes: Floats) -> tuple[Floats, float]:
        """Return R with R R' = (G + 1/tau^2)^-1 of some members, 0 for the others, and ln det(1 + tau G tau)."""
        size = np.zeros(len(self.product))
        for k in which:
            size[self.ends[k]:self.ends[k + 1]] = sizes[k]
        if not size.any():
            return np.zeros_like(self._gram), 0.0
        solution = Solution(size[:, None] * self._gram * size)
        return solution.halved(np.diag(size)).T, float(solution.log_det)

    def _line(self, k: int, sizes: Floats) -> Floats:
        """Return the log Bayes factor of a member beside the others for each of SIZES."""
        root, _ = self._root([j for j in range(len(sizes)) if j != k], sizes)
        inverse = root @ root.T
        own = slice(self.ends[k], self.ends[k + 1])
        across = self._gram[own] @ inverse
        left = self.evidence.total - float(self.product @ inverse @ self.product)
        return np.asarray(of_sizes((self._gram[own, own] - across @ self._gram[:, own])[None],
                                   (self.product[own] - across @ self.product)[None], left, self.evidence.dof)[0])

    def line(self, rows: Floats) -> Floats:
        """Return the log Bayes factor of further rows (q, 3 N) beside the members for each of SIZES."""
        across = rows @ self.rows.T
        used = across @ self.inverse
        product = rows @ self.evidence.y - used @ self.product
        return np.asarray(of_sizes((rows @ rows.T - used @ across.T)[None], product[None], self.left,
                                   self.evidence.dof)[0])

    @cached_property
    def basis(self) -> Floats:
        """Orthonormal rows (k, 3 N) of what the members describe."""
        return np.asarray(independent(self._gram, ROUNDING) @ self.rows)

    @cached_property
    def residual(self) -> Floats:
        """What a least-squares fit of the members leaves, (3 N,)."""
        out = self.evidence.y - (self.basis @ self.evidence.y) @ self.basis
        return np.asarray(out - (self.basis @ out) @ self.basis)

    @property
    def rss(self) -> float:
        """The square sum that a least-squares fit of the members leaves."""
        return float(self.residual @ self.residual)

    def extended(self, rows: Floats) -> tuple[Floats, Floats]:
        """Return what a least-squares fit of the members and further rows (q, 3 N) leaves, (3 N,), and their basis."""
        rows = rows - (rows @ self.basis.T) @ self.basis
        more = independent(rows @ rows.T, ROUNDING) @ rows
        return self.residual - (more @ self.residual) @ more, np.concatenate([self.basis, more])

    def fall(self, rows: Floats) -> float:
        """Return by how much a least-squares fit of further rows (q, 3 N) lowers the square sum."""
        left, _ = self.extended(rows)
        return self.rss - float(left @ left)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the members, sorted."""
        return tuple(sorted(one.name for one in self.members))

    @property
    def is_named(self) -> bool:
        """Whether all members have names."""
        return not any(one.family.is_free for one in self.members)

    @property
    def places(self) -> tuple[Place, ...]:
        """The families and settings of the members."""
        return tuple(one.place for one in self.members)

    def without(self, place: int) -> 'State':
        """Return the members but one, of the sizes that they have beside it."""
        return State(self.evidence, self.members[:place] + self.members[place + 1:], is_sized=True)

    def offers(self, is_open: bool = True) -> list[Member]:
        """Return the best Member of every family that may join, best first; is_open: of free courses, too."""
        evidence, bank = self.evidence, self.evidence.bank
        across = bank.products(self.rows, evidence.space.whitening, is_open) if len(self.rows) else {}
        glance = evidence.glance if is_open and not self.members else None
        blocks = evidence.blocks if is_open and glance is None else evidence.named
        return self._offered(bank.families, [(bank.groups[key].number, some, across.get(key))
                                             for key, some in blocks.items()], glance)

    def offer(self, family: CauseFamily) -> Member | None:
        """Return the best Member of one named family that may join; None where it cannot be seen."""
        return next(iter(self._offered([family], self._parts_of(family))), None)

    def worth_of(self, family: CauseFamily) -> Floats:
        """Return the log Bayes factor of each setting of a named family beside the members, (settings,), all sizes
        included; 0 where it is hidden."""
        log_bf, _ = self._log_bf(self._parts_of(family))
        return log_bf[slice(*self.evidence.bank.range_of[family.name])]

    def _parts_of(self, family: CauseFamily) -> list[Part]:
        evidence, bank = self.evidence, self.evidence.bank
        rows = self.rows if len(self.rows) else np.zeros((1, evidence.y.size))
        return [(bank.groups[key].number[place], evidence.named[key].within(place), across if len(self.rows) else None)
                for key, place, across in bank.products_of(family, rows, evidence.space.whitening)]

    def _log_bf(self, parts: Sequence[Part]) -> tuple[Floats, Bools]:
        """Return the log Bayes factors of all settings of the bank, and which are seen; -inf for those of no part."""
        bank = self.evidence.bank
        log_bf, seen = np.full(bank.ends[-1], -np.inf), np.zeros(bank.ends[-1], dtype=bool)
        for number, blocks, across in parts:
            log_bf[number] = 0.0  # as likely as nothing where it is hidden
            judged = np.count_nonzero(blocks.value > ROUNDING, axis=1) < self.evidence.dof - len(self.basis)
            if judged.any():  # what describes all that is left explains nothing
                log_bf[blocks.number[judged]] = blocks.log_bf(across, self)[judged]
                seen[blocks.number[judged]] = True
        return log_bf, seen

    def _offered(self, families: Sequence[CauseFamily], parts: Sequence[Part],
                 glance: tuple[Ints, Floats] | None = None) -> list[Member]:
        """Return the best Members of families that may join, best first; glance: as of Evidence, of the free ones."""
        bank, (log_bf, seen), out = self.evidence.bank, self._log_bf(parts), []
        if glance is not None:
            log_bf[glance[0]], seen[glance[0]] = glance[1], True
        first, count = np.array(bank.ends[:-1], dtype=int), np.diff(bank.ends)
        top = np.maximum.reduceat(log_bf, first)
        over = np.exp(log_bf - np.repeat(np.where(np.isfinite(top), top, 0.0), count))
        mean = np.log(np.maximum(np.add.reduceat(over, first) / count, 1e-300)) + top
        of = {one.name: place for place, one in enumerate(bank.families)}
        told = np.logical_or.reduceat(seen, first)  # of what this order hides altogether a run says nothing
        for family in families:
            place = of[family.name]
            if told[place]:
                own = slice(*bank.ends[place:place + 2])
                value, whole = log_bf[own], float(mean[place])
                best = int(np.argmax(np.where(seen[own], value, -np.inf)))
                prior = family.log_prior_beside(self.names.count(family.name))
                next_best = np.argsort(-value)[1:FURTHER] if family.is_coarse else ()
                out.append(Member(self.evidence, family, family.settings[best], whole - float(value[best]),
                                  whole + prior, tuple(family.settings[other] for other in next_best)))
        return sorted(out, key=lambda one: -one.gain)

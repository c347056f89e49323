# SPDX-License-Identifier: Apache-2.0
"""How often each cause is in the runs of a cell: a hierarchical model over the hypotheses that their searches visited.

A cause that is a property of the cell has a rate rho of its own, uniform over 0 .. 1; any other comes now and then, by
the rate that it has everywhere. With pi the prior of a cause in a run (EXPECTED shared out, sight/priors.py)

    p(property) = pi COMES_AGAIN / (1/2),   p(in a run | no property) = pi (1 - COMES_AGAIN),

so that the mean over both is pi. Events are no properties. What a law has to find in each run, moments and constants,
it has to find in each run of a cell, too: no rate spares it. A hypothesis of the cell is a set of properties; such sets
grow by one while that is of use, and share the probability. The rate of each is integrated by belief propagation over
the runs (Bethe's approximation). Sizes and constants are no evidence: only runs that likely have a cause tell them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import NEAR, SIZES
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.joint.run_causes import CauseShape, RunCauses
from rosette_ros.core.run.records import Bools, Floats, Ints

COMES_AGAIN = 0.5
"""Share of the causes in runs that are a property of the cell."""
CANDIDATES = 12
"""Causes that may be properties of a cell: those that its runs speak for most."""
MOST, BRANCHES = 6, 4
"""Properties of a cell, and sets of them that are grown at once, at most."""
ROUNDS = 12
"""Of messages between the runs and what they have in common."""
STILL = 1e-3
"""Change of a probability by which messages are at rest."""
TOGETHER = 8
"""Likelihoods of so many runs are multiplied before their logarithm is taken: no product of them leaves the numbers."""
FINENESS = 2
"""Rates over which is integrated, times the root of the number of runs: closer than the rate is known."""


@dataclass(frozen=True, eq=False)
class CellHypothesis:
    """A set of properties of a cell.

    names: of them; log_evidence; log_odds: (runs, names) of each in each run, by all other runs; rates: of each, the
    mean of what all runs leave."""

    names: tuple[str, ...]
    log_evidence: float
    log_odds: Floats
    rates: tuple[float, ...]


class CellRates:
    """The causes of a cell, from what each of its runs says.

    hypotheses: sets of properties with their probabilities, the likeliest first.
    """

    def __init__(self, runs: Sequence[RunCauses]) -> None:
        """Take what each run says."""
        self.runs = tuple(runs)
        self._nodes, self._weights = rates_of(len(self.runs))
        number = {name: k for k, name in enumerate(dict.fromkeys(chain.from_iterable(one.names for one in self.runs)))}
        places = [np.fromiter(map(number.__getitem__, one.names), int, len(one.names)) for one in self.runs]
        prior, odds = np.zeros((2, len(number))), np.zeros((len(number), len(self.runs)))
        for run, (one, own) in enumerate(zip(self.runs, places)):
            prior[:, own] += 1 / (1 + np.exp(-one.priors)), np.ones(len(own))
            odds[own, run] = one.odds
            odds[[number[name] for name in one.silent if name in number], run] = 1.0
        self.prior: dict[str, float] = dict(zip(number, (prior[0] / prior[1]).tolist()))
        self._elsewhere = {name: math.log(p) - math.log1p(-p) for name, prior in self.prior.items()
                           for p in [prior * (1 if is_event(name) else 1 - COMES_AGAIN)]}
        alone = {name: self._worth_alone(name, values) for name, values in zip(number, odds) if not is_event(name)}
        self.candidates = tuple(sorted((name for name, worth in alone.items() if worth > -NEAR),
                                       key=lambda name: -alone[name])[:CANDIDATES])
        elsewhere = np.array([*self._elsewhere.values()])
        self._said = [self._said_by(one, elsewhere[own]) for one, own in zip(self.runs, places)]
        self._place = np.repeat(np.arange(len(self.runs)), [len(one.member) for one in self._said])
        self._member = np.concatenate([one.member for one in self._said])
        self._weight = np.concatenate([one.weight for one in self._said])
        self._silent = np.array([[name in one.silent for name in self.candidates] for one in self.runs], dtype=bool)
        self._judged = {name: sum(name not in one.silent for one in self.runs) for name in self.candidates}
        found = self._grown()
        top = max(one.log_evidence for one in found)
        weight = {one.names: math.exp(one.log_evidence - top) for one in found}
        total = sum(weight.values())
        self.hypotheses = tuple(sorted(((weight[one.names] / total, one) for one in found), key=lambda pair: -pair[0]))

    # What is said of the cell

    def again(self, name: str) -> float:
        """Return the probability that a cause is a property of the cell."""
        return min(float(sum(p for p, one in self.hypotheses if name in one.names)), 1.0)

    def again_of(self, names: Sequence[str]) -> float:
        """Return the probability that one of some causes is a property of the cell."""
        return min(float(sum(p for p, one in self.hypotheses if not set(names).isdisjoint(one.names))), 1.0)

    def rate(self, name: str) -> float:
        """Return the probability that the next run has a cause."""
        prior, out = self.prior.get(name, 0.0), 0.0
        for p, one in self.hypotheses:
            if name in one.names:
                out += p * one.rates[one.names.index(name)]
            else:
                out += p * prior * (1 if is_event(name) else 1 - COMES_AGAIN)
        return out

    @cached_property
    def posteriors(self) -> tuple[Floats, ...]:
        """The probabilities of the hypotheses of each run, in the cell, (h,) each."""
        likely = [(p, one) for p, one in self.hypotheses if p >= STILL / 10]
        more = np.zeros((len(self.runs), len(self.candidates), len(likely)))
        for column, (_, one) in enumerate(likely):
            for name, odds in zip(one.names, one.log_odds.T):
                more[:, self.candidates.index(name), column] = odds - self._elsewhere[name]
        share = np.array([p for p, _ in likely])
        return tuple(said.posterior(own, share) for said, own in zip(self._said, more))

    def p(self, run: int, *names: str) -> float:
        """Return the probability that a run has one of some causes, in the cell."""
        return self.runs[run].of(names, self.posteriors[run])

    def size(self, name: str) -> tuple[float, float]:
        """Return the size of a cause, m rms over coordinates and over the runs that have it, and the standard deviation
        of its logarithm, as all these know it, NaN where none says anything of it.

        Its amplitudes in each run are normally distributed, with one size; each run counts by the probability that it
        has the cause."""
        known = self._shapes(name)
        if not known:
            return math.nan, math.nan
        units = [math.log(shape.unit) for shape, _ in known]
        line = np.arange(min(units), max(units) + np.log(SIZES[-1] / SIZES[0]), np.log(SIZES[1] / SIZES[0]))
        line += np.log(SIZES[0])
        weight = _normal(np.sum([p * np.interp(line - unit, np.log(SIZES), shape.sizes)
                                 for (shape, p), unit in zip(known, units)], axis=0))
        mean = float(weight @ line)
        return math.exp(mean), math.sqrt(weight @ (line - mean)**2)

    def constants(self, name: str) -> dict[str, tuple[Floats, Floats]]:
        """Return values and probabilities of the constants of a law, the same in all runs that have it.

        Each run counts by the probability that it has the cause."""
        out = {}
        for one in LAWS[name].searched if name in LAWS else ():
            known = [(*shape.constants[one.name], p) for shape, p in self._shapes(name) if one.name in shape.constants]
            if known:
                every = np.unique(np.concatenate([values for values, _, _ in known]))
                scale = np.log if one.kind == 'scale' else np.asarray
                out[one.name] = every, _normal(np.sum(
                    [p * np.interp(scale(every), scale(values), line) for values, line, p in known], axis=0))
        return out

    def _shapes(self, name: str) -> list[tuple[CauseShape, float]]:
        return [(one.shapes[name], self.p(k, name)) for k, one in enumerate(self.runs) if name in one.shapes]

    # How it is found

    def _share(self, name: str) -> float:
        """Return the prior that a cause is a property of the cell."""
        return min(2 * COMES_AGAIN * self.prior[name], 0.5)

    def _worth_alone(self, name: str, odds: Floats) -> float:
        """Return the log evidence of a cause as a property, all other causes being as elsewhere, sizes apart."""
        elsewhere = 1 / (1 + math.exp(-self._elsewhere[name]))
        line = _log_product(1 + (odds[:, None] - 1) * self._nodes)
        return float(np.logaddexp.reduce(line + np.log(self._weights)) - np.log1p(
            elsewhere * (odds - 1)).sum()) + math.log(self._share(name))

    def _said_by(self, run: RunCauses, elsewhere: Floats) -> '_Said':
        """Return what a run says where no cause is a property; elsewhere: log odds of its names then."""
        value = run.log_evidence + run.total(elsewhere - run.priors)
        bits = run.total_of({name: float(2**k) for k, name in enumerate(self.candidates)}).astype(np.int64)
        patterns, row = np.unique(bits, return_inverse=True)
        weight = np.exp(value - value.max())
        return _Said(weight, row, (patterns[:, None] >> np.arange(len(self.candidates)) & 1).astype(float),
                     np.bincount(row, weight, len(patterns)).astype(float))

    def _grown(self) -> list[CellHypothesis]:
        """Return the sets of properties that are visited."""
        found: dict[tuple[str, ...], CellHypothesis] = {(): self._hypothesis(())}
        growing = [(found[()], self.candidates)]
        while growing:
            some = list[tuple[CellHypothesis, tuple[str, ...]]]()
            for one, others in growing:
                made = dict[str, CellHypothesis]()
                for name in others:
                    names = tuple(sorted((*one.names, name)))
                    if name not in one.names and names not in found and len(names) <= MOST:
                        found[names] = made[name] = self._hypothesis(names)
                # what is worth nothing beside some is not asked for beside more of them
                useful = tuple(name for name, each in made.items() if each.log_evidence > one.log_evidence - NEAR)
                some += [(made[name], useful) for name in useful]
            best = max(one.log_evidence for one in found.values())
            growing = sorted((each for each in some if each[0].log_evidence > best - NEAR),
                             key=lambda each: -each[0].log_evidence)[:BRANCHES]
        return list(found.values())

    def _hypothesis(self, names: tuple[str, ...]) -> CellHypothesis:
        """Return a set of properties with its log evidence."""
        own = [self.candidates.index(name) for name in names]
        others = [name for name in self.candidates if name not in names]
        even = self._member[:, own] @ np.array([-self._elsewhere[name] for name in names])
        row = self._place * 2**len(own) + (self._member[:, own] @ 2**np.arange(len(own))).astype(np.int64)
        count = len(self.runs) * 2**len(own)
        weight = np.bincount(row, self._weight * np.exp(even), count).astype(float)
        made = self._propagated(weight.reshape(len(self.runs), -1), self._silent[:, own])
        prior = sum(math.log(self._share(name)) for name in names) + sum(math.log1p(-self._share(name)) - self._judged[
            name] * math.log1p(math.exp(self._elsewhere[name])) for name in others)
        return CellHypothesis(names, made[0] + prior, made[1], made[2])

    def _propagated(self, weight: Floats, silent: Bools) -> tuple[float, Floats, tuple[float, ...]]:
        """Return the log evidence of m properties, their log odds in each run by all others, and their mean rates.

        weight: (runs, 2^m), of each set of them with even odds; silent: (runs, m) whether a run says nothing."""
        m = silent.shape[1]
        member = (np.arange(2**m)[:, None] >> np.arange(m) & 1).astype(float)
        message = np.ones((*silent.shape, len(self._nodes)))  # of each run to each rate, likelihoods
        before, mean = np.zeros(silent.shape), np.stack([self._nodes, np.ones(len(self._nodes))], axis=1)
        for turn in range(ROUNDS):
            total = _log_product(message) + np.log(self._weights)
            cavity = np.exp(total - total.max(axis=-1, keepdims=True)) / message  # what all other runs say
            there, whole = np.moveaxis(cavity @ mean, -1, 0)
            there = there / whole
            term = weight * _of_sets(there, np.where(silent, 1.0, 1 - there))
            whole = term.sum(axis=1)
            if np.abs(there - before).max(initial=0.0) < STILL:
                break
            before, with_it = there, term @ member / whole[:, None]
            yes = np.where(silent, 1.0, with_it / there)
            no = np.where(silent, 1.0, np.maximum(1 - with_it, 0) / (1 - there))
            fresh = no[..., None] + (yes - no)[..., None] * self._nodes
            # those that wander between look-alikes come to rest half way
            message = np.sqrt(message * fresh) if turn > 2 and m > 1 else fresh
        evidence = float(np.log(whole).sum() + np.logaddexp.reduce(total, axis=1).sum())
        return evidence, np.log(there) - np.log(np.where(silent, 1.0, 1 - there)), tuple(
            (_normal(total) @ self._nodes).tolist())


def rates_of(runs: int) -> tuple[Floats, Floats]:
    """Return rates and their weights, by which a likelihood of so many runs is integrated (Gauss and Legendre).

    It is a polynomial of that degree, times a rate of one more; of many runs it is smooth over the width by which they
    know the rate."""
    nodes, weights = np.polynomial.legendre.leggauss(min((runs + 3) // 2, math.ceil(FINENESS * math.sqrt(runs))))
    return (nodes + 1) / 2, weights / 2


@dataclass(frozen=True, eq=False)
class _Said:
    """What a run says where no cause is a property: weights of its hypotheses, (h,), which pattern of candidates each
    has, (h,), the members of each pattern, 0 or 1, (patterns, candidates), and the sum of its hypotheses."""

    weights: Floats
    row: Ints
    member: Floats
    weight: Floats

    def posterior(self, more: Floats, share: Floats) -> Floats:
        """Return the probabilities of the hypotheses, (h,); more: log odds of the candidates in the cell over those
        elsewhere, (candidates, c), by each of c sets of properties with the probabilities `share`, (c,)."""
        by_set = _normal((np.log(self.weight)[:, None] + self.member @ more).T)
        out = self.weights * (share @ by_set / self.weight)[self.row]
        return np.asarray(out / out.sum())


def _of_sets(yes: Floats, no: Floats) -> Floats:
    """Return products over m causes, `yes` of those in a set and `no` of the others, (runs, m) each, (runs, 2^m): the
    set k has the causes whose bits are in k."""
    out = np.ones((len(yes), 1))
    for there, absent in zip(yes.T, no.T):
        out = np.concatenate([out * absent[:, None], out * there[:, None]], axis=1)
    return out


def _log_product(values: Floats) -> Floats:
    """Return the log of the product along the first axis, (k, ...), with one logarithm for TOGETHER numbers."""
    many = len(values) // TOGETHER
    first, rest = np.split(values, [many * TOGETHER])
    products = np.prod(first.reshape(many, TOGETHER, *values.shape[1:]), axis=1)
    return np.asarray(np.log(products).sum(axis=0) + np.log(rest).sum(axis=0))


def _normal(line: Floats) -> Floats:
    """Return probabilities from their logarithms along the last axis, but for a factor."""
    out = np.exp(line - line.max(axis=-1, keepdims=True))
    return np.asarray(out / out.sum(axis=-1, keepdims=True))


def is_event(name: str) -> bool:
    """Return whether a cause is an event, of which nothing comes again by its nature."""
    return bool((LAWS.get(name) or FREE).carries == 'nothing')

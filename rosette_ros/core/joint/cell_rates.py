# SPDX-License-Identifier: Apache-2.0
"""How often each cause is in the runs of a cell: a hierarchical model over the hypotheses that their searches visited.

A cause that is a property of the cell has a rate rho of its own, uniform over 0 .. 1; any other comes now and then, by
the rate that it has everywhere. With pi the prior of a cause in a run (EXPECTED shared out, sight/priors.py)

    p(property) = pi COMES_AGAIN / (1/2),   p(in a run | no property) = pi (1 - COMES_AGAIN),

so that the mean over both is pi. Events are no properties. The size of a property in a run is log-normal about one of
the cell, its law has the same constants in nearly all runs. A hypothesis of the cell is a set of properties; such sets
grow by one while that is of use, and share the probability. The rate, typical size and constants of each are integrated
by belief propagation over the runs (Bethe's approximation).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import NEAR, SIZES
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.joint.run_causes import RunCauses
from rosette_ros.core.run.records import Bools, Floats, Ints

COMES_AGAIN = 0.5
"""Share of the causes in runs that are a property of the cell."""
SPREADS = 0.5, 1.0, 3.0
"""Standard deviations of the logarithm of the size of a property from run to run, of which each is as likely."""
SAME = 0.9
"""Probability that a constant in a run is that of the cell: beside others it may be another one."""
CANDIDATES = 12
"""Causes that may be properties of a cell: those that its runs speak for most."""
MOST, BRANCHES = 6, 4
"""Properties of a cell, and sets of them that are grown at once, at most."""
ROUNDS = 12
"""Of messages between the runs and what they have in common."""
STILL = 1e-3
"""Change of a probability by which messages are at rest."""
RATES, WEIGHTS = np.polynomial.legendre.leggauss(8)
RATES, WEIGHTS = (RATES + 1) / 2, WEIGHTS / 2


@dataclass(frozen=True, eq=False)
class Common:
    """What a property has in common in all runs, as values with log likelihoods in each run.

    values: (k,); line: (runs, k), of mean likelihood 1 over the values that a run tried.
    """

    values: Floats
    line: Floats


@dataclass(frozen=True, eq=False)
class CellHypothesis:
    """A set of properties of a cell.

    names: of them; log_evidence; log_odds: (runs, names) of each in each run, by all other runs; common: (k,) posterior
    of the rate over RATES and of each Common of each property, by its name and that of the common.
    """

    names: tuple[str, ...]
    log_evidence: float
    log_odds: Floats
    common: Mapping[tuple[str, str], Floats] = field(default_factory=dict)


class CellRates:
    """The causes of a cell, from what each of its runs says.

    hypotheses: sets of properties with their probabilities, the likeliest first.
    """

    def __init__(self, runs: Sequence[RunCauses]) -> None:
        """Take what each run says."""
        self.runs = tuple(runs)
        priors: dict[str, list[float]] = {}
        for one in self.runs:
            for name, value in one.log_prior.items():
                priors.setdefault(name, []).append(math.exp(value))
        self.prior = {name: float(np.mean(values)) for name, values in priors.items()}
        odds = {name: np.array([one.odds(name) if name in one.log_prior or name in one.silent else 0.0
                                for one in self.runs]) for name in self.prior if not is_event(name)}
        alone = {name: self._worth_alone(name, values) for name, values in odds.items()}
        self.candidates = tuple(sorted((name for name, worth in alone.items() if worth > -NEAR),
                                       key=lambda name: -alone[name])[:CANDIDATES])
        self._common = {name: self._common_of(name) for name in self.candidates}
        self._member, self._weight = self._patterns()
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
                out += p * float(one.common[name, 'rate'] @ RATES)
            else:
                out += p * prior * (1 if is_event(name) else 1 - COMES_AGAIN)
        return out

    @cached_property
    def posteriors(self) -> tuple[Floats, ...]:
        """The probabilities of the hypotheses of each run, in the cell, (h,) each."""
        return tuple(self._posterior(place) for place in range(len(self.runs)))

    def p(self, run: int, *names: str) -> float:
        """Return the probability that a run has one of some causes, in the cell."""
        return self.runs[run].of(names, self.posteriors[run])

    def common(self, name: str, what: str) -> tuple[Floats, Floats] | None:
        """Return values and probabilities of the typical 'size', m rms, or of a constant of a property, None where its
        runs say nothing of it."""
        some = [(p, one.common[name, what]) for p, one in self.hypotheses if (name, what) in one.common]
        if not some:
            return None
        mean = np.sum([p * line for p, line in some], axis=0)
        return self._common[name][what].values, mean / mean.sum()

    def constants(self, name: str) -> tuple[str, ...]:
        """Return the constants of the law of a property of which its runs say something."""
        return tuple(what for what in self._common.get(name, {}) if what != 'size')

    def _posterior(self, place: int) -> Floats:
        run, out = self.runs[place], np.zeros(len(self.runs[place].hypotheses))
        now_and_then = {name: math.log(self._elsewhere(name)) for name in run.log_prior}
        for p, one in self.hypotheses:
            if p < STILL / 10:
                break
            odds = now_and_then | dict(zip(one.names, one.log_odds[place].tolist()))
            value = run.log_evidence + run.total({name: odds[name] - prior for name, prior in run.log_prior.items()})
            weight = np.exp(value - value.max())
            out += p * weight / weight.sum()
        return np.asarray(out / out.sum())

    # How it is found

    def _elsewhere(self, name: str) -> float:
        """Return the odds of a cause in a run where it is no property of the cell."""
        p = self.prior[name] * (1 if is_event(name) else 1 - COMES_AGAIN)
        return p / (1 - p)

    def _share(self, name: str) -> float:
        """Return the prior that a cause is a property of the cell."""
        return min(2 * COMES_AGAIN * self.prior[name], 0.5)

    def _worth_alone(self, name: str, odds: Floats) -> float:
        """Return the log evidence of a cause as a property, all other causes being as elsewhere, sizes apart."""
        line = np.log1p(RATES[:, None] * (odds - 1)).sum(axis=1) - np.log1p(self._elsewhere(name) * odds).sum()
        return float(np.logaddexp.reduce(line + np.log(WEIGHTS))) + math.log(self._share(name))

    def _common_of(self, name: str) -> dict[str, Common]:
        """Return what a property has in common in the runs that say something of it."""
        shapes = [one.shapes.get(name) for one in self.runs]
        known = [one for one in shapes if one]
        if not known:
            return {}
        units = [one.unit for one in known]
        typical = np.arange(math.log(min(units) * SIZES[0]), math.log(max(units) * SIZES[-1]), SPREADS[0] / 0.75)
        values, spread = np.tile(np.exp(typical), len(SPREADS)), np.repeat(SPREADS, len(typical))
        line = np.zeros((len(shapes), len(values)))
        for place, one in enumerate(shapes):
            if one:
                off = (np.log(one.unit * SIZES)[None] - np.log(values)[:, None]) / spread[:, None]
                share = -off**2 / 2
                share -= np.logaddexp.reduce(share, axis=1, keepdims=True)
                line[place] = np.logaddexp.reduce(share + one.sizes, axis=1)
        out = {'size': Common(values, line)}
        scales = {one.name: one.kind == 'scale' for one in LAWS[name].searched} if name in LAWS else {}
        for what, is_scale in scales.items():
            tried = [one.constants[what][0] if one and what in one.constants else () for one in shapes]
            if not any(tried):
                continue
            every = np.unique(np.concatenate([np.array(one, dtype=float) for one in tried]))
            line = np.zeros((len(shapes), len(every)))
            for place, one in enumerate(shapes):
                if one and what in one.constants:
                    own, worth = one.constants[what]
                    line[place] = np.interp(np.log(every), np.log(own), worth) if is_scale else np.interp(
                        every, own, worth)
            out[what] = Common(every, np.log(SAME * np.exp(line) + 1 - SAME))
        return out

    def _patterns(self) -> tuple[Bools, Floats]:
        """Return which candidates are in each pattern of each run, (runs, patterns, candidates), and the weights of the
        patterns, (runs, patterns), with even odds for these and no common size or constant, all other causes as
        elsewhere."""
        number = {name: k for k, name in enumerate(self.candidates)}
        tables = list[tuple[Ints, Floats]]()
        for run in self.runs:
            other = {name: (0.0 if name in number else math.log(self._elsewhere(name))) - prior
                     for name, prior in run.log_prior.items()}
            value = run.log_evidence + run.total(other)
            bits = run.total({name: float(2**k) for name, k in number.items()}).astype(np.int64)
            keys, row = np.unique(bits, return_inverse=True)
            weight = np.exp(value - value.max())
            tables.append((keys, np.asarray(np.bincount(row, weight, len(keys)), dtype=float)))
        most = max(len(keys) for keys, _ in tables)
        member = np.zeros((len(tables), most, len(number)), dtype=bool)
        weight = np.zeros((len(tables), most))
        for place, (keys, sums) in enumerate(tables):
            member[place, :len(keys)] = keys[:, None] >> np.arange(len(number)) & 1
            weight[place, :len(keys)] = sums
        return member, weight

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
        others = [k for k in range(len(self.candidates)) if k not in own]
        elsewhere = np.array([self._elsewhere(self.candidates[k]) for k in others])
        weight = self._weight * np.prod(np.where(self._member[:, :, others], elsewhere, 1.0), axis=2)
        prior = sum(math.log(self._share(name)) for name in names) + sum(
            math.log1p(-self._share(self.candidates[k])) for k in others)
        silent = np.array([[name in run.silent for name in names] for run in self.runs], dtype=bool)
        made = _Propagation(self._member[:, :, own], weight, silent,
                            [{what: one.line for what, one in self._common[name].items()} for name in names])
        common = {(name, what): line for name, lines in zip(names, made.commons) for what, line in lines.items()}
        return CellHypothesis(names, made.log_evidence + prior, made.log_odds, common)


class _Propagation:
    """Messages between the runs and the rate, size and constants of each property of a set.

    member: (runs, patterns, m); weight: (runs, patterns); silent: (runs, m) whether a run says nothing; lines: of each
    property by name, (runs, k), log likelihoods of what is in common."""

    def __init__(self, member: Bools, weight: Floats, silent: Bools, lines: Sequence[Mapping[str, Floats]]) -> None:
        runs, _, m = member.shape
        self._member, self._weight, self._silent = member, weight, silent
        every: list[dict[str, Floats]] = []
        for one in lines:
            every.append({'rate': np.tile(RATES, (runs, 1)), **{name: np.exp(line) for name, line in one.items()}})
        self._factor = every
        self._prior = [{name: WEIGHTS if name == 'rate' else np.full(values.shape[1], 1 / values.shape[1])
                        for name, values in one.items()} for one in every]
        messages = [{name: np.zeros_like(values) for name, values in one.items()} for one in every]
        before = np.full((runs, m), 0.5)
        for turn in range(ROUNDS if m else 1):
            cavity = [{name: self._cavity(self._prior[k][name], line) for name, line in one.items()}
                      for k, one in enumerate(messages)]
            there, absent = self._means(cavity)
            whole, with_it, without = self._sums(there, absent)
            fresh = [{name: self._message(k, name, cavity[k], there, absent, with_it, without, whole)
                      for name in one} for k, one in enumerate(messages)]
            # those that wander between look-alikes come to rest half way
            messages = [{name: (one[name] + old[name]) / 2 if turn > 2 and m > 1 else one[name] for name in one}
                        for one, old in zip(fresh, messages)]
            now = there / (there + absent)
            if m and np.abs(now - before).max() < STILL:
                break
            before = now
        self.log_odds = np.log(there) - np.log(absent)
        self.log_evidence = float(np.log(whole).sum())
        self.commons: list[dict[str, Floats]] = []
        for k, one in enumerate(messages):
            found = {}
            for name, line in one.items():
                total = line.sum(axis=0) + np.log(self._prior[k][name])
                self.log_evidence += float(np.logaddexp.reduce(total))
                found[name] = np.exp(total - np.logaddexp.reduce(total))
            self.commons.append(found)

    @staticmethod
    def _cavity(prior: Floats, line: Floats) -> Floats:
        """Return what all other runs say of something in common, for each run, (runs, k)."""
        total = line.sum(axis=0) - line + np.log(prior)
        out = np.exp(total - total.max(axis=1, keepdims=True))
        return np.asarray(out / out.sum(axis=1, keepdims=True))

    def _means(self, cavity: Sequence[Mapping[str, Floats]]) -> tuple[Floats, Floats]:
        """Return the weights of the presence and absence of each property in each run, (runs, m) each."""
        shape = self._silent.shape
        there, absent = np.ones(shape), np.ones(shape)
        for k, one in enumerate(cavity):
            for name, p in one.items():
                there[:, k] *= np.sum(p * self._factor[k][name], axis=1)
            absent[:, k] = np.sum(one['rate'] * (1 - RATES), axis=1)
        return there, np.where(self._silent, 1.0, absent)

    def _sums(self, there: Floats, absent: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the evidence of each run, (runs,), and its sums with and without each property, (runs, m)."""
        term = self._weight * np.prod(np.where(self._member, there[:, None], absent[:, None]), axis=2)
        whole = term.sum(axis=1)
        with_it = np.einsum('rp,rpm->rm', term, self._member)
        return whole, with_it, whole[:, None] - with_it

    def _message(self, k: int, name: str, cavity: Mapping[str, Floats], there: Floats, absent: Floats,
                 with_it: Floats, without: Floats, whole: Floats) -> Floats:
        """Return what each run says of something in common, (runs, k), log likelihoods."""
        values = self._factor[k][name]
        mean = np.sum(cavity[name] * values, axis=1)
        yes = np.maximum(with_it[:, k], 0) / np.maximum(mean, 1e-300)
        no = np.maximum(without[:, k], 0)
        if name == 'rate':
            out = yes[:, None] * values + (no / np.maximum(absent[:, k], 1e-300))[:, None] * (1 - values)
        else:
            out = yes[:, None] * values + no[:, None]
        line = np.log(np.maximum(out, 1e-300)) - np.log(whole)[:, None]
        return np.asarray(np.where(self._silent[:, k][:, None], 0.0, line))


def is_event(name: str) -> bool:
    """Return whether a cause is an event, of which nothing comes again by its nature."""
    return bool((LAWS.get(name) or FREE).carries == 'nothing')

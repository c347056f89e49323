# SPDX-License-Identifier: Apache-2.0
"""What one run says of causes, compact: the hypotheses that its search visited, sizes and constants of the likely ones.

An archive keeps this of each run, so that a cell is learnt from many runs without searching any of them again.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import State, log_mean
from rosette_ros.core.diagnosis.posterior import Key, Posterior
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.model.least_squares import HIDDEN_SHARE
from rosette_ros.core.run.records import Floats, Ints
from rosette_ros.core.sight.bank import CauseFamily, columns_of
from rosette_ros.core.sight.limits import LISTED
from rosette_ros.core.sight.priors import log_found

KEPT = 12.0
"""Log evidence, with even odds for each cause of the library, by which a hypothesis that is kept may be worse than the
best one: as much as a cell can make up for."""
SHAPED = 12
"""Causes of a run of which sizes and constants are kept: those that its readings speak for most."""
AGAIN = 5
"""Likeliest hypotheses of a run beside which every cause is looked for: one of them may be that of the cell."""


@dataclass(frozen=True, eq=False)
class CauseShape:
    """How a cause goes in a run, where the run has it.

    unit: of amplitudes of size 1, m rms over all coordinates; sizes: log likelihood of each of SIZES, their mean
    likelihood 1;
    constants: values of each constant of its law that were tried, and log likelihoods, likewise.
    """

    unit: float
    sizes: Floats
    constants: Mapping[str, tuple[tuple[float, ...], Floats]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RunCauses:
    """What a run says of causes.

    hypotheses: names of members, each once, of every hypothesis that is kept; log_evidence: (h,), their priors
    included; log_prior: of each name, but for what it has to find in each run; silent: names of which the run says
    nothing; shapes: by name.
    """

    hypotheses: tuple[tuple[str, ...], ...]
    log_evidence: Floats
    log_prior: Mapping[str, float]
    silent: frozenset[str] = frozenset()
    shapes: Mapping[str, CauseShape] = field(default_factory=dict)

    @cached_property
    def p(self) -> Floats:
        """The probabilities of the hypotheses by this run alone, (h,)."""
        weight = np.exp(self.log_evidence - self.log_evidence.max())
        return np.asarray(weight / weight.sum())

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All names of the hypotheses."""
        return tuple(self.log_prior)

    @cached_property
    def priors(self) -> Floats:
        """The log priors of all names, (names,)."""
        return np.fromiter(self.log_prior.values(), float, len(self.log_prior))

    @cached_property
    def _number(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.names)}

    @cached_property
    def members(self) -> Ints:
        """The numbers of the members of each hypothesis among the names, (h, most), the number of names for none."""
        count = np.fromiter(map(len, self.hypotheses), int, len(self.hypotheses))
        out = np.full((len(count), max(count.max(initial=0), 1)), len(self.names))
        out[np.arange(out.shape[1]) < count[:, None]] = np.fromiter(
            map(self._number.__getitem__, chain.from_iterable(self.hypotheses)), int, count.sum())
        return out

    def total(self, values: Floats) -> Floats:
        """Return the sum of values of all names, (names,), over the members of each hypothesis, (h,)."""
        return np.asarray(np.append(values, 0.0)[self.members].sum(axis=1))

    def total_of(self, by_name: Mapping[str, float]) -> Floats:
        """Return the same of values of some names, 0 for the others."""
        values = np.zeros(len(self.names))
        for name, value in by_name.items():
            if name in self._number:
                values[self._number[name]] = value
        return self.total(values)

    def of_each(self, p: Floats) -> dict[str, float]:
        """Return the probability of each name where the hypotheses have probabilities p, (h,)."""
        return dict(zip(self.names, self._of_all(p).tolist()))

    def _of_all(self, p: Floats) -> Floats:
        """Return the probabilities of all names, (names,)."""
        width = self.members.shape[1]
        return np.bincount(self.members.ravel(), np.repeat(p, width), len(self.names) + 1)[:-1].astype(float)

    @cached_property
    def alone(self) -> dict[str, float]:
        """The probability of each name by this run alone."""
        return self.of_each(self.p)

    def of(self, names: Iterable[str], p: Floats | None = None) -> float:
        """Return the probability that one of some names is there; p: (h,) of the hypotheses, by this run alone if None.
        """
        return float((self.p if p is None else p)[self.total_of(dict.fromkeys(names, 1.0)) > 0].sum())

    @cached_property
    def odds(self) -> Floats:
        """The factors by which the run changes the odds of all names, (names,)."""
        p = np.minimum(self._of_all(self.p), 1 - 1e-12)
        return np.asarray(p / (1 - p) / np.exp(self.priors))


def causes_in(search: RunSearch) -> RunCauses:
    """Return what a run says of causes by itself: experience of the cell adds nothing, so that no run teaches again
    what earlier ones have taught."""
    posterior, alone = search.posterior, search.posterior.alone
    families = {one.name: one for one in search.readings.bank.families}
    found = {key: alone.log_evidence(key) for key in alone.keys}
    if not search.noiseless:
        found |= _searched_again(posterior, alone)

    best: dict[tuple[str, ...], float] = {}
    for (names, _), value in found.items():
        once = tuple(dict.fromkeys(names))
        best[once] = float(np.logaddexp(best.get(once, -np.inf), value))
    every = {name: one.log_prior - one.learnt - log_found(one) for name, one in families.items()}
    lifted = {names: value - sum(min(every[name], 0.0) for name in names if name in LAWS)
              for names, value in best.items()}
    least, least_lifted = max(best.values()) - KEPT, max(lifted.values()) - KEPT
    kept = tuple(sorted((names for names, value in best.items() if value > least or lifted[names] > least_lifted),
                        key=lambda names: -best[names]))
    prior = {name: every[name] for names in kept for name in names}
    shares = search.readings.white.sensitivities
    silent = frozenset(LAWS).difference(shares) | {name for name, share in shares.items() if share < HIDDEN_SHARE}
    made = RunCauses(kept, np.array([best[names] for names in kept]), prior, silent.difference(prior))
    if search.noiseless:
        return made
    odds = dict(zip(made.names, made.odds.tolist()))
    likely = sorted((name for name in prior if odds[name] > 1), key=lambda name: -odds[name])
    shapes = {}
    for name in likely[:SHAPED]:
        key = next((key for key in alone.keys if name in key[0]), None)
        if key and (shape := _shape(posterior, key, families[name])):
            shapes[name] = shape
    return RunCauses(made.hypotheses, made.log_evidence, prior, made.silent, shapes)


def _without(posterior: Posterior, key: Key, name: str = '') -> State:
    """Return the State of a hypothesis, less the first member of a name, in the noise of the best one."""
    evidence, places = posterior.state.evidence, list(posterior.places(key))
    if name:
        places.remove(next(place for place in places if place[0].name == name))
    return State(evidence, [evidence.member(family, setting) for family, setting in places])


def _searched_again(posterior: Posterior, alone: Posterior) -> dict[Key, float]:
    """Return the log evidence of the likeliest hypotheses with each named cause more, where it is not known; alone: the
    posterior without experience.

    The search looks for what joins its best hypothesis; the cell may know that another one is true."""
    out: dict[Key, float] = {}
    noise, known = posterior.best[1], frozenset(alone.keys)
    likely = [key for key in alone.keys if key[1] == noise and alone.p[key] > LISTED][:AGAIN]
    for key in likely:
        state = _without(posterior, key)
        for offer in state.offers(is_open=False):
            more = tuple(sorted((*key[0], offer.family.name))), noise
            if offer.family.name not in key[0] and more not in known:
                gain = offer.gain - offer.family.learnt
                out[more] = max(out.get(more, -np.inf), alone.log_evidence(key) + gain)
    return out


def _shape(posterior: Posterior, key: Key, family: CauseFamily) -> CauseShape | None:
    """Return the CauseShape of a cause beside the others of a hypothesis; None where these hide it."""
    rest = _without(posterior, key, family.name)
    place = next(one for one in posterior.places(key) if one[0].name == family.name)
    evidence = rest.evidence
    rows, moved = evidence.member(*place).rows, columns_of(family, evidence.run, place[1])
    line, left = rest.line(rows), rest.extended(rows)[0]
    noise = evidence.scale * math.sqrt(max(float(left @ left), evidence.least) / evidence.dof)
    constants: dict[str, tuple[tuple[float, ...], Floats]] = {}
    if family.effect.constants and not family.is_free:
        worth = rest.worth_of(family)
        for one in family.effect.constants:
            groups: dict[float, list[float]] = {}
            for setting, value in zip(family.settings, worth.tolist()):
                if one.name in setting:
                    groups.setdefault(setting.number(one.name), []).append(value)
            if len(groups) > 1:
                tried = {value: float(np.logaddexp.reduce(some)) - math.log(len(some))
                         for value, some in groups.items()}
                if one.name in place[1]:  # where it was refined; its choices are those of the grid
                    choices = max(map(len, groups.values()))
                    tried[place[1].number(one.name)] = float(log_mean(line)) - math.log(choices)
                values = tuple(sorted(tried))
                constants[one.name] = values, _of_mean_one(np.array([tried[value] for value in values]))
    return CauseShape(noise * float(np.linalg.norm(moved)) / math.sqrt(evidence.y.size), _of_mean_one(line), constants)


def _of_mean_one(values: Floats) -> Floats:
    return np.asarray(values - np.logaddexp.reduce(values) + math.log(len(values)))

# SPDX-License-Identifier: Apache-2.0
"""What each of several runs has beside the base model: its noise, and effects by each of its likely explanations.

Amplitudes, phases and moments belong to one run. A constant of a law, such as a time constant or a period, belongs to
the machine: runs that have the same effect, along the same axes or of the same ball, have it in common, unless their
own values contradict that.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.diagnosis import MOST_BALLS_JUDGED, fitted_with_noise, known_of
from rosette_ros.core.diagnosis.log_evidence import SIZES, Place
from rosette_ros.core.diagnosis.run_search import RunSearch, with_places
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.columns import independent
from rosette_ros.core.model.least_squares import REFINED, Fit, FittedEffect, fit, observed
from rosette_ros.core.model.model import Model
from rosette_ros.core.model.noise import Noise, Whitening
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.geometry import Floats, Ints, rotate_z
from rosette_ros.core.run.records import UNLIKELY, Run
from rosette_ros.core.sight.linear_explanation import Solution

Key = Hashable
"""What a nonlinear parameter is known by: runs of which it is one have one key."""


@dataclass(frozen=True, eq=False)
class JointEffect:
    """An effect of a run at a setting.

    fitted: as the run alone gives it, amplitudes first; columns: (q, 3 N) and tangents: (t, 3 N) of its nonlinear
    parameters, in the axes of table angle 0, m per unit; keys: of the tangents; moments: how many of it were found,
    between readings, beside amplitudes and tangents; size: R (k, q), R' R of the prior covariance of its
    amplitudes over the variance of the noise.
    """

    fitted: FittedEffect
    columns: Floats
    tangents: Floats
    keys: tuple[Key, ...]
    moments: int
    size: Floats

    @property
    def name(self) -> str:
        """Its name."""
        return self.fitted.name


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An explanation of a run: its probability, its effects, and what the run alone says of those by which it has that
    probability: gram (q, q), products of their columns in what the base model leaves, told (q,), with the readings, and
    their size R (k, q)."""

    probability: float = 1.0
    effects: tuple[JointEffect, ...] = ()
    gram: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    told: Floats = field(default_factory=lambda: np.zeros(0))
    size: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def log_bf(self, sigma: float) -> float:
        """Return what the effects by which it has its probability are worth in the run alone, ln BF; sigma: of the
        noise, m. The probability less that is its prior."""
        return log_bf_of(self.gram, self.told, self.size, sigma)


@dataclass(frozen=True, eq=False)
class RunExplained:
    """What a run has beside the base model.

    whitening: of its noise in its own axes, None where it is white and equal; offset: of these axes against those of
    table angle 0, rad; hypotheses: its likely explanations, best first, at least one.
    """

    noise: Noise = Noise()  # noqa: RUF009 (it is frozen)
    whitening: Whitening | None = None
    offset: float = 0.0
    hypotheses: tuple[Hypothesis, ...] = (Hypothesis(),)

    def weighted(self, rows: Floats, between: Solution | None = None) -> Floats:
        """Return W' W of rows (k, 3 N), or W' (1 + C)^-1 W; between: of C, (3 N, 3 N)."""
        white = self.white(rows)
        white = white if between is None else between.solved(white.T).T
        return white if self.whitening is None else self._each(self.whitening.adjoint, white)

    def white(self, rows: Floats) -> Floats:
        """Return W of rows (k, 3 N)."""
        return rows if self.whitening is None else self._each(self.whitening.apply, rows)

    def _each(self, what: Callable[[Floats], Floats], rows: Floats) -> Floats:
        """Return what is done to rows (k, 3 N) in the axes of the run."""
        vectors = rows.reshape(len(rows), rows.shape[1] // 3, 3)
        return np.asarray(rotate_z(self.offset, what(rotate_z(-self.offset, vectors))).reshape(rows.shape))


@dataclass(frozen=True, eq=False)
class BesideBase:
    """What several runs have beside the base model; choice: of each the number of the hypothesis that is in use."""

    runs: tuple[RunExplained, ...]
    choice: tuple[int, ...]

    @staticmethod
    def of(runs: Iterable[RunExplained]) -> 'BesideBase':
        """Return the BesideBase of runs, each by its likeliest hypothesis."""
        every = tuple(runs)
        return BesideBase(every, (0,) * len(every))

    def alone(self, place: int) -> 'BesideBase':
        """Return that of one of the runs."""
        return BesideBase(self.runs[place:place + 1], self.choice[place:place + 1])

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The hypothesis in use, of each run."""
        return tuple(run.hypotheses[number] for run, number in zip(self.runs, self.choice, strict=True))

    @property
    def is_plain(self) -> bool:
        """Whether the noise is white and equal in all."""
        return not any(run.whitening for run in self.runs)

    def loss(self, share: float) -> float:
        """Return how much larger variances are than the weights say; share: of the readings that are parameters."""
        return float(np.mean([run.noise.loss(share) for run in self.runs]))

    @cached_property
    def _effects(self) -> list[tuple[int, int, int, JointEffect]]:
        """Every effect of every hypothesis: the numbers of its run and hypothesis, its first row, and itself."""
        every = [(place, number, one) for place, run in enumerate(self.runs)
                 for number, hypothesis in enumerate(run.hypotheses) for one in hypothesis.effects]
        first = np.cumsum([0, *(len(one.columns) + len(one.tangents) for *_, one in every)]).tolist()
        return [(place, number, row, one) for (place, number, one), row in zip(every, first)]

    def placed(self, place: int, number: int) -> list[tuple[int, JointEffect]]:
        """Return the effects of a hypothesis of a run, each with its first row."""
        return [(row, one) for run, hypothesis, row, one in self._effects if (run, hypothesis) == (place, number)]

    def rows(self, of_reading: Ints) -> Floats:
        """Return columns, then tangents, of every effect of every hypothesis, (Q, 3 N); of_reading: (N,) its run."""
        parts = [np.zeros((0, 3 * of_reading.size))]
        for place, _, _, one in self._effects:
            own = np.concatenate([one.columns, one.tangents])
            rows = np.zeros((len(own), 3 * of_reading.size))
            rows[:, np.repeat(of_reading == place, 3)] = own
            parts.append(rows)
        return np.concatenate(parts)

    def chosen(self, choice: Sequence[int]) -> tuple[Floats, int]:
        """Return which rows the hypotheses of a choice have, (k, Q), and how many of them are columns, which are first:
        tangents of one key are one row."""
        size = sum(len(one.columns) + len(one.tangents) for *_, one in self._effects)
        columns, tangents = list[Floats](), dict[Key, Floats]()
        for place, number in enumerate(choice):
            for first, one in self.placed(place, number):
                end = first + len(one.columns)
                columns += [_unit(size, row) for row in range(first, end)]
                for row, key in enumerate(one.keys, end):
                    own = (place, row) if isinstance(key, int) else key
                    tangents[own] = tangents.get(own, 0.0) + _unit(size, row)
        rows = [*columns, *tangents.values()]
        return np.array(rows).reshape(len(rows), size), len(columns)

    def size(self, choice: Sequence[int]) -> Floats:
        """Return the sizes R (q, q) of the columns of a choice, as of JointEffect."""
        effects = [one for place, number in enumerate(choice) for one in self.runs[place].hypotheses[number].effects]
        return _together(effects)

    @property
    def moments(self) -> int:
        """How many moments of the effects in use were found."""
        return sum(effect.moments for one in self.hypotheses for effect in one.effects)


def _unit(size: int, place: int) -> Floats:
    out = np.zeros(size)
    out[place] = 1.0
    return out


def explained_runs(every: Sequence[Readings]) -> BesideBase:
    """Return what runs have beside the base model, as each of them shows it by itself.

    A run in which nothing was found has no effect; readings without times, or of which one run alone does not determine
    the base model, have white noise and no effect; larger plates have noise and no effect, as when they are evaluated
    alone.
    """
    found = [_found(readings) for readings in every]
    common = _constants([one for one in found if isinstance(one, _Explained)])
    return BesideBase.of(one if isinstance(one, RunExplained) else one.together(common) for one in found)


Constants = Mapping[tuple[str, frozenset[tuple[str, object]]], Mapping[str, float]]
"""Of effects, by name and choices, the constants that runs have in common."""


class _Explained:
    """A run in which something was found: its search, and likely explanations with probabilities as places."""

    def __init__(self, readings: Readings, search: RunSearch, explanations: Sequence[tuple[float, Fit]]) -> None:
        assert readings.run is not None
        self.run, self.search = readings.run, search
        self.explanations = [(p, _places_of(search, one), one) for p, one in explanations]

    @property
    def likeliest(self) -> Fit:
        """The fit of the likeliest explanation."""
        return self.explanations[0][2]

    def together(self, common: Constants) -> RunExplained:
        """Return the RunExplained, with constants that are those of several runs."""
        noise, total, sigma = self.search.base.noise, sum(p for p, *_ in self.explanations), self.likeliest.rms
        hypotheses = []
        for p, places, fitted in self.explanations:
            moved = [(family, _with(common.get(_law(family.effect, setting), {}), setting))
                     for family, setting in places]
            if moved != places:
                try:
                    fitted = with_places(self.search.base, moved)
                except NotDeterminable:
                    continue
            effects = tuple(_effects_of(fitted, common, sigma))
            hypotheses.append(Hypothesis(p / total, effects, *_alone(fitted, effects)))
        return RunExplained(noise, _whitening(self.run, noise), self.run.table_offset, tuple(hypotheses))


def _found(readings: Readings) -> RunExplained | _Explained:
    run = readings.run
    if run is None or run.size != readings.size:
        return RunExplained()
    try:
        if run.n > MOST_BALLS_JUDGED:
            noise = fitted_with_noise(run, Model(), fit(run), False).noise
            return RunExplained(noise, _whitening(run, noise), run.table_offset)
        known = known_of(run)
        if known.claims.members or known.claims.unnamed:
            return _Explained(readings, known.search, known.explained)
    except NotDeterminable:
        return RunExplained()
    noise = known.search.base.noise
    return RunExplained(noise, _whitening(run, noise), run.table_offset)


def _whitening(run: Run, noise: Noise) -> Whitening | None:
    made = noise.whitening(run)
    return None if made.is_plain else made


def _places_of(search: RunSearch, fitted: Fit) -> list[Place]:
    """Return the places of the explanation that a fit is one of."""
    posterior = search.posterior
    for one in posterior.explanations():
        places = posterior.places((one.members, one.noise))
        if [setting for _, setting in places] == [*fitted.settings] and [
                family.effect for family, _ in places] == [term.effect for term in fitted.model.terms]:
            return [*places]
    raise ValueError('expected a fit of an explanation, found another one')


def _law(effect: Effect, setting: Setting) -> tuple[str, frozenset[tuple[str, object]]]:
    """Return by what the law of an effect is known in several runs: its name and its choices."""
    return effect.name, frozenset((one.name, setting[one.name]) for one in effect.searched
                                  if one.kind == 'choice' and one.name in setting)


def _with(values: Mapping[str, float], setting: Setting) -> Setting:
    return Setting({**setting, **values}) if values else setting


def _constants(found: Sequence[_Explained]) -> Constants:
    """Return constants that the likeliest explanations of several runs have in common, means weighted by their U."""
    by: dict[tuple[str, frozenset[tuple[str, object]]], list[dict[str, tuple[float, float]]]] = {}
    for run in found:
        met = set[Hashable]()
        for term, effect in zip(run.likeliest.model.terms, run.likeliest.effects, strict=True):
            law = _law(term.effect, effect.setting)
            names = [one.name for one in term.effect.constants if one.kind == 'scale' and one.name in effect.setting]
            if names and law not in met:
                by.setdefault(law, []).append({one.name: (one.value, one.u) for one in effect.parameters
                                               if one.name in names})
            met.add(law)
    out: dict[tuple[str, frozenset[tuple[str, object]]], dict[str, float]] = {}
    for law, several in by.items():
        for name in several[0]:
            value, u = np.array([one[name] for one in several]).T
            log, weight = np.log(value), np.divide(value, u, out=np.zeros(u.shape), where=u > 0)**2
            if len(several) < 2 or not weight.any():
                continue
            mean = float(log @ weight / weight.sum())
            if scipy.special.chdtrc(len(several) - 1, weight @ (log - mean)**2) >= UNLIKELY:
                out.setdefault(law, {})[name] = float(np.exp(mean))
    return out


def _effects_of(fitted: Fit, common: Constants, sigma: float) -> Iterable[JointEffect]:
    """Yield the effects of a fit of a run."""
    run, joint, start, tangent = fitted.run, fitted.joint, 0, fitted.joint.q
    every = rotate_z(run.table_offset, joint.every).reshape(len(joint.every), 3 * run.size)
    for term, effect in zip(fitted.model.terms, fitted.effects, strict=True):
        setting, width = effect.setting, len(term.effect.amplitudes(run, effect.setting))
        law = _law(term.effect, setting)
        refined = [one for one in term.effect.searched if one.kind in REFINED and one.name in setting]
        keys = tuple((*law, one.name) if one.name in common.get(law, {}) else place
                     for place, one in enumerate(refined))
        end = start + width
        yield JointEffect(effect, every[start:end], every[tangent:tangent + len(refined)], keys,
                          sum(one.kind == 'instant' and one.name in setting for one in term.effect.searched),
                          _size(joint.whitening.apply(joint.columns[start:end]), joint.whitening.apply(
                              effect.displacement[None])[0], sigma))
        start, tangent = end, tangent + len(refined)


def _size(columns: Floats, displacement: Floats, sigma: float) -> Floats:
    """Return the size of an effect as the search takes it, white columns (q, N, 3): that found, along all it can do."""
    flat = columns.reshape(len(columns), -1)
    found = float(np.linalg.norm(displacement)) / sigma
    return np.asarray(np.clip(found, SIZES[0], SIZES[-1]) * independent(flat @ flat.T, 1e-9 * float(np.sum(flat**2))))


def _alone(fitted: Fit, effects: Sequence[JointEffect]) -> tuple[Floats, Floats, Floats]:
    """Return gram, told and size of a Hypothesis, of a fit of its effects."""
    space = fitted.joint.space
    rows = space.residual(fitted.joint.columns).reshape(fitted.joint.q, 3 * fitted.run.size)
    left = space.residual((observed(fitted.run) - fitted.beyond)[None]).ravel()
    return rows @ rows.T, rows @ left, _together(effects)


def _together(effects: Sequence[JointEffect]) -> Floats:
    """Return the sizes (k, q) of several effects."""
    return np.asarray(scipy.linalg.block_diag(*(one.size for one in effects))) if effects else np.zeros((0, 0))


def log_bf_of(gram: Floats, told: Floats, size: Floats, sigma: float) -> float:
    """Return the log Bayes factor of columns with the products `gram` (q, q), and `told` (q,) with what is left; size:
    R (k, q), as of JointEffect; sigma: of the noise, m."""
    return float(Solution(size @ gram @ size.T).log_bayes_factor(size @ told / sigma))


def visible_of(beside: BesideBase, share: Callable[[int, Floats], float], least: float) -> BesideBase:
    """Return the same without the effects of which the readings of all runs show too little; share: of the columns
    (q, 3 N) of the run at a place what they show; least: from which on that is enough.

    A hypothesis keeps its probability, and what the run alone says of all its effects: its prior is that of all."""
    runs = []
    for place, run in enumerate(beside.runs):
        kept = [replace(one, effects=tuple(effect for effect in one.effects
                                           if share(place, effect.columns) >= least)) for one in run.hypotheses]
        runs.append(replace(run, hypotheses=tuple(kept)))
    return replace(beside, runs=tuple(runs))

# SPDX-License-Identifier: Apache-2.0
"""The one decision whether a model fits a run: its outcome and the facts behind it; words/verdict_words.py says it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from rosette_ros.core.diagnosis.limits import SURE
from rosette_ros.core.run.records import Floats, Run, resolution_of
from rosette_ros.core.run.remarks import Remark, RemarkKind
from rosette_ros.core.uncertainty.stated_environment import Unseen

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.diagnosis.posterior import Cause, Claim
    from rosette_ros.core.model.least_squares import Fit, Parameter
    from rosette_ros.core.model.noise import Group

UNLIKELY = 0.01
"""Probability of lack of fit below which readings scatter more than stated.

The chi square test (F test where the repeatability has degrees of freedom) gives the probability that noise of the
stated repeatability leaves as much. At 5 % one sound run of twenty would be refused, too many where a cell measures
every day; at 1e-6 a repeatability stated a third too small would pass on a plate of 6 balls. At 1 % a run of 12 balls
(301 degrees of freedom) is refused from 1.10 times the stated repeatability, one of 6 balls (49) from 1.24 times.
"""
CERTAIN = 4
"""An effect in the model is there where a parameter is so many times its standard uncertainty: by chance 6e-5."""
COARSE = 0.5
"""Step of the readings, over the residual, from which on it is told."""
WRONG = 30.0
"""Residual, over the scatter of all along its axis, beyond which a reading is wrong: no noise of a machine is so."""
MOST_WRONG = 4
"""Wrong readings that are listed."""
TOO_LARGE = 2.0, 1e-3
"""Stated repeatability over the residual, and probability of one as small, from which on it is told."""
OTHER_UNIT = 100.0
"""Ratio of the repeatability of axes from which on a wrong unit is the likelier cause."""
WANDERING = 0.85
"""Correlation from reading to reading above which noise is told as a wander of the frame."""
UNEQUAL = 1.3
"""Ratio of the noise of axes from which on it is told beside what is larger."""


class Outcome(StrEnum):
    """What a run decides about a model."""

    UNIT = 'unit of the readings in doubt'
    FITS = 'fits'
    NAMED = 'named effect missing'
    SUSPECTED = 'effect suspected'
    UNNAMED = 'unnamed effect missing'
    SCATTERS = 'scatters more than stated'
    DOUBTFUL_READINGS = 'fits, readings in doubt'
    NOISE = 'fits with other noise'
    NO_REPEATABILITY = 'cannot be said: no repeatability'
    NOT_DETERMINABLE = 'not determinable'


class Level(StrEnum):
    """How an outcome is shown."""

    GOOD = 'good'
    DOUBTFUL = 'doubtful'
    BAD = 'bad'


LEVELS = {
    Outcome.UNIT: Level.DOUBTFUL, Outcome.FITS: Level.GOOD,
    Outcome.DOUBTFUL_READINGS: Level.DOUBTFUL, Outcome.NAMED: Level.BAD,
    Outcome.SUSPECTED: Level.DOUBTFUL,
    Outcome.UNNAMED: Level.BAD, Outcome.SCATTERS: Level.DOUBTFUL, Outcome.NO_REPEATABILITY: Level.DOUBTFUL,
    Outcome.NOISE: Level.DOUBTFUL, Outcome.NOT_DETERMINABLE: Level.BAD}


class Judged:
    """What has an outcome; unseen: what U contains of what the order hides, None where that does not matter."""

    outcome: Outcome
    unseen: Unseen | None

    @property
    def level(self) -> Level:
        """How the outcome is shown."""
        return LEVELS[self.outcome]

    @property
    def model_fails(self) -> bool:
        """Whether the model, with the stated repeatability, is refuted."""
        return self.outcome in (Outcome.NAMED, Outcome.UNNAMED, Outcome.SUSPECTED, Outcome.SCATTERS)


@dataclass(frozen=True)
class VerdictText(Judged):
    """A verdict in words, as messages and logs carry it: one or two sentences for a person, and what to do next.

    limits: what the run cannot tell, a sentence each; messages carry neither them nor `unseen`."""

    outcome: Outcome
    sentence: str
    action: str
    limits: tuple[str, ...] = field(default=(), compare=False)
    unseen: Unseen | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Residual:
    """The residual of a fit against the stated repeatability.

    rms, repeatability: per coordinate, m; p: probability that noise of that repeatability leaves as much; both None
    where none is stated; quietest: noise of the quietest part, over that of all.
    """

    rms: float
    repeatability: float | None
    p: float | None
    quietest: float

    @property
    def scatters(self) -> bool:
        """Whether it is more than the stated repeatability leaves."""
        return self.p is not None and self.p < UNLIKELY


class Interval(NamedTuple):
    """Between which times, s since the first reading, and which readings an instant lies, with its probability."""

    low: float
    high: float
    last: int
    first: int
    probability: float


@dataclass(frozen=True)
class MissingEffect:
    """What a model lacks: a name, its setting, and where the moments of it lie.

    A base term has no setting, no parameters and no cause; cause: what moves with what, as far as the run tells;
    alternatives: names that the run cannot tell from it, each with its probability; together: the probability that one
    of all these is there; before, after: rms of the residual, m, without it and with it,
    beside what stands above it; time_unit: as of Run, that of times in setting and moments."""

    name: str
    setting: Mapping[str, float | str] = field(default_factory=dict)
    moments: Mapping[str, Interval] = field(default_factory=dict)
    cause: 'Cause | None' = None
    alternatives: tuple[tuple[str, float], ...] = ()
    together: float = 1.0
    parameters: tuple['Parameter', ...] = ()
    before: float = np.nan
    after: float = np.nan
    time_unit: str = 's'

    @property
    def depth(self) -> int:
        """How much is known: 2, its law; 1, what moves with what; 0, only that it is one of several names."""
        if self.cause is None or self.cause.law_certain:
            return 2
        return int(self.cause.probability >= min(SURE, self.together))

    @property
    def probability(self) -> float:
        """The probability that what is said of it is true: its law, what moves with what, or one of the names."""
        if self.cause is None:
            return 1.0
        return (self.together, self.cause.probability, self.cause.law_probability)[self.depth]


class UnnamedMotion(Protocol):
    """What the library has no name for: sets of variables of which one drives it, likeliest first, and what moves."""

    @property
    def alternatives(self) -> tuple[frozenset[str], ...]:
        """Sets of variables that the run cannot distinguish."""

    @property
    def motion(self) -> str:
        """Which body moves along what."""

    @property
    def setting(self) -> Mapping[str, float | str]:
        """The setting of its free course."""

    @property
    def probability(self) -> float:
        """The probability that it is there."""


@dataclass(frozen=True)
class WrongReading:
    """A reading that is wrong: its number, where it was, s after the first one (NaN where times only count readings),
    and by how much along which axis, m."""

    number: int
    table_position: int
    ball: int
    time: float
    size: float
    axis: str


@dataclass(frozen=True)
class NoiseFacts:
    """In what the noise of a run is other than white and equal.

    resolution: to which readings are rounded, m; worse: axes that repeat worse than others, `than`, and how many times;
    tail, tail_dof: what stands out by itself, `reading` or `coordinate`, and degrees of freedom of its Student
    distribution; noisiest, factor: groups of which one scatters so many times as much as the others; walk: of the frame
    over the run, m; wander, readings: of the frame, m, within so many readings; correlation: of neighbouring readings.
    """

    resolution: float = 0.0
    worse: tuple[tuple[str, float], ...] = ()
    than: str = ''
    tail: str = ''
    tail_dof: float = 0.0
    noisiest: 'tuple[Group, ...]' = ()
    factor: float = 1.0
    walk: float = 0.0
    wander: float = 0.0
    readings: float = 0.0
    correlation: float = 0.0

    @property
    def is_other(self) -> bool:
        """Whether it is other than white and equal in anything."""
        return self != NoiseFacts()


@dataclass(frozen=True)
class Verdict(Judged):
    """The outcome and the facts behind it.

    before, after: the residual of the model as given and with all that it lacks; missing: strongest first; unnamed:
    structure without a name; doubtful: names that are likely, but not enough to be said, each with its probability;
    not_needed: effects of the model that the run does not ask for; hidden: effects that the order cannot show, the
    largest bias on the curves first; outliers: readings among the missing; wrong, more_wrong: readings that are far off
    in the rest, and how many more there are; too_large: stated repeatability over what the readings show, 0 where that
    is no more than chance; present: effects of the model that are surely there, with their rms, m; noise; step: to
    which readings are rounded, m, where that is a part of the rest and no kind of noise; remarks: on the readings;
    has_motions: whether the model has the error motions of the table; reason: why the model cannot be determined, and
    effects it has beyond its base, `added`.
    """

    outcome: Outcome
    before: Residual | None = None
    after: Residual | None = None
    missing: tuple[MissingEffect, ...] = ()
    unnamed: tuple[UnnamedMotion, ...] = ()
    doubtful: tuple[tuple[str, float], ...] = ()
    not_needed: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    outliers: tuple[WrongReading, ...] = ()
    wrong: tuple[WrongReading, ...] = ()
    more_wrong: int = 0
    too_large: float = 0.0
    present: tuple[tuple[str, float], ...] = ()
    noise: NoiseFacts = field(default_factory=NoiseFacts)
    step: float = 0.0
    remarks: tuple[Remark, ...] = ()
    has_motions: bool = True
    reason: str = ''
    added: tuple[str, ...] = ()
    unseen: Unseen | None = None

    @property
    def look_alikes(self) -> tuple[str, ...]:
        """Effects that the run cannot distinguish from a missing one."""
        return tuple(sorted({name for one in self.missing for name, _ in one.alternatives}))

    @property
    def unexplained(self) -> bool:
        """Whether something is left that no named effect explains."""
        return bool(self.unnamed or (self.after and self.after.scatters))


def decide(fit: 'Fit', final: 'Fit', missing: Sequence[str] = (), unnamed: Sequence[UnnamedMotion] = (),
           claims: Sequence['Claim'] = (), causes: Sequence['Cause'] = (), doubtful: Sequence['Claim'] = (),
           hidden: Sequence[str] = (), not_needed: Sequence[str] = (),
           moments: Sequence[Mapping[str, Interval]] = ()) -> Verdict:
    """Return the Verdict on a model.

    fit: of the model as given; final: with all named effects that are claimed, `missing`; claims: what is known of
    each; causes, moments: of each effect that `final` has beyond `fit`; the others as of Verdict.
    """
    before, after, noise = _residual(fit), _residual(final), noise_facts(final)
    wrong, run = wrong_readings(final), fit.run
    step = resolution_of(run.centre)
    doubts = {remark.kind for remark in run.remarks}
    if RemarkKind.UNIT_OF_COORDINATES in doubts:  # nothing follows from such readings
        return Verdict(Outcome.UNIT, before, after, remarks=run.remarks)
    lacks = _missing(fit, final, missing, {one.name: one for one in claims}, causes, moments)
    if lacks or unnamed:
        surest = max([one.probability for one in lacks] + [one.probability for one in unnamed])
        outcome = (Outcome.SUSPECTED if surest < SURE else
                   Outcome.NAMED if any(one.probability >= SURE for one in lacks) else Outcome.UNNAMED)
    elif after.scatters:
        outcome = Outcome.SCATTERS
    elif run.repeatability is None:
        outcome = Outcome.NO_REPEATABILITY
    elif run.remarks or wrong:
        outcome = Outcome.DOUBTFUL_READINGS
    else:
        outcome = Outcome.NOISE if noise.is_other else Outcome.FITS
    return Verdict(
        outcome, before, after, lacks,
        tuple(unnamed), tuple((one.name, one.probability) for one in doubtful), tuple(not_needed), tuple(hidden),
        _outliers(final, len(fit.effects)), wrong[:MOST_WRONG],
        max(len(wrong) - MOST_WRONG, 0), _too_large(final),
        tuple((one.name, one.rms) for one in fit.effects
              if any(abs(part.value) > CERTAIN * part.u for part in one.parameters)),
        noise, step if COARSE * final.rms < step and not (
            final.noise.resolution or RemarkKind.ROUNDED in doubts) else 0.0,
        tuple(remark for remark in run.remarks
              if not (final.noise.resolution and remark.kind is RemarkKind.ROUNDED)),  # a kind of noise
        'table_motions' in fit.model.base)


def not_determinable(reason: str, added: Sequence[str] = ()) -> Verdict:
    """Return the Verdict on a run from which the model cannot be determined.

    reason: that of the error, in one line; added: the effects in the model beyond its base.
    """
    return Verdict(Outcome.NOT_DETERMINABLE, reason=reason, added=tuple(added))


def _residual(fit: 'Fit') -> Residual:
    return Residual(fit.rms, fit.run.repeatability, fit.lack_of_fit_p, fit.noise.quietest)


def _missing(fit: 'Fit', final: 'Fit', names: Sequence[str],
             claims: Mapping[str, 'Claim'], causes: Sequence['Cause'],
             moments: Sequence[Mapping[str, Interval]]) -> tuple[MissingEffect, ...]:
    """Return what a model lacks: base terms, then effects with their settings, the one that explains most first."""
    if not names:
        return ()
    known = len(fit.effects)
    found = list(zip(final.model.terms[known:], final.effects[known:]))
    terms = [name for name in names if name not in {term.name for term, _ in found}]
    errors = [fit.rms] * bool(terms) + nested_rms(final, known)
    errors[0], errors[-1] = fit.rms, final.rms
    out = [MissingEffect(name, before=errors[0], after=errors[1]) for name in terms]
    for place, ((term, one), cause, when) in enumerate(zip(found, causes, moments or [{}] * len(found)), bool(terms)):
        claim = claims[term.name]
        out.append(MissingEffect(
            term.name, one.setting, when, cause, claim.alternatives,
            claim.together, one.parameters, errors[place], errors[place + 1], final.run.time_unit))
    return tuple(out)


def nested_rms(final: 'Fit', known: int) -> list[float]:
    """Return the rms of the residual with the first `known` effects of a model, with one more, ... with all, m."""
    joint, run = final.joint, final.run
    size = 3 * run.size
    moved = sum((one.displacement for one in final.effects), np.zeros_like(final.residual))
    left = joint.space.residual((final.residual + moved)[None]).reshape(size)
    pairs = [(term.effect, one.setting) for term, one in zip(final.model.terms, final.effects)]
    widths = [len(effect.amplitudes(run, setting)) for effect, setting in pairs]
    searched = [sum(one.kind != 'choice' for one in effect.searched) for effect, _ in pairs]
    columns, used = (np.cumsum([0, *counts]) for counts in (widths, np.add(widths, searched)))
    basis = np.linalg.qr(joint.space.residual(joint.columns).reshape(-1, size).T).Q
    falls = np.concatenate([[0.0], np.cumsum((left @ basis)**2)])
    rss, dof = np.maximum(left @ left - falls[columns], 0.0), final.dof + used[-1] - used
    return [float(one) for one in np.sqrt(rss / dof)[known:]]


def _too_large(final: 'Fit') -> float:
    """Return the stated repeatability over what the readings show, where that is more than chance, else 0."""
    known, (ratio, p_small) = final.run.repeatability, TOO_LARGE
    return known / final.rms if known and known > ratio * final.rms > 0 and final.p_of_small < p_small else 0.0


def _reading(run: Run, row: int, size: float, axis: str) -> WrongReading:
    return WrongReading(row + 1, int(run.table_position[row]), int(run.ball[row]),
                        float(run.time[row] - run.time[0]) if run.time_unit == 's' else np.nan,
                        float(size), axis)


def _outliers(final: 'Fit', known: int) -> tuple[WrongReading, ...]:
    """Return the wrong readings that a fit has as effects beyond the first ones, which are known."""
    found = []
    for effect in final.effects[known:]:
        if 'reading' in effect.setting:
            largest = max(effect.parameters, key=lambda one: abs(one.value))
            found.append(_reading(final.run, effect.setting.whole('reading') - 1, largest.value,
                                  largest.name.removeprefix('d_')))
    return tuple(found)


def wrong_readings(final: 'Fit') -> tuple[WrongReading, ...]:
    """Return the readings that are farther off than noise can be, the farthest first."""
    run, size = final.run, np.abs(final.residual)
    # 1.4826 times the median is the standard deviation of normal noise; a third of a step, more than that of rounding
    scatter = np.maximum(1.4826 * np.median(size, axis=0), resolution_of(run.centre) / 3)
    if final.noise.resolution or not np.all(scatter > 0):
        return ()
    off = size / scatter
    rows = np.flatnonzero(np.any(off > WRONG, axis=1))
    rows = rows[np.argsort(-off[rows].max(axis=1), kind='stable')]
    return tuple(_reading(run, row, size[row, axis], 'xyz'[axis])
                 for row, axis in zip(rows.tolist(), off[rows].argmax(axis=1).tolist()))


def noise_facts(fit: 'Fit') -> NoiseFacts:
    """Return in what the noise of a fit is other than white and equal."""
    noise, sigma, run = fit.noise, fit.sigma, fit.run
    worse, than = _unequal((noise.axes**2 + noise.wander * (noise.phi < 1))**0.5, bool(noise.wander.any()))
    facts = NoiseFacts(noise.resolution, worse, than, noise.tail, noise.tail_dof if noise.tail else 0.0)
    if noise.by:
        typical = sorted(noise.factors)[noise.factors.size // 2]
        facts = replace(facts, noisiest=tuple(noise.noisiest(run)), factor=float(noise.factors.max() / typical))
    if noise.wander.any():
        axis = int(noise.wander.argmax())
        step, white = float(noise.wander[axis]), float(noise.axes[axis]**2)
        if noise.phi == 1:
            facts = replace(facts, walk=sigma * (step * run.size)**0.5)
        elif noise.phi > WANDERING:
            facts = replace(facts, wander=sigma * step**0.5, readings=1 / (1 - noise.phi))
        else:
            facts = replace(facts, correlation=noise.phi * step / (step + white))
    return facts


def _unequal(size: Floats, wanders: bool) -> tuple[tuple[tuple[str, float], ...], str]:
    """Return which axes repeat worse, how many times, and than which; size: of the noise along x, y, z."""
    x, y, z = map(float, size)
    if x == y:
        if z == x or (wanders and max(z / x, x / z) < UNEQUAL):
            return (), ''
        return ((('z', z / x),), 'xy') if z > x else ((('xy', x / z),), 'z')
    best, *others = size.argsort().tolist()
    worse = sorted(place for place in others if place == others[-1] or size[place] >= UNEQUAL * size[best])
    return tuple(('xyz'[place], float(size[place] / size[best])) for place in worse), 'xyz'[best]

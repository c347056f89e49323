# SPDX-License-Identifier: Apache-2.0
"""The one decision whether a model fits a run: its outcome and the facts behind it; words/verdict_words.py says it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.noise_facts import NoiseFacts, noise_facts
from rosette_ros.core.diagnosis.wrong_readings import WrongReading, outliers, wrong_readings
from rosette_ros.core.run.records import UNLIKELY
from rosette_ros.core.run.remarks import Remark, RemarkKind
from rosette_ros.core.sight.limits import SURE
from rosette_ros.core.uncertainty.stated_environment import Unseen

if TYPE_CHECKING:  # nodes and clients pass a verdict on: they start faster without what makes a fit
    from rosette_ros.core.model.least_squares import Fit

CERTAIN = 4
"""An effect in the model is there where a parameter is so many times its standard uncertainty: by chance 6e-5."""
TOO_LARGE = 2.0
"""Stated repeatability over the residual from which on it is told, where that is no chance."""


class Level(StrEnum):
    """How an outcome is shown."""

    GOOD = 'good'
    DOUBTFUL = 'doubtful'
    BAD = 'bad'


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

    @property
    def level(self) -> Level:
        """How it is shown: only a model that fits is good, one that is refuted or cannot be determined is bad."""
        if self is Outcome.FITS:
            return Level.GOOD
        is_bad = self in (Outcome.NAMED, Outcome.UNNAMED, Outcome.NOT_DETERMINABLE)
        return Level.BAD if is_bad else Level.DOUBTFUL


class Judged:
    """What has an outcome; unseen: what U contains of what the order hides, None where that does not matter."""

    outcome: Outcome
    unseen: Unseen | None

    @property
    def level(self) -> Level:
        """How the outcome is shown."""
        return self.outcome.level

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

    rms, repeatability: per coordinate, m; p: probability that noise of that repeatability leaves as much, that of the
    quietest part where the noise is not equal; both None where none is stated; quietest: noise of the quietest part,
    over that of all; p_equal: the same probability where all readings count alike; rounding: standard deviation of the
    errors of rounding, m, which noise of that repeatability has beside it, 0 where they are of no account.
    """

    rms: float
    repeatability: float | None
    p: float | None
    quietest: float
    p_equal: float | None = None
    rounding: float = 0.0

    @property
    def is_above(self) -> bool:
        """Whether it is more than the stated repeatability leaves where all readings count alike."""
        return self.scatters or (self.p_equal is not None and self.p_equal < UNLIKELY)

    @property
    def scatters(self) -> bool:
        """Whether it is more than the stated repeatability leaves."""
        return self.p is not None and self.p < UNLIKELY


@dataclass(frozen=True)
class Verdict(Judged):
    """The outcome and the facts behind it.

    outcome: of `decide`; before, after: the residual of the model as given and with all that it lacks; missing:
    strongest first; unnamed: motions without a name; is_open: whether further readings may tell more of these;
    doubtful: names that are likely, but not enough to be said, each with its probability; not_needed: effects of the
    model that the run does not ask for; hidden: effects that the order cannot show, the largest bias on the curves
    first; outliers: readings among the missing; wrong: readings that are far off in the rest, the farthest first;
    too_large: stated repeatability over what the readings show, 0 where that is no more than chance; present: effects
    of the model that are surely there, with their rms, m; noise; remarks: on the readings;
    has_motions: whether the model has the error motions of the table; reason: why the model cannot be determined, and
    effects it has beyond its base, `added`; unseen: as of Judged.
    """

    outcome: Outcome
    before: Residual | None = None
    after: Residual | None = None
    missing: tuple[MissingEffect, ...] = ()
    unnamed: tuple[MissingEffect, ...] = ()
    is_open: bool = False
    doubtful: tuple[tuple[str, float], ...] = ()
    not_needed: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    outliers: tuple[WrongReading, ...] = ()
    wrong: tuple[WrongReading, ...] = ()
    too_large: float = 0.0
    present: tuple[tuple[str, float], ...] = ()
    noise: NoiseFacts = field(default_factory=NoiseFacts)
    remarks: tuple[Remark, ...] = ()
    has_motions: bool = True
    reason: str = ''
    added: tuple[str, ...] = ()
    unseen: Unseen | None = None

    @property
    def has_structure(self) -> bool:
        """Whether the residual is more than the repeatability, or neighbouring readings are correlated in it."""
        return self.noise.is_correlated or bool(self.after and self.after.is_above)

    @property
    def look_alikes(self) -> tuple[str, ...]:
        """Effects that the run cannot distinguish from a missing one."""
        return tuple(sorted({name for one in self.missing for name, _ in one.alternatives}))

    @property
    def unexplained(self) -> bool:
        """Whether something is left that no named effect explains."""
        return bool(self.unnamed or (self.after and self.after.scatters))


def facts_of(fit: 'Fit', final: 'Fit', unnamed: tuple[MissingEffect, ...] = ()) -> Verdict:
    """Return what fits say by themselves, of the model as given and with all named effects that are claimed.

    unnamed: motions without a name, which are in neither."""
    return Verdict(
        Outcome.FITS, _residual(fit), _residual(final), unnamed=unnamed, noise=noise_facts(final, bool(unnamed)),
        remarks=fit.run.remarks, outliers=outliers(final, len(fit.effects)), wrong=wrong_readings(final),
        too_large=_too_large(final), has_motions='table_motions' in fit.model.base,
        present=tuple((one.name, one.rms) for one in fit.effects
                      if any(abs(part.value) > CERTAIN * part.u for part in one.parameters)))


def decide(facts: Verdict) -> Verdict:
    """Return a verdict with the outcome that follows from its facts."""
    if any(remark.kind is RemarkKind.UNIT_OF_COORDINATES for remark in facts.remarks):  # nothing follows from these
        return Verdict(Outcome.UNIT, facts.before, facts.after, remarks=facts.remarks)
    return replace(facts, outcome=_outcome(facts))


def _outcome(facts: Verdict) -> Outcome:
    lacking, after = [one.probability for one in facts.missing], facts.after
    if lacking or facts.unnamed:
        if max(lacking + [one.probability for one in facts.unnamed]) < SURE:
            return Outcome.SUSPECTED
        return Outcome.NAMED if any(one >= SURE for one in lacking) else Outcome.UNNAMED
    if after and after.scatters:
        return Outcome.SCATTERS
    if after and after.repeatability is None:
        return Outcome.NO_REPEATABILITY
    if (facts.remarks or facts.wrong) and not facts.has_structure:
        return Outcome.DOUBTFUL_READINGS
    return Outcome.NOISE if facts.noise.is_other else Outcome.FITS


def not_determinable(reason: str, added: Sequence[str] = ()) -> Verdict:
    """Return the Verdict on a run from which the model cannot be determined.

    reason: that of the error, in one line; added: the effects in the model beyond its base.
    """
    return Verdict(Outcome.NOT_DETERMINABLE, reason=reason, added=tuple(added))


def _residual(fit: 'Fit') -> Residual:
    return Residual(fit.rms, fit.run.repeatability, fit.lack_of_fit_p, fit.noise.quietest, fit.equal_p,
                    fit.run.rounding if fit.step else 0.0)


def _too_large(final: 'Fit') -> float:
    """Return the stated repeatability over what the readings show, where that is more than chance, else 0."""
    known = final.run.repeatability
    is_larger = known is not None and known > TOO_LARGE * final.rms > 0 and final.p_of_small < UNLIKELY
    return known / final.rms if known and is_larger else 0.0

# SPDX-License-Identifier: Apache-2.0
"""The next readings of a run: the block from which its explanations are expected to part most.

    found = next_readings(run, model, readings=12, until=0.95)
    found.is_settled     nothing more has to be measured
    found.targets        else a Scheme of the block, in measuring order; None where no block helps (found.is_hopeless)

A run is settled when the log odds of each name reach logit(until), for or against. What the explanation i, if it is
true, still needs against j is therefore

    N_ij = logit(until) - log odds now of the name in doubt in which they differ, as i has it; the largest of these

and the doubt is the sum of p_i p_j over the pairs that differ in such a name: the probability that i is true and j is
what another draw would have said. The block is taken that removes most of the doubt per unit of time,

    sum_ij p_i p_j / (n_ij T)

with T its time, moves, waits and touches included, and n_ij the number of such blocks that are expected to be needed
(predictions.py). For a single pair that is the shortest expected time until it is settled; of several, those that end
the most doubt in the least time come first, which makes the doubt, summed over time, least (Smith, Naval Research
Logistics Quarterly 3 (1956) 59). So a block that settles wins over one that only starts, unless many of the latter are
quicker; of those that settle the quickest wins; and what a block tells beyond that counts nothing, however long the
wait. Where at the rate of every block the doubt would last for more readings than the run has, none is taken.
Information per time alone (Lindley, Ann. Math. Stat. 27 (1956) 986) does not know what is needed: it never waits,
because the first reading always tells something at once.

A pure function of its arguments: the same run gives the same block, in a replay too. These are facts;
words/settling_words.py says them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.diagnosis.posterior import Explanation, Posterior
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.block_ways import NEXT, BlockWay, continued, last_sense, ways
from rosette_ros.core.planning.predictions import (
    Predictor,
    best_fit,
    expected_share,
    information,
    members_of,
    share_of_need,
)
from rosette_ros.core.planning.size import refuse_more
from rosette_ros.core.run.records import Floats, Ints, Run
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.run.touches import USUAL_PACE, Pace
from rosette_ros.core.sight.limits import LISTED

BLOCK, UNTIL = 12, 1 - LISTED
"""Readings of a block, and probability from which on an explanation is settled, unless others are asked for."""
MOST = 10
"""Explanations that a block is chosen by."""
NOTICED = 1e-9
"""Share by which a variance has to be lower for another CMM position to be taken."""
LEADING = 5
"""Explanations whose way is shown."""
FINALISTS = 2
"""Blocks with each wait that are calculated exactly, as they would be measured."""


@dataclass(frozen=True)
class Separation:
    """Two explanations that are in doubt; expected: the probability, of these two, that readings are
    expected to give the first if it is true."""

    first: Explanation
    second: Explanation
    expected: float

    @property
    def now(self) -> float:
        """The probability of the first of these two."""
        return self.first.probability / (self.first.probability + self.second.probability)


@dataclass(frozen=True, eq=False)
class NextReadings:
    """What to measure next, and why.

    contenders: the explanations, the likeliest first; uncertainty: U (k = 2) of the worst point of the curves now, m,
    tilts and turns at the ball circle; is_settled: whether every name has the wanted probability to be there, or not to
    be, and U the wanted size where one is wanted; targets: the readings, in the order of measuring and as the cell
    drives: turned as `approach` and after `wait` says; None where it is settled, or no block helps; gain: expected
    information on the explanations, nats; duration: s from the last reading to the end of the block, moves and touches
    included; separates: of the explanations in doubt the two that the block separates best, None where none are;
    expected_uncertainty: U after the block, m; is_hopeless: whether it is not settled and as many readings again would
    not settle it.
    """

    contenders: tuple[Explanation, ...]
    uncertainty: float
    is_settled: bool
    targets: Scheme | None = None
    gain: float = 0.0
    duration: float = 0.0
    separates: Separation | None = None
    expected_uncertainty: float = np.inf
    is_hopeless: bool = False

    @property
    def likely(self) -> tuple[Explanation, ...]:
        """The likeliest explanations: those that a block is chosen by."""
        return self.contenders[:MOST]


def next_readings(run: Run, model: Model | None = None, readings: int = BLOCK, pace: Pace = USUAL_PACE,
                  until: float = UNTIL, uncertainty: float | None = None,
                  refused: Sequence[Scheme] = ()) -> NextReadings:
    """Return the NextReadings of a run under a model (the base model if none is given).

    readings: most in the block; pace: of the cell; until: probability from which on an explanation is settled;
    uncertainty: U from which on the curves are, m, None for any; refused: blocks that the CMM does not take, none of
    which is given again. Raises as `diagnose`, and InvalidPlan for a plate of more than MOST_BALLS.
    """
    refuse_more(run.n, 'next readings')
    found = standing(run, model, until, uncertainty)
    if found.is_settled:
        return found
    search = search_of(run, model or Model())
    parting = _parting(search, found, readings, pace, until, refused) if found.separates else None
    if parting and (parting.targets or uncertainty is None or found.uncertainty <= uncertainty):
        return parting
    lowering = _lowering(search, replace(found, separates=None), readings, pace, refused)
    return parting if parting and lowering.is_hopeless else lowering


def standing(run: Run, model: Model | None = None, until: float = UNTIL,
             uncertainty: float | None = None) -> NextReadings:
    """Return what is known and what is in doubt, without a block; arguments and errors as of `next_readings`."""
    search = search_of(run, model or Model())
    contenders, now = contenders_of(search.posterior), expanded(best_fit(search))
    pair = in_doubt(contenders, until)
    return NextReadings(contenders, now, not pair and (uncertainty is None or now <= uncertainty), separates=pair,
                        expected_uncertainty=now)


@dataclass(frozen=True)
class SettlingStep:
    """What was known after so many readings of a run: its explanations, the likeliest first, and U, m."""

    readings: int
    contenders: tuple[Explanation, ...]
    uncertainty: float


def step_of(found: NextReadings, readings: int) -> SettlingStep:
    """Return the SettlingStep of what was found after so many readings."""
    return SettlingStep(readings, found.contenders, found.uncertainty)


def steps_of(run: Run, model: Model | None, sizes: Sequence[int]) -> tuple[SettlingStep, ...]:
    """Return what was known after each number of readings of a run, ascending; errors as of `next_readings`."""
    return tuple(step_of(standing(run if size == run.size else run.take(np.arange(size)), model), size)
                 for size in sizes if size <= run.size)


def leading(steps: Sequence[SettlingStep], most: int = LEADING) -> dict[tuple[str, ...], list[float]]:
    """Return the probabilities, step by step, of the explanations that were ever the likeliest ones, by their names;
    most: so many, those of the largest probability at any step."""
    found = [{one.members: one.probability for one in step.contenders} for step in steps]
    top = Counter[tuple[str, ...]]()
    for step in found:
        top.update({names: p - top[names] for names, p in step.items() if p > top[names]})
    return {names: [step.get(names, 0.0) for step in found] for names, _ in top.most_common(most)}


def _parting(search: RunSearch, found: NextReadings, readings: int, pace: Pace, until: float,
             refused: Sequence[Scheme]) -> NextReadings:
    """Return what was found with the block that removes most of the doubt per unit of time."""
    run, pair = search.run, found.separates
    assert pair is not None
    likely = list(dict.fromkeys([pair.first, pair.second, *found.likely]))[:MOST]
    p = np.array([one.probability for one in likely])
    p /= p.sum()
    predictor = Predictor(search, [members_of(search.posterior, one.members) for one in likely], p)
    need = _needed(found.contenders, [frozenset(one.members) for one in likely], until)
    guessed = sorted((_guessed(predictor, way, need, readings, pace) for way in ways(run)), key=lambda one: -one[0])
    doubt, made = float((p[:, None] * p)[~np.isnan(need)].sum()), []
    for wait in dict.fromkeys(block.wait[0] for _, block in guessed):
        some = [block for _, block in guessed if block.wait[0] == wait]
        for block in [block for block in some if not any(same(block, one) for one in refused)][:FINALISTS]:
            size, twice = block.ball.size, np.tile(np.arange(block.ball.size), 2)
            longer = continued(run, _taken(block, twice, block.wait[twice]), pace)
            predicted, duration = predictor.predicted(longer), float(longer.time[run.size + size - 1] - run.time[-1])
            square = predicted.distances(size)
            removed = _removed(p, square, predicted.distances(2 * size), need)
            if removed * run.size >= doubt * size:
                made.append((removed / duration, duration, block, square))
    if not made:
        return replace(found, is_hopeless=True)
    _, duration, block, square = max(made, key=lambda one: one[0])
    pairs = [(Separation(likely[i], likely[j], until), float(square[i, j]))
             for i, j in np.argwhere(~np.isnan(need)).tolist() if i < j]
    told = [replace(one, expected=expected_share(one.now, distance)) for one, distance in pairs]
    pair = max(told, key=lambda one: (one.first.probability + one.second.probability) * (one.expected - one.now))
    return replace(found, targets=block, gain=float(information(p, square)), duration=duration, separates=pair)


def _needed(contenders: Sequence[Explanation], likely: Sequence[frozenset[str]], until: float) -> Floats:
    """Return the log odds that each of some explanations, by their names, would still need against each other one if it
    were true, (m, m), nan where they differ in no name that is in doubt."""
    wanted, need = scipy.special.logit(until), np.full((len(likely),) * 2, np.nan)
    for name, p in in_names(contenders).items():
        if 1 - until < p < until:
            has = np.array([name in one for one in likely])
            lacks = wanted - np.where(has, 1, -1) * scipy.special.logit(p)
            need = np.fmax(need, np.where(has[:, None] != has, lacks[:, None], np.nan))
    return need


def _removed(p: Floats, square: Floats, twice: Floats, need: Floats) -> float:
    """Return the doubt that a block removes: p_i p_j over the expected number of such blocks, of the pairs in doubt."""
    return float(np.nansum(p[:, None] * p * share_of_need(square, twice, need)))


def _lowering(search: RunSearch, found: NextReadings, readings: int, pace: Pace,
              refused: Sequence[Scheme]) -> NextReadings:
    """Return what was found with the block that lowers U most: readings at some CMM positions, round the table."""
    run, fit, block, best = search.run, best_fit(search), None, np.inf
    while block is None or block.ball.size < readings:
        at, (block, best) = block, (None, np.inf)
        for spot in range(1, run.n + 1):
            some = _round(run, spot, at, readings)
            if some is not None and not any(same(some, one) for one in refused):
                longer = continued(run, some, pace)
                variance = BaseSpace(longer, fit.mean_radius).curve_cofactor() * _lever(fit)**2
                if variance.mean() < best * (1 - NOTICED):
                    block, best, worst = some, float(variance.mean()), float(variance.max())
        if block is None:
            return replace(found, is_hopeless=True)
    duration = float(continued(run, block, pace).time[-1] - run.time[-1])
    return replace(found, targets=block, duration=duration, expected_uncertainty=2 * fit.sigma * worst**0.5)


def _round(run: Run, spot: int, before: Scheme | None, readings: int) -> Scheme | None:
    """Return a block with readings at a CMM position more, at each table position, as far as there are balls; None
    where there are none.

    before: the block so far; readings: most in the block."""
    last = int((before.table_position if before else run.table_position)[-1])
    sense = last_sense(run)
    position = (last - 1 + sense * np.arange(1, run.n + 1)) % run.n + 1
    ball = (spot - position) % run.n + 1
    used = np.isin(ball, run.balls)
    position, ball = position[used], ball[used]
    if before:
        position, ball = (np.concatenate(one) for one in ((before.table_position, position), (before.ball, ball)))
    size = min(position.size, readings)
    return Scheme(run.n, NEXT, 0, position[:size], ball[:size], np.full(size, sense), table_offset=run.table_offset)


def _guessed(predictor: Predictor, way: BlockWay, need: Floats, readings: int, pace: Pace) -> tuple[float, Scheme]:
    """Return about how much of the doubt the readings of a way that tell most remove per second, and these readings."""
    run, every = predictor.run, way.every(predictor.run)
    guess = predictor.predicted(continued(run, every, pace))
    some, square = guess.chosen(readings)
    block = _taken(every, np.sort(some), np.append(every.wait[0], np.zeros(len(some) - 1)))
    duration = float(continued(run, block, pace).time[-1] - run.time[-1])
    return _removed(predictor.p, square, 2 * square, need) / duration, block


def _taken(scheme: Scheme, some: Ints, wait: Floats) -> Scheme:
    """Return some readings of a scheme, with a wait before each."""
    return replace(scheme, **{name: getattr(scheme, name)[some] for name in (
        'table_position', 'ball', 'approach', 'touches', 'session')}, wait=wait)


def contenders_of(posterior: Posterior) -> tuple[Explanation, ...]:
    """Return the explanations of a run, whatever the kind of noise, the likeliest first."""
    out: dict[tuple[str, ...], float] = {}
    for (names, _), p in posterior.p.items():
        out[names] = out.get(names, 0.0) + p
    return tuple(Explanation(names, p) for names, p in sorted(out.items(), key=lambda one: -one[1]))


def in_names(contenders: Sequence[Explanation]) -> dict[str, float]:
    """Return the probability that each name is there."""
    p = Counter[str]()
    for one in contenders:
        p.update(dict.fromkeys(one.members, one.probability))
    return dict(p)


def in_doubt(contenders: Sequence[Explanation], until: float) -> Separation | None:
    """Return the likeliest explanation and the likeliest one that lacks, or has, the name that is most in doubt.

    None where every name has a probability of `until` at least, or of 1 - until at most."""
    best, p = contenders[0], in_names(contenders)
    open_names = [name for name in sorted(p) if 1 - until < p[name] < until]
    if not open_names:
        return None
    name = min(open_names, key=lambda each: abs(p[each] - 0.5))
    return Separation(best, next(one for one in contenders if (name in one.members) != (name in best.members)), until)


def expanded(fit: Fit) -> float:
    """Return U (k = 2) of the worst point of the curves, m, tilts and turns at the ball circle."""
    return float(2 * np.max(fit.error_motions.u * _lever(fit)))


def _lever(fit: Fit) -> Floats:
    """Return by what each curve is a length at the ball circle, (6,)."""
    return np.repeat([1.0, fit.mean_radius], 3)


def same(one: Scheme, other: Scheme) -> bool:
    """Return whether two blocks are the same readings, driven in the same way."""
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ('table_position', 'ball', 'approach', 'wait'))

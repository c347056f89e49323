# SPDX-License-Identifier: Apache-2.0
"""Several runs evaluated as one: what they share, whether the data allow it, curves with uncertainties."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import NOISELESS
from rosette_ros.core.joint.explained_runs import BesideBase, explained_runs, visible_of
from rosette_ros.core.joint.joint_curves import by_likeliest, choices_of, fitted_effects, over_choices
from rosette_ros.core.joint.joint_model import JointModel, TableSet
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.joint.knowledge import JointRemark, Knowledge, angles_of_one_sense, knowledge, pairs_of_senses
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.joint.sharing import ITEMS, Sharing, apart
from rosette_ros.core.joint.sharing_tests import SharingTest, sense_tested, tested
from rosette_ros.core.model.least_squares import HIDDEN_SHARE, FittedEffect, SigmaSource
from rosette_ros.core.run import axes
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.geometry import Floats, Frame
from rosette_ros.core.run.records import CURVES, EXACT, UNLIKELY, ErrorMotions
from rosette_ros.core.run.remarks import Remark, remark
from rosette_ros.core.run.same_readings import in_common, is_once_more
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.hidden_effects import MATTERS, hidden_covariance
from rosette_ros.core.uncertainty.stated_environment import LABORATORY, Environment, Unseen

NEAR, NEARLY_ALONG = 1e-3, 5e-3
"""Table frames that differ by less, m and rad, are two findings of one."""
SAME_PLATE = 0.5
"""Distances of balls differ by less than this share of the median of all turns, where a turn is found."""
MOST_READINGS = 1000
"""Of more readings the covariance of what may be there would take minutes."""
LEAST_DISTANCES = 6
"""Distances, those of four balls, that two runs have in common at least after a turn that is looked at."""


@dataclass(frozen=True, eq=False)
class Reversal:
    """Curves counter-clockwise less clockwise of one table, m and rad, at the angles that both senses have.

    The sign is that of ISO 230-2 and of the effect table_backlash. mean, u_mean: (6,) over the angles; is_known: (6,)
    whether the readings determine the mean; p: chance that noise alone makes so large a reversal; turns: (n, 2) crz
    counter-clockwise and clockwise, rad.
    """

    table: str
    motions: ErrorMotions
    mean: Floats
    u_mean: Floats
    is_known: tuple[bool, ...]
    p: float | None
    turns: Floats

    @property
    def positioning(self) -> dict[str, float | None]:
        """Values of angular positioning after ISO 230-2 from one approach to each angle in each sense, rad.

        B: largest reversal; mean B; M: range of the mean of both senses; E: range of all, E+ and E-: of one sense. None
        where the readings do not determine it: B and E need the mean of the reversal, R and A five approaches in each
        sense."""
        apart, known = self.motions.values[:, 5], self.is_known[5]
        return {'B': float(np.abs(apart).max()) if known else None, 'mean B': float(self.mean[5]) if known else None,
                'M': float(np.ptp(self.turns.mean(axis=1))), 'E': float(np.ptp(self.turns)) if known else None,
                'E+': float(np.ptp(self.turns[:, 0])), 'E-': float(np.ptp(self.turns[:, 1])), 'R': None, 'A': None}


@dataclass(frozen=True, eq=False)
class JointResult:
    """Several runs as one.

    declared: items of the Sharing that a person declared; tests: of what is shared, and of what the data took out of
    the rest; sigma: standard deviation of a coordinate in use, m; sigma_dof: its degrees of freedom; rms: root of the
    residuals' square sum per degree of freedom, m; lack_of_fit_p: chance that noise of the known repeatability leaves
    as much, or None; environment: that is stated, None where none is.
    """

    solution: JointSolution
    declared: frozenset[str]
    tests: tuple[SharingTest, ...]
    sigma: float
    sigma_dof: float
    sigma_source: SigmaSource
    lack_of_fit_p: float | None
    notes: tuple[Remark, ...]
    environment: Environment | None = None

    @property
    def sharing(self) -> Sharing:
        """What is shared."""
        return self.solution.model.sharing

    @property
    def rms(self) -> float:
        """Root of the residuals' square sum per degree of freedom, m."""
        return float(np.sqrt(self.solution.rss / self.solution.dof))

    @cached_property
    def knowledge(self) -> Knowledge:
        """What is determined, and what is not."""
        return knowledge(self.solution)

    @cached_property
    def curves(self) -> tuple[tuple[TableSet, ErrorMotions], ...]:
        """The six curves of each set of table motions."""
        return tuple((one, self._motions(one.angle, *self.of_set(one))) for one in self.solution.model.sets)

    @cached_property
    def _around(self) -> tuple[JointSolution, dict[str, list[tuple[int, Floats]]]]:
        """The solution in the environment that is stated, else in LABORATORY, and by effect the factors of the
        covariance of what may be there in each run."""
        every, factors = [], dict[str, list[tuple[int, Floats]]]()
        for place, readings in enumerate(self.solution.model.runs):
            covariance = np.zeros((3 * readings.size, 3 * readings.size))
            if (run := readings.run) is not None:
                look = partial(self.solution.look, place, run.table_offset)
                claimed = {one.name for one in self.solution.beside.hypotheses[place].effects}
                covariance, rows = hidden_covariance(
                    run, self.environment or LABORATORY, max(self.rms, NOISELESS), self.solution.dof, look, claimed)
                for name, some in rows.items():
                    factors.setdefault(name, []).append((place, some))
            every.append(covariance / self.sigma**2)
        return JointSolution(self.solution.model, self.solution.beside, every), factors

    @property
    def weighted_sigma(self) -> float:
        """Sigma with what is lost as weights are estimated, m: what the mix is multiplied by."""
        lost = self.solution.beside.loss(1 - self.solution.dof / (3 * self.solution.model.size))
        return self.sigma * float(np.sqrt(lost))

    @cached_property
    def _stated(self) -> tuple[Floats, Floats]:
        """The curves that are shown, (c,), m, and their mix, over all that may explain the runs."""
        solution = self.solution if self.environment is None else self._around[0]
        return over_choices(solution, self.weighted_sigma)

    @cached_property
    def effects(self) -> tuple[tuple[FittedEffect, ...], ...]:
        """The effects of each run, by the likeliest choice, with the parameters that all runs give."""
        return fitted_effects(self.solution, self.weighted_sigma)

    @cached_property
    def choices(self) -> Mapping[tuple[int, ...], float]:
        """The probabilities of what may explain the runs together: of each run the number of its hypothesis."""
        return choices_of(self.solution, self.weighted_sigma)

    def probability(self, place: int, name: str) -> float:
        """Return the probability that an effect is in the run at a place."""
        hypotheses = self.solution.beside.runs[place].hypotheses
        return min(float(sum(p for choice, p in self.choices.items()
                             if any(one.name == name for one in hypotheses[choice[place]].effects))), 1.0)

    @cached_property
    def unseen(self) -> Unseen | None:
        """What U contains of what the orders hide, or lacks where no environment is stated and it matters."""
        if self.solution.model.size > MOST_READINGS:
            return None
        whole, factors = self._around
        alone, u = (self.weighted_sigma * np.linalg.norm(over_choices(one, self.weighted_sigma)[1], axis=1)
                    for one in (self.solution, whole))
        growth = np.divide(u, alone, out=np.ones(u.shape), where=alone > 0)
        at = int(growth.argmax())
        if self.environment is None and growth[at] < MATTERS:
            return None
        part = {name: float(sum(np.sum(whole.shifted(place, rows)[:, at]**2) for place, rows in some))
                for name, some in factors.items()}
        curve = at % 6
        scale = COVERAGE_FACTOR / (1.0 if curve < 3 else self.solution.model.lever)
        return Unseen(self.environment.name if self.environment else '', CURVES[curve], scale * float(alone[at]),
                      scale * float(u[at]), max(part, key=lambda name: part[name], default=''),
                      sum(part.values()) / max(float(u[at])**2, 1e-300))

    @cached_property
    def reversals(self) -> tuple[Reversal, ...]:
        """Of each table that was measured in both senses."""
        out = []
        p = next((test.p for test in self.tests if test.item == 'sense'), None)
        for forwards, back in pairs_of_senses(self.solution):
            (a, mix_a), (b, mix_b) = self.of_set(forwards), self.of_set(back)
            hidden = (self.solution.hidden[forwards.place] - self.solution.hidden[back.place]).reshape(len(a), 6, -1)
            known = np.abs(hidden.mean(axis=0)).max(axis=1, initial=0) < 1e-6
            mix = mix_a - mix_b
            mean = self._motions(np.zeros(1), (a - b).mean(axis=0)[None], mix.mean(axis=0)[None])
            turns = np.stack([a[:, 5], b[:, 5]], axis=-1) / self.solution.model.lever
            out.append(Reversal(forwards.name, self._motions(forwards.angle, a - b, mix), mean.values[0], mean.u[0],
                                tuple(known.tolist()), p, turns))
        return tuple(out)

    def deviations(self, part: str) -> tuple[list[str], Floats, Floats]:
        """Return the names in the sharing, the deviations and their uncertainties, m, (k, 3), of 'plate' or 'cmm'."""
        model, place = self.solution.model, self.solution.model.groups[part]
        names = list(dict.fromkeys(getattr(self.sharing, part)))
        u = self.weighted_sigma * np.linalg.norm(self.solution.mix[place], axis=1)
        return ([names[row[0]] for row in model.places[part].tolist()], self.solution.unknowns[place].reshape(-1, 3),
                u.reshape(-1, 3))

    def of_set(self, one: TableSet) -> tuple[Floats, Floats]:
        """Return the curves of a set, (m, 6), m, and the mix whose squares are their variances, (m, 6, k)."""
        curves, mix = (part[one.place] for part in self._stated)
        return curves.reshape(-1, 6), mix.reshape(one.angle.size, 6, -1)

    def _motions(self, angle: Floats, values: Floats, mix: Floats) -> ErrorMotions:
        scale = np.array([1, 1, 1, *[1 / self.solution.model.lever] * 3])
        return ErrorMotions(angle, values * scale, self.weighted_sigma * np.linalg.norm(mix, axis=-1) * scale,
                            self.solution.model.runs[0].rotation)


def evaluate_jointly(runs: Sequence[Readings], declared: Mapping[str, Any] | None = None,
                     environment: Environment | None = None) -> JointResult:
    """Return the JointResult of runs; declared: fields of Sharing by name, the others are what the runs say;
    environment: what may move in each run, which the curves and their U contain then.

    What nobody declared and the data contradict (p below 0.1 %) is not used; a declaration is, and its test says so.
    Raises NotDeterminable where the runs have nothing in common or too few readings, InvalidData where the declaration
    does not fit them or the readings are too many for an environment.
    """
    declared = dict(declared or {})
    _refuse_twice(runs)
    axes.refuse_other_axes([(run.name, run.rotation) for run in runs])
    runs, wanted, notes = default_sharing(runs, declared)
    _refuse_unlike_plates(runs, wanted)
    if environment and sum(run.size for run in runs) > MOST_READINGS:
        raise InvalidData(f'{runs[0].source}: expected at most {MOST_READINGS} readings in an environment, found '
                          f'{sum(run.size for run in runs)}; evaluate fewer runs as one')
    notes += [remark(JointRemark.NOT_IN_U, run=run.name) for run in runs if environment and run.run is None]
    solution = _solved(JointModel(runs, wanted), explained_runs(runs))
    if solution.dof <= 0:
        raise NotDeterminable(f'{solution.model.size} ball centres leave {solution.dof} degrees of freedom; measure '
                              'more balls or share more')
    dropped, calibrated = list[SharingTest](), any(run.plate.is_calibrated for run in runs)
    while True:
        tests = [tested(solution, item) for item in solution.model.sharing.items
                 if item != 'calibrated plate' or calibrated]
        untrue = [test for test in tests if test.is_contradicted and _FIELDS.get(test.item, test.item) not in declared]
        if not untrue:
            break
        worst = max(untrue, key=lambda test: test.f)
        dropped.append(replace(worst, is_used=False))
        if solution.model.sharing.is_all(worst.item):
            untrue_items = ', '.join(ITEMS[test.item] for test in dropped)
            raise NotDeterminable(
                f'{" and ".join(run.name for run in runs)}: expected runs that have something in common, but the '
                f'readings contradict all of it: {untrue_items}; diagnose each run alone, as what a model lacks makes '
                'them differ, too, or declare what is the same (--share)')
        solution = _solved(JointModel(runs, solution.model.sharing.without(worst.item)), solution.beside)
    if solution.model.sharing.by_sense:
        tests.append(sense_tested(solution))
    notes += angles_of_one_sense(solution)
    for run, own, one in zip(runs, solution.beside.runs, solution.beside.hypotheses, strict=True):
        notes += [remark(JointRemark.EFFECTS, run=run.name, effects=tuple(effect.name for effect in one.effects))
                  ] * bool(one.effects)
        notes += [remark(JointRemark.NOISE, run=run.name, kinds=own.noise.kinds)] * bool(own.noise.kinds)
    said = frozenset(item for item in wanted.items if _FIELDS.get(item, item) in declared)
    return JointResult(solution, said, (*tests, *dropped), *_sigma(solution), tuple(notes), environment)


def _solved(model: JointModel, beside: BesideBase) -> JointSolution:
    """Return the solution of a model, with effects of each run that all readings show, by the likeliest choice."""
    if not any(one.effects for run in beside.runs for one in run.hypotheses):
        return JointSolution(model, beside)
    plain = JointSolution(model, visible_of(beside, lambda place, rows: 0.0, HIDDEN_SHARE))
    beside = visible_of(beside, plain.share, HIDDEN_SHARE)
    solution = JointSolution(model, beside)
    likeliest = by_likeliest(solution, float(np.sqrt(solution.rss / max(solution.dof, 1))))
    return solution if likeliest.choice == beside.choice else JointSolution(model, likeliest)


_FIELDS = {'calibrated plate': 'trusts_plates', 'calibrated CMM': 'cmm_is_calibrated'}
"""Fields of Sharing that are not called as their items."""


def _refuse_twice(runs: Sequence[Readings]) -> None:
    """Refuse readings that are given twice, under whatever name or format: their noise would count as that of two."""
    for place, run in enumerate(runs):
        for other in runs[:place]:
            short, long = (run, other) if run.size < other.size else (other, run)
            there = long.seen_from(short.frame) if short.frame and long.frame else long
            if not is_once_more(short.centre, there.centre):
                continue
            if (same := in_common(short.centre, there.centre)) == run.size == other.size:
                raise InvalidData(f'{other.source} and {run.source}: expected different runs, found the same ball '
                                  'centres in both; leave one out')
            raise InvalidData(f'{short.source}: expected another run than {long.source}, found {same} of its '
                              f'{short.size} ball centres there, too, as where a run was resumed; leave it out')


def _refuse_unlike_plates(runs: Sequence[Readings], sharing: Sharing) -> None:
    """Refuse plates that are declared one although they are not built alike."""
    for place, run in enumerate(runs):
        other = runs[sharing.plate.index(sharing.plate[place])]
        if not run.plate.is_like(other.plate):
            balls = (f'{other.plate.balls} and {run.plate.balls} balls' if other.plate.balls != run.plate.balls
                     else 'nominal places that differ by more than 0.1 mm')
            raise InvalidData(f'{other.name} and {run.name}: plate: expected one plate, as declared, found {balls}; '
                              'declare the plates separate')


def default_sharing(runs: Sequence[Readings],
                    declared: Mapping[str, Any]) -> tuple[list[Readings], Sharing, list[Remark]]:
    """Return the runs, in one frame where theirs are known, what they share as far as they say, and remarks on it.

    declared: fields of Sharing that are given. Plates of the same nominal places are one; how much it was turned shows
    in its deviations; not turned, it was not clamped anew. Both senses of turning have curves of their own. Frames are
    shared where logs give them.
    """
    runs, notes, count = list(runs), list[Remark](), len(runs)
    base = runs[0].frame
    one_frame = count == 1 or bool(base and all(_are_near(base, run.frame) for run in runs))
    if base and one_frame:
        runs = [run.seen_from(base) for run in runs]
    plates = [next(other for other in range(count) if runs[other].plate.is_like(run.plate)) for run in runs]
    turns = declared.get('turn') or _turns_of(runs, plates, notes)
    clockwise = np.concatenate([run.backwards for run in runs])
    sharing = replace(
        Sharing.of(count, plate=tuple(str(first + 1) for first in plates), turn=turns,
                   clamping=tuple(f'{turn:.6f}' for turn in turns), frame=('1',) * count if one_frame else apart(count),
                   by_sense=bool(clockwise.any() and not clockwise.all())), **declared)
    if count > 1 and sharing.frame == apart(count):
        notes.append(remark(JointRemark.FRAMES_APART))
    if sharing.by_sense and 'by_sense' not in declared:
        hidden = [JointSolution(JointModel(runs, replace(sharing, by_sense=by_sense))).hidden_in_curves
                  for by_sense in (False, True)]
        if hidden[1] > hidden[0] + 6 * (count - 1):
            sharing = replace(sharing, by_sense=False)
            notes.append(remark(JointRemark.ONE_SENSE))
    return runs, sharing, notes


def _turns_of(runs: Sequence[Readings], plates: Sequence[int], notes: list[Remark]) -> tuple[float, ...]:
    turns = []
    for run, first in zip(runs, plates):
        turns.append(0.0 if runs[first] is run else found_turn(runs[first], run))
        if turns[-1]:
            notes.append(remark(JointRemark.TURNED, run=run.name, against=runs[first].name, turn=turns[-1]))
    return tuple(turns)


def found_turn(first: Readings, other: Readings) -> float:
    """Return by how much a regular plate was turned between two runs, rad, from its deviations; 0 where none shows.

    Distances between balls do not depend on where the plate lies; the turn is that which leaves least of them.
    """
    if not first.plate.is_regular:
        return 0.0
    n, left = first.plate.balls, dict[int, float]()
    one, two = (_distances(run) for run in (first, other))
    pairs = np.triu_indices(n, 1)
    for pitches in range(n):
        apart = (two - np.roll(one, (pitches, pitches), (0, 1)))[pairs]
        apart = apart[np.isfinite(apart)]
        if apart.size >= min(LEAST_DISTANCES, pairs[0].size):
            left[pitches] = float(np.std(apart))
    best = min(left, key=lambda pitches: left[pitches], default=0)
    is_clear = best > 0 and left[best] < SAME_PLATE * float(np.median([*left.values()]))
    return 2 * np.pi * best / n if is_clear else 0.0


def _distances(run: Readings) -> Floats:
    """Return the distances between the balls of a run (n, n) as it alone determines them, m; not measured: NaN."""
    solution = JointSolution(JointModel([run], Sharing.of(1)))
    centres = np.full((run.plate.balls, 3), np.nan)
    balls = np.unique(run.ball) - 1
    centres[balls] = run.plate.centres[balls] + solution.unknowns[solution.model.groups['plate']].reshape(-1, 3)
    return np.asarray(np.linalg.norm(centres[:, None] - centres, axis=-1))


def _are_near(one: Frame, other: Frame | None) -> bool:
    return bool(other and np.abs(one.origin - other.origin).max() < NEAR
                and np.abs(one.rotation - other.rotation).max() < NEARLY_ALONG)


def _sigma(solution: JointSolution) -> tuple[float, float, SigmaSource, float | None]:
    """Return the standard deviation of a coordinate, its degrees of freedom, its source, and p of lack of fit.

    Readings that all fit to the last digit have the noise that none lack."""
    runs, rms = solution.model.runs, max(float(np.sqrt(solution.rss / solution.dof)), NOISELESS)
    rounding = float(np.sqrt(np.average([run.rounding**2 for run in runs], weights=[run.size for run in runs])))
    noises = [run.noise for run in solution.beside.runs]
    # a repeatability without degrees of freedom is known exactly: as if it had very many
    known = [(scatter, (run.repeatability_dof or EXACT) * (scatter / run.repeatability)**4) for run in runs
             if run.repeatability and (scatter := float(np.hypot(run.repeatability, run.rounding)))]
    if not known:
        return (rms, solution.dof, SigmaSource.RESIDUALS, None) if rms >= rounding else (
            rounding, EXACT, SigmaSource.ROUNDING, None)
    dof = sum(count for _, count in known)
    sd = float(np.sqrt(sum(count * value**2 for value, count in known) / dof))
    quietest, of_tail = min(one.quietest for one in noises), min(one.share_of_dof for one in noises)
    p = float(scipy.special.fdtrc(solution.dof * of_tail, dof * of_tail, (rms / sd * quietest)**2))
    if p < UNLIKELY:
        return rms, solution.dof, SigmaSource.LARGER, p
    if any(one.by or one.tail for one in noises):
        return rms, solution.dof, SigmaSource.UNEQUAL, p
    pooled = float(np.sqrt((solution.dof * rms**2 + dof * sd**2) / (solution.dof + dof)))
    if pooled < rounding:
        return rounding, EXACT, SigmaSource.ROUNDING, p
    return pooled, solution.dof + dof, SigmaSource.REPEATABILITY if dof >= EXACT else SigmaSource.POOLED, p

# SPDX-License-Identifier: Apache-2.0
"""What is said of a run: which members of the best hypothesis are claimed, and as what moves with what."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations

import numpy as np

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.levels import causes_of, course_of, motion_of, slow_functions
from rosette_ros.core.diagnosis.log_evidence import Member, Place, State
from rosette_ros.core.diagnosis.null_gains import p_of_tail
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.effects.free import TIMES, moving_bodies, variables
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.records import UNLIKELY, Floats
from rosette_ros.core.sight.limits import ALIKE, CLAIM, LISTED, SURE, are_alike


class Claims:
    """What is said of the best hypothesis of a search; members: those claimed, of which `named` are the effects."""

    def __init__(self, search: RunSearch) -> None:
        self._search, self._run = search, search.run

    @cached_property
    def chosen(self) -> State:
        """The best hypothesis: in place of laws that may be parts of one that the grammar lacks, or where the likeliest
        is that what moves has none, this without a name."""
        state = opened(self._search.chosen)
        while True:
            for cause in self._causes_of(state):
                if cause.names and not cause.laws[0][0] and (free := _without_names(state, cause.places)):
                    state = free
                    break
            else:
                return state

    # What moves with what

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """What the members of the best hypothesis say moves with what, the likeliest first."""
        return tuple(sorted((replace(one, law_certain=self._is_certain(one)) for one in self._found),
                            key=lambda one: -one.probability))

    @cached_property
    def _found(self) -> tuple[Cause, ...]:
        """The same, before it is known which laws are certain."""
        return self._causes_of(self.chosen)

    def _causes_of(self, state: State) -> tuple[Cause, ...]:
        said = {one.place: self._as_moving(state, place) for place, one in enumerate(state.members)}
        return causes_of(self._search.posterior, self._run, said)

    def _as_moving(self, state: State, place: int) -> Cause:
        """Return what a member says, with the bodies whose motion by its course describes what the readings show of it;
        of a motion without a name, with the variables of which slow functions do, the plainest first."""
        member = state.members[place]
        own, course = motion_of(self._run, member.place), course_of(self._run, member.place)
        if course is None:
            return own

        part = slice(*state.ends[place:place + 2])
        shown = (state.inverse @ state.product)[part] @ member.rows
        moving = moving_bodies(self._run)
        alike = {body for body, directions in moving.items() if self._describes(shown, course, directions)}
        alike -= {*own.bodies}
        driving = own.variables
        if member.family.is_free and len(driving) == 1 and own.bodies[0] in moving:
            driving = (tuple(name for name, functions in slow_functions(self._run).items() if name in own.may_be
                             or self._describes(shown, functions.T, moving[own.bodies[0]])),)
        return replace(own, bodies=(*own.bodies, *sorted(alike)), alike=frozenset(alike), variables=driving)

    def _describes(self, shown: Floats, functions: Floats, directions: Floats) -> bool:
        """Return whether functions (k, N) of a body's directions (d, N, 3) describe what the readings show, (3 N,)."""
        columns = (functions[:, None, :, None] * directions).reshape(-1, *directions.shape[1:])
        rows = self._search.evidence.space.residual(columns).reshape(len(columns), -1)
        basis = np.linalg.svd(rows, full_matrices=False)[2][:np.linalg.matrix_rank(rows)]
        left = shown - (shown @ basis.T) @ basis
        return 1 - float(left @ left) / max(float(shown @ shown), 1e-300) > ALIKE

    def _is_certain(self, cause: Cause) -> bool:
        """Return whether a cause leaves no other law than its own, and body, variable and fit leave no other cause.

        What moves by a constant amount, or with a sense, which has two values, has no other, but may be what the order
        shows of one. In time, a law may always be another one that looks like it and that the library lacks."""
        many = {one.name for one in variables(self._run) if np.ptp(np.abs(one.functions[one.functions != 0])) > 0}
        return (len(cause.names) == len(cause.bodies) == 1 and cause.law_probability >= SURE
                and all(len(some) == 1 and many.isdisjoint(some) for some in cause.variables)
                and not any(one.family.is_free for one in self.chosen.members)
                and not ((p := self.fit.lack_of_fit_p) is not None and p < UNLIKELY)
                and not self._has_double(cause.places[0]))

    def _has_double(self, place: Place) -> bool:
        """Return whether a member cannot be told apart from another law or course of the grammar, beside the others."""
        members = self.chosen.members
        rest = self.chosen.without(next(k for k, one in enumerate(members) if one.place == place))
        worth = {one.name: one.log_bf for one in rest.offers()}
        own = worth.pop(place[0].name, 0.0)  # at no setting of its grid it may be seen
        return are_alike(own, max(worth.values(), default=0.0))

    def _found_of(self, member: Member) -> Cause:
        """Return the Cause of a member before it is known whether its law is certain, which what is claimed decides."""
        return next(one for one in self._found if member.place in one.places)

    def _cause_of(self, member: Member) -> Cause:
        return next(one for one in self.causes if member.place in one.places)

    # What is claimed

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """The named members that are claimed, the one that explains most first.

        What stands beside a larger motion without a name, or one of the same body and variable, may be a part of it,
        and what moves most likely by no law has no name: neither is claimed."""
        members, named = self.chosen.members, self._search.posterior.named
        free = [one for one in members if one.family.is_free]
        out = [one for place, one in enumerate(members)
               if one.name in named and self._is_guarded(place) and not any(
                   other.size > one.size or motion_of(self._run, other.place).agrees(motion_of(self._run, one.place))
                   for other in free)
               and self._found_of(one).laws[0][0]
               and max(self._found_of(one).probability, named[one.name].together) >= CLAIM]
        falls = {one: State(self._search.evidence, [other for other in out if other is not one]).rss for one in out}
        return tuple(sorted(out, key=lambda one: -falls[one]))

    @cached_property
    def fit(self) -> Fit:
        """The fit with all that is claimed."""
        return self._search.with_members(self.members)

    @cached_property
    def named(self) -> tuple[MissingEffect, ...]:
        """The members that are claimed as effects."""
        named, members = self._search.posterior.named, self.chosen.members
        return tuple(replace(self._with_experience(named[one.name]), setting=one.setting, cause=self._cause_of(one),
                             p=self._p_of_member(members.index(one)), visible_fraction=one.sensitivity)
                     for one in self.members)

    def _with_experience(self, one: MissingEffect) -> MissingEffect:
        """Return an effect with what experience of the cell says of it, or of a name that stands for it."""
        experience = self._search.model.experience
        every = (one.name, *one.look_alikes)
        known = [experience.by_name[name] for name in every if name in experience.by_name] if experience else []
        if not known:
            return one
        return replace(one, learnt=known[0], alone=self._search.posterior.alone.of(*every))

    @cached_property
    def unnamed(self) -> tuple[MissingEffect, ...]:
        """The members without a name that noise does not explain, the likeliest first; of those about as likely,
        that of one variable."""
        out, beside = [], list(self.members)
        for place, one in enumerate(self.chosen.members):
            if one.family.is_free and self._is_guarded(place):
                cause, before = self._cause_of(one), self._rms(beside)
                beside.append(one)
                out.append(MissingEffect(one.family.effect.name, one.setting, cause=cause, together=cause.probability,
                                         p=self._p_of_member(place), visible_fraction=one.sensitivity, before=before,
                                         after=self._rms(beside)))
        return tuple(sorted(out, key=lambda one: (-round(one.probability, 1), one.setting.word('of').count(TIMES))))

    def _rms(self, members: Sequence[Member]) -> float:
        """Return the standard deviation of the noise beside members of the sizes that they have, m."""
        evidence = self._search.evidence
        return evidence.scale * math.sqrt(max(State(evidence, members, is_sized=True).left, 0.0) / evidence.dof)

    @property
    def doubtful(self) -> tuple[tuple[str, float], ...]:
        """Names of the best hypothesis that are likely, but not enough to be said, each with its probability; none of a
        body and a variable of which something is told, of which they may be the law."""
        said = {one.name for one in self.members}
        said |= {one.name for one in self._search.chosen.members
                 if any(told.agrees(motion_of(self._run, one.place)) for told in self.told)}
        return tuple((name, one.is_there) for name, one in self._search.posterior.named.items() if name not in said)

    @cached_property
    def told(self) -> tuple[Cause, ...]:
        """The causes that are told: of what is claimed, and of what has no name."""
        places = {place for one in (*self.named, *self.unnamed) if one.cause for place in one.cause.places}
        return tuple(one for one in self.causes if not places.isdisjoint(one.places))

    # What guards against noise

    def _p_of_member(self, place: int) -> float:
        """Return the probability that noise makes anything worth as much as a member of the best hypothesis."""
        member = self.chosen.members[place]
        offers = self.chosen.without(place).offers(member.family.is_free)
        return self._search.p(next((one.gain for one in offers if one.family is member.family), -np.inf))

    def _is_guarded(self, place: int) -> bool:
        return self._p_of_member(place) <= LISTED and place not in self._of_tail

    @cached_property
    def _of_tail(self) -> frozenset[int]:
        """The places of the wrong readings that do not stand out of the tail that the other readings have."""
        members = self.chosen.members
        readings = {place: one.setting.whole('reading') - 1 for place, one in enumerate(members)
                    if 'reading' in one.setting}
        if not readings:
            return frozenset()

        others = self._unweighted(self.chosen)
        own = {place: self._unweighted(self.chosen.without(place))[row] for place, row in readings.items()}
        out: set[int] = set()
        for place in sorted(readings, key=lambda one: float(own[one] @ own[one])):
            rest = np.delete(others, [row for one, row in readings.items() if one not in out], axis=0)
            if p_of_tail(own[place], rest) > LISTED:
                out.add(place)  # and is a part of the tail of those that are farther off
                others[readings[place]] = own[place]
        return frozenset(out)

    def _unweighted(self, state: State) -> Floats:
        """Return what a state leaves of the readings, (N, 3), without the weights of a tail."""
        left, base = state.residual.reshape(-1, 3), self._search.base
        return np.asarray(base.joint.whitening.inverse(left[None])[0]) if base.noise.tail else left.copy()


def opened(state: State) -> State:
    """Return a hypothesis of which two laws of one body and variable are a course without a name, where this cannot be
    told apart from them.

    Two laws that are parts of another one have much the same likelihood as any course of the same body with the same
    variable; two that are there have not, as a course that would do for both would do for much else."""
    for one, other in combinations(state.members, 2):
        causes = [motion_of(state.evidence.run, some.place) for some in (one, other)]
        if any(some.family.is_free for some in (one, other)) or causes[0].own != causes[1].own or not (
                causes[0].agrees(causes[1])):
            continue
        free = _without_names(state, (one.place, other.place))
        if free is None:
            continue
        *rest, best = free.members
        before = State(state.evidence, rest, is_sized=True)
        if are_alike(state.likelihood - before.likelihood, float(before.line(best.rows).max()), effects=2):
            return opened(free)
    return state


def _without_names(state: State, places: Sequence[Place]) -> State | None:
    """Return a hypothesis with the best course of the same body, with one of the same variables, in place of some laws;
    None where there is none."""
    evidence = state.evidence
    causes = [motion_of(evidence.run, place) for place in places]
    bodies = frozenset.intersection(*(frozenset(one.bodies) for one in causes))
    alone = [frozenset([name]) for name in frozenset.intersection(*(one.may_be for one in causes))]
    rest = State(evidence, [one for one in state.members if one.place not in places], is_sized=True)
    free = [evidence.member(family, setting) for family in evidence.bank.families if family.is_free
            for setting in family.settings
            if family.effect.moved(setting) == bodies and family.effect.driven_by(setting) in alone]
    best = max(free, key=lambda some: rest.line(some.rows).max(), default=None)
    return State(evidence, (*rest.members, best)) if best else None

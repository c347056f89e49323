# SPDX-License-Identifier: Apache-2.0
"""Hypotheses under every kind of noise that a run may have: effects and noise compete by the one score."""

import math
from collections.abc import Callable

import numpy as np

from rosette_ros.core.diagnosis.hypotheses import Looked, Search
from rosette_ros.core.diagnosis.log_evidence import NEAR, NOISELESS, Member, State
from rosette_ros.core.diagnosis.noise_kinds import LEAST, NOT_WHITE, Beside, NoiseKinds
from rosette_ros.core.diagnosis.posterior import Key, Posterior
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.sight.bank import columns_of

MOST = 4
"""Searches beside that in white noise."""


def noise_beside(fitted: Fit, members: tuple[Member, ...] = (), scale: float | None = None,
                 of_motion: float | None = None) -> NoiseKinds:
    """Return the kinds of noise beside the effects of a fit in white noise and further members.

    scale: of the residual, m, over which members have their sizes; of_motion: as of NoiseKinds."""
    run, none = fitted.run, np.zeros((0, fitted.run.size, 3))
    columns = [columns_of(one.family, run, one.setting) for one in members]
    sizes = np.array([one.size for one, rows in zip(members, columns) for _ in rows])
    unit = scale or fitted.rms
    beside = Beside(run, fitted.mean_radius, fitted.model.base, fitted.residual / unit, fitted.joint.every,
                    np.concatenate([none, *columns]), sizes, fitted.noise, unit)
    return NoiseKinds(beside, fitted.model.noise, NOISELESS, of_motion)


def choose(white: Search, fitted: Fit, under: Callable[[Noise], Search]) -> Posterior:
    """Return the Posterior of a run; white: the search in white noise of a fit; under: makes that in another noise."""
    grown, scale = white.grown, white.evidence.scale
    free = [one.log_prior for one in white.evidence.bank.families if one.is_free]
    of_motion = max(free, default=None)
    alone = noise_beside(fitted, (), scale, of_motion).found(max(LEAST, grown.log_evidence - NEAR))
    best = white.best if alone[0].log_evidence < grown.log_evidence + NEAR else grown  # noise has no better members
    looked: dict[Key, Looked] = {}
    sources: dict[Key, tuple[Search, Noise]] = {}

    def take(search: Search, kinds: tuple[str, ...], noise: Noise, shift: float) -> None:
        for names, (value, places) in search.looked.items():
            key = names, kinds
            if key not in looked or value + shift > looked[key][0]:  # noise may have other sizes beside other members
                looked[key], sources[key] = (value + shift, places), (search, noise)

    take(white, (), fitted.noise, math.log(1 - NOT_WHITE))
    # noise may take the place of what moves single readings, or the frame
    rest = [tuple(one for one in best.members if one.family.effect.body != body) for body in ('', 'reading', 'frame')]
    waiting, tried = list(dict.fromkeys([(), *rest])), set[Key]()
    while waiting and len(tried) < MOST:
        members = waiting.pop(0)
        base = State(white.evidence, [white.evidence.member(one.family, one.setting, one.volume) for one in members])
        useful = max(value for value, _ in looked.values()) - NEAR - base.log_evidence  # to be the best after a search
        found = noise_beside(fitted, base.members, scale, of_motion).found(max(LEAST, useful)) if members else alone
        for one in found[:2]:
            if (not one.kinds or one.log_evidence < found[0].log_evidence - NEAR / 3 or (base.names, one.kinds) in tried
                    or one.log_evidence < useful):
                continue
            tried.add((base.names, one.kinds))
            try:
                search = under(one.noise)
            except NotDeterminable:
                continue  # under this noise a part of the readings counts for nothing
            here = State(search.evidence, [search.evidence.member(each.family, each.setting, each.volume)
                                           for each in base.members])
            own = search.best
            take(search, one.kinds, one.noise, base.log_evidence + one.log_evidence - here.log_evidence)
            if own.names not in (base.names, best.names) and (own.names, one.kinds) not in tried:
                waiting.append(own.members)
    best_key = Posterior(looked).best
    search, noise = sources[best_key]
    return Posterior(looked, search.state(best_key[0]), noise, fitted.beyond)

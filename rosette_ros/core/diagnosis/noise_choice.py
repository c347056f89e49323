# SPDX-License-Identifier: Apache-2.0
"""Effects and noise compete: which noise a run has, with what is found under it.

What white noise leaves beside the effects found is tested, and so is what it leaves without them, or without those that
may be noise themselves. Where a test fails, the noise is estimated, and the search is made again under it, until the
noise is that beside what is found; the best of noise and effects together stays.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rosette_ros.core.diagnosis.noise_search import NO_AXIS, SEEN, NoiseFit, NoiseProblem, estimate
from rosette_ros.core.diagnosis.noise_statistics import check_of, two_sided_f
from rosette_ros.core.diagnosis.search import MOST_EFFECTS, Member
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import Noise

if TYPE_CHECKING:
    from rosette_ros.core.diagnosis.diagnosis import RunSearch

ALONE = 10.0
"""Score by which effects in white noise must be better than another noise without them; outliers may be as much worse:
heavy tails are many of them."""
STEADY = 5.0
"""Score by which each effect must be better than a frame that wanders at random: any course in time may be that by
chance."""
TAILED = 0.025
"""Probability of normal noise below which what outliers leave has the tails that their run has without them."""
CURVED = 40.0
"""Score by which free forms in white noise may be worse: where they leave nothing, what is there is smoother than a
wander, of which they would leave the quick part."""
MOST_NOISES = 3
"""Searches beside that in white noise."""
NO_NAMES: tuple[str, ...] = ()


def under_best_noise(white: 'RunSearch', again: Callable[[Noise], 'RunSearch']) -> 'RunSearch':
    """Return the search of the best score; white: that under white noise; again: makes one under another noise."""
    if white.noiseless or white.base.noise.resolution:
        return white
    alone = _estimated(white, ())
    if alone.noise.is_white:
        if not white.chosen.members:
            return white
    else:
        white.needed = alone.score - ALONE
    best: RunSearch | None = None
    hopes: dict[tuple[str, ...], float] = {}
    best_score, margin, waiting = -np.inf, 0.0, [(alone, NO_NAMES)]
    most = white.problem.reachable(white.problem.offers([white.problem.empty])[0][0].score, MOST_EFFECTS)
    # white noise cannot win where it would need more effects than are looked for, each as large as the best one
    is_tried = alone.noise.is_white or alone.score < most + ALONE
    if is_tried:
        names, best, best_score = white.chosen.names, white, white.chosen.score
        margin = STEADY * len(names) if alone.noise.kinds == ('wander',) else ALONE
        beside = _estimated(white, white.chosen.members) if names else alone
        if beside.noise.is_white:
            if alone.noise.wander.any() and not any(member.named for member in white.chosen.members):
                margin = -CURVED
            elif set(names) == {'outlier'} and not _is_tailed(beside, alone.noise):
                margin = -ALONE
        waiting = [(one, of) for one, of in ((alone, NO_NAMES), (beside, names)) if not one.noise.is_white]
        if beside.noise.is_white and alone.score < best_score - margin:
            waiting = []
        elif beside is alone:
            waiting = waiting[:1]
        hopes[names] = best_score + beside.score
        for one, rest in _instead(white, alone.noise):
            of = tuple(member.name for member in rest)
            waiting.append((one, of))
            # wrong readings give way to tails that are better, courses also to a wander that is as good
            hopes[of] = white.problem.select(rest).score + one.score + (margin if one.noise.wander.any() else 0.0)
    unsettled: tuple[float, RunSearch] | None = None
    settled: set[tuple[tuple[str, ...], tuple[str, ...]]] = set()
    for _ in range(MOST_NOISES):
        # what was found beside a noise already is about as good as a search under it makes it
        waiting = [(one, of) for one, of in waiting
                   if (of, one.noise.kinds) not in settled and hopes.get(of, np.inf) > best_score]
        if not waiting:
            break
        one, of = waiting.pop(0)
        try:
            search = again(one.noise)
        except NotDeterminable:  # under this noise a part of the readings counts for nothing
            if white.needed > -np.inf:  # the search in white noise may have ended early for it
                white.needed = -np.inf
                white.__dict__.pop('chosen', None)
            continue
        found = _estimated(white, search.chosen.members) if search.chosen.members else alone
        members = [made for member in search.chosen.members
                   if (made := white.problem.member(member.effect, member.setting, member.chances))]
        score = white.problem.select(members).score + found.score
        outliers = search.chosen.names.count('outlier')
        if outliers and alone.noise.tail and (found.noise.tail or _is_tailed(found, alone.noise)):
            score -= ALONE * outliers
        if alone.noise.wander.any():
            score -= STEADY * len(members)
        elif members and not any(member.named for member in members):
            score -= ALONE  # a form of many coefficients describes what scatters more
        if not found.noise.is_white and (search.chosen.names, found.noise.kinds) != (of, one.noise.kinds):
            # its effects are judged under the noise that is left beside them, not under that without them
            waiting.insert(0, (found, search.chosen.names))
            unsettled = max(unsettled or (-np.inf, search), (score, search), key=lambda each: each[0])
            continue
        settled.add((search.chosen.names, found.noise.kinds))
        if score > best_score - (margin if best is white else 0.0):
            best, best_score = search, score
    if unsettled and (best is None or unsettled[0] > best_score + ALONE):
        best = unsettled[1]
    if best is None or (is_tried and best.chosen.names == white.chosen.names and not all(
            member.named for member in white.chosen.members)):
        return white
    return best


def _instead(white: 'RunSearch', alone: Noise) -> list[tuple[NoiseFit, list[Member]]]:
    """Return noises that can stand for some of the members found in white noise, each with the other members.

    Courses of the frame in time may be a wander beside the others, wrong readings heavy tails where the noise alone,
    without any effects, has them."""
    members, found = white.chosen.members, list[tuple[NoiseFit, list[Member]]]()
    for kind, rest in (('tail', [one for one in members if one.name != 'outlier']),
                       ('wander', [one for one in members if one.effect.body != 'frame'
                                   and one.name != 'free_time'])):
        if 0 < len(rest) < len(members) and (kind != 'tail' or alone.tail):
            beside = _estimated(white, rest)
            if any(one.startswith(kind) for one in beside.noise.kinds):
                found.append((beside, rest))
    return found


def noise_problem(fitted: Fit, members: Sequence[Member] = ()) -> NoiseProblem:
    """Return the problem of the noise of the run of a fit, beside the effects of a selection."""
    run, joint = fitted.run, fitted.joint
    columns = [np.moveaxis(member.effect.columns(run, member.setting), -1, 0) for member in members]
    space = joint.space if joint.whitening.is_plain else BaseSpace(run, fitted.mean_radius, fitted.model.base)
    return NoiseProblem(run, space.basis, np.concatenate([joint.every, *columns]), fitted.residual)


def noise_beside(fitted: Fit) -> Noise:
    """Return the noise of a run beside all that a model has, white where no other is seen; fitted: in white noise."""
    return estimate(noise_problem(fitted), _kinds(fitted)).noise


def _kinds(fitted: Fit) -> list[str]:
    return [name.removeprefix('noise.') for name in fitted.model.noise]


def _is_tailed(beside: NoiseFit, noise: Noise) -> bool:
    """Return whether what is left beside outliers, taken as normal, has heavy tails like those of a noise."""
    return bool(noise.tail) and not beside.noise.tail and beside.p_of_tail(noise) < TAILED


def noise_of_z(fitted: Fit) -> Noise:
    """Return white noise, or one of z and one of x and y where an F-test of a white fit's residuals finds two.

    The repeatability by axis counts with its degrees of freedom."""
    square, run = np.sum(fitted.residual**2, axis=0), fitted.run
    axial = run.size - fitted.joint.space.ranks[0]
    plane = fitted.dof - axial
    dof, check = check_of(run)
    square = square + dof * check * square.sum() / fitted.dof
    if min(axial, plane) < 1 or min(square[2], square[:2].sum()) <= NO_AXIS * square.sum():
        return fitted.noise
    freedom = axial + dof, plane + 2 * dof
    sizes = np.array([square[2], square[:2].sum()]) / freedom
    p = two_sided_f(float(sizes[0] / sizes[1]), *freedom)
    return replace(fitted.noise, axes=np.sqrt(sizes[[1, 1, 0]])).scaled() if p < SEEN else fitted.noise


def _estimated(white: 'RunSearch', members: Sequence[Member]) -> NoiseFit:
    return estimate(noise_problem(white.base, members), _kinds(white.base))

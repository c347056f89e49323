# SPDX-License-Identifier: Apache-2.0
"""Is a claim the right shape? Beside each claim stands a free form of the same variables.

Where the free form explains significantly more than the claim does (F-test over all that are tried), the claim is
taken back: what is there depends on these variables, but not as the named effect does. The best free form, of whatever
variables, takes its place.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

from scipy import special

from rosette_ros.core.diagnosis.search import Member, Problem, Selection, gain_and_rank, searched_count
from rosette_ros.core.effects.effect import Effect, Setting, grid
from rosette_ros.core.effects.free_forms import FREE_FORMS, counts
from rosette_ros.core.records import Run

WRONG_SHAPE = 0.002
"""Probability, over all free forms beside a claim, below which its shape is wrong."""
MERGE = 25.0
"""By how much the score of two claims on one variable must exceed that of one free form; three times that for three.

A single claim that is better by as much as this keeps its name, whatever a free form has more."""
IN_TIME = {
    'table_zero_drift': ('CMM position', 1, 'xy'), 'plate_expansion': ('CMM position', 1, 'xy'),
    'cmm_scale_drift': ('CMM position', 1, 'xy'), 'cmm_squareness_drift': ('CMM position', 1, 'xy'),
    'axis_tilt_drift': ('CMM position', 1, 'z'), 'plate_creep': ('table angle', 1, 'xy'),
    'plate_slip': ('table angle', 1, 'xy'), 'plate_warp': ('ball', 2, 'z')}
"""What an effect that changes with time multiplies it by: angle, waves, axes."""


def forms_beside(run: Run, effect: Effect, setting: Setting) -> Iterator[tuple[str, Setting]]:
    """Yield name and setting of the free forms of the variables of an effect."""
    name = effect.name
    if name.startswith('frame_') or name == 'table_warmup':
        axes = 'z' if name == 'table_warmup' else 'xyz'
        yield from (('free_time', one) for one in grid(axes=(axes,), count=counts(run.size // 4)[1:]))
    if 'temperature' in name or setting.get('driver') == 'temperature':
        yield 'free_temperature', Setting(axes='xyz', count=3)
    ball = _ball(run, effect, setting)
    if ball:
        for of, most in (('time', run.n - 2), ('table angle', (run.n - 1) // 2)):
            yield from (('free_ball', one) for one in grid(ball=(ball,), of=(of,), count=counts(most)[-2:],
                                                           axes=('xyz',)))
    if name in IN_TIME:
        of, order, axes = IN_TIME[name]
        yield from (('free_growth', one) for one in grid(of=(of,), order=(setting.get('order', order),), count=(4, 8),
                                                         axes=(axes,)))
    if name.startswith('table_backlash'):
        yield from (('free_reversal', one) for one in FREE_FORMS['free_reversal'].settings(run))
    if name.startswith(('cmm_reversal', 'probe')):
        yield from (('free_sense', one) for one in FREE_FORMS['free_sense'].settings(run))


def _ball(run: Run, effect: Effect, setting: Setting) -> int:
    """Return the one ball that an effect moves, 0 for none."""
    return int(run.ball[setting.whole('reading') - 1]) if effect.name == 'outlier' else int(setting.get('ball', 0))


def _groups(run: Run, selection: Selection) -> list[list[int]]:
    """Return the places of members for which one free form can stand together; outliers only beside others."""
    groups: dict[str, list[int]] = {}
    for place, member in enumerate(selection.members):
        ball = _ball(run, member.effect, member.setting)
        family = 'frame' if member.name in ('free_time', 'free_temperature') else member.name.partition('_')[0]
        shared = f'ball {ball}' if ball else member.setting.word('of') or IN_TIME.get(member.name, (family,))[0]
        groups.setdefault(shared, []).append(place)
    return [group for group in groups.values() if len(group) > 1 and any(
        selection.members[place].named and selection.members[place].name != 'outlier' for place in group)]


def _wrong_p(problem: Problem, selection: Selection, member: Member) -> float:
    """Return the probability that noise makes the free forms beside a claim explain as much more."""
    found = [1.0]
    left = problem.dof - len(selection.rows) - searched_count(selection.members)
    for name, setting in forms_beside(problem.run, member.effect, member.setting):
        form = problem.member(FREE_FORMS[name], setting, 1.0)
        if form is not None:
            gain, rank = gain_and_rank(form, selection)
            if 0 < rank < left:
                found.append(float(special.fdtrc(rank, left - rank, gain / rank
                                                 / (max(selection.rss - gain, 1e-300) / (left - rank)))))
    return min(found) * max(len(found) - 1, 1)


def free_instead(problem: Problem, selection: Selection, places: list[int]) -> Selection | None:
    """Return the selection with the best free form in place of some members, None where none can be seen."""
    kept = [member for place, member in enumerate(selection.members) if place not in places]
    gone = [selection.members[place] for place in places]
    rest = problem.select(kept)
    tried = {(offer.family.name, offer.setting): offer.family.chances
             for offer in problem.offers([rest], tuple(FREE_FORMS), allow_repeats=True)[0][:6]}
    for member in gone:
        for form in forms_beside(problem.run, member.effect, member.setting):
            tried.setdefault(form, float(FREE_FORMS[form[0]].independent_settings(problem.run)))
    made = [problem.member(FREE_FORMS[name], setting, chances) for (name, setting), chances in tried.items()]
    words = ' and '.join(sorted({member.name for member in gone if member.named}))
    found = [problem.select((*kept, replace(form, instead=words))) for form in made if form is not None]
    return max(found, key=lambda each: each.score, default=None)


def right_shapes(problem: Problem, selection: Selection,
                 prune: Callable[[Selection], Selection]) -> Selection:
    """Return a selection in which every named member has the right shape; prune: drops what does not hold."""
    for _ in range(2 * len(selection.members)):
        named = [place for place, member in enumerate(selection.members) if member.named]
        wrong = [(_wrong_p(problem, selection, selection.members[place]), [place]) for place in named]
        worst = min(wrong, default=(1.0, []), key=lambda pair: pair[0])
        better = None
        if worst[0] * len(wrong) < WRONG_SHAPE:
            better = free_instead(problem, selection, worst[1])
            if better is not None and better.score < selection.score - MERGE:
                better = None  # far worse than the claim: what the free form has more is chance
        for group in _groups(problem.run, selection) if better is None else ():
            merged = free_instead(problem, selection, group)
            if merged is not None and merged.score > selection.score - MERGE * len(group) * (len(group) - 1) / 2:
                better = merged
        if better is None:
            return selection
        selection = problem.polish(prune(better))
    return selection

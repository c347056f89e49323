# SPDX-License-Identifier: Apache-2.0
"""Is a claim the right shape? Beside each claim stands a free form of the same variables.

Where the free form explains significantly more than the claim does (F-test over all that are tried), the claim is
taken back: what is there depends on these variables, but not as the named effect does. The best free form, of whatever
variables, takes its place.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from rosette_ros.core.diagnosis.search import Member, Problem, Selection, gain_and_rank, searched_count
from rosette_ros.core.effects.effect import Effect, Setting, grid
from rosette_ros.core.effects.free_forms import AXES, FREE_FORMS, MOST_OF_BALL, counts
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.effects.run_functions import duration, temperature_step
from rosette_ros.core.records import Run

WRONG_SHAPE = 0.002
"""Probability, over all free forms beside a claim, below which its shape is wrong."""
MERGE = 25.0
"""By how much the score of two claims on one variable must exceed that of one free form; three times that for three.

A single claim that is better by as much as this keeps its name, whatever a free form has more."""
IN_TIME: dict[str, tuple[str, tuple[tuple[str, str], ...]]] = {
    **dict.fromkeys(('table_zero_drift', 'table_zero_temperature', 'table_zero_lag', 'table_zero_warmup',
                     'table_zero_step'), ('CMM position', (('free_time', 'tangential'),))),
    **dict.fromkeys(('axis_tilt_drift', 'axis_tilt_temperature', 'axis_tilt_lag', 'axis_tilt_warmup',
                     'axis_tilt_step'), ('CMM position', (('free_growth', 'z'),))),
    **dict.fromkeys(('plate_expansion', 'plate_expansion_lag', 'plate_soaking'),
                    ('CMM position', (('free_time', 'radial'),))),
    **dict.fromkeys(('cmm_scale_drift', 'cmm_scale_temperature', 'cmm_scale_lag',
                     'cmm_squareness_drift'), ('CMM position', (('free_growth', 'xy'),))),
    **dict.fromkeys(('plate_creep', 'plate_creep_settling'), ('table angle', (('free_time', 'plate xy'),))),
    'plate_slip': ('table angle', (('free_time', 'plate xy'), ('free_time', 'tangential'))),
    **dict.fromkeys(('plate_tilt_step', 'plate_tilt_settling', 'plate_warp'), ('ball', (('free_growth', 'z'),)))}
"""What else an effect that changes with time depends on, and the free forms beside it with their axes."""
ONE = 12.0
"""By how much the score of several claims must exceed that of one effect in their place."""
ALONG_TIME = ('free_time', 'free_temperature', 'asynchronous_motion', 'table_warmup')
"""What is a curve in time, or nearly, without being called so."""
MOTIONS = {'radial': ((0, 'xy'),), 'axial': ((0, 'z'),), 'tilt': ((1, 'z'),), 'all': ((0, 'xyz'), (1, 'z'))}
"""Waves of the CMM position and axes of a motion of the table's axis."""
PRODUCTS = ('free_growth', 'free_product')
"""Free forms of two variables."""
SIMPLER = 15.0
"""By how much the score of a product of two variables must exceed that of a curve in time."""
UNSTEADY = (2, 4, 8)
"""Functions by which the size of a cycle that does not repeat alike changes."""
PARTS = {'z': ('z',), 'xy': ('xy',), 'both': ('z', 'xy')}
"""Axes of a part of the form of the balls."""


def forms_beside(run: Run, effect: Effect, setting: Setting) -> Iterator[tuple[str, Setting]]:
    """Yield name and setting of the free forms of the variables of an effect."""
    name, some = effect.name, counts(run.size // 4)[1:]
    if name.startswith('frame_') or name == 'table_warmup':
        own = 'z' if name == 'table_warmup' else setting.word('axes', 'xyz')
        every = dict.fromkeys((own, own if name == 'table_warmup' else 'xyz'))
        yield from (('free_time', one) for one in grid(axes=every, count=some))
    if name == 'frame_cycle':
        yield from (('free_cycle', one) for one in grid(
            period=(setting['period'],), count=UNSTEADY, axes=AXES))
    if name == 'free_time':
        yield name, Setting({**setting, 'axes': 'xyz'})
    if 'temperature' in effect.depends_on or setting.get('driver') == 'temperature':
        yield 'free_temperature', Setting(axes='xyz', count=3)
    ball = _ball(run, effect, setting)
    if ball:
        most = min(run.n - 2, MOST_OF_BALL)
        yield from (('free_ball', one) for one in grid(ball=(ball,), of=('time',), count=sorted({min(4, most), most}),
                                                       axes=('plate xyz',)))
        yield from (('free_ball', one) for one in grid(ball=(ball,), of=('table angle',), axes=('xyz',),
                                                       count=counts((run.n - 1) // 2)[-2:]))
    of, forms = IN_TIME.get(name, ('', ()))
    for form, axes in forms:
        more = Setting(of=of, order=setting.get('order', 1)) if form == 'free_growth' else Setting()
        yield from ((form, Setting({**more, 'count': count, 'axes': axes})) for count in (2, 4, 8))
    if name == 'asynchronous_motion':
        yield from (('free_travel', Setting(nu=setting['nu'], count=3, order=order, axes=axes))
                    for order, axes in MOTIONS[setting.word('motion')])
        yield from (('free_time', one) for one in grid(axes=('z', 'xy', 'xyz'), count=some))
        yield from (('free_cycle', one) for one in grid(period=(_period(run, setting.number('nu')),), count=UNSTEADY,
                                                        axes=AXES))
    if name == 'encoder_interpolation':
        yield 'free_line', Setting(lines=setting['lines'], count=3, axes='tangential')
    if name == 'plate_support':
        yield from (('free_balls', Setting(order=order, axes=setting['part'])) for order in (setting['p'], 0))
    if name == 'ball_form' and not ball:
        yield from (('free_balls', one) for one in grid(order=(setting['harmonic'], 0), axes=PARTS[
            setting.word('part', 'both')]))
    if name == 'ball_machine_offset' and not ball:
        yield from (('free_balls', one) for one in grid(order=(1, 2), axes=('xy',)))
    if name.startswith('table_backlash'):
        yield from (('free_reversal', one) for one in FREE_FORMS['free_reversal'].settings(run))
    if name.startswith(('cmm_reversal', 'probe')):
        yield from ((form, one) for form in ('free_sense', 'free_approach') for one in FREE_FORMS[form].settings(run))


def _period(run: Run, nu: float) -> float:
    """Return the mean period, s, of what repeats nu times per turn of travel."""
    return 2 * np.pi * duration(run) / max(abs(nu) * float(np.ptp(run.table_travel)), 1e-9)


def _ball(run: Run, effect: Effect, setting: Setting) -> int:
    """Return the one ball that an effect moves, 0 for none."""
    return int(run.ball[setting.whole('reading') - 1]) if effect.name == 'outlier' else int(setting.get('ball', 0))


def _groups(run: Run, selection: Selection) -> list[tuple[float, list[int]]]:
    """Return the places of members for which one form may stand, outliers only beside others, and by how much worse.

    Members of one variable, each that changes with time beside a curve in time without a name, or beside what follows
    a coarse record of the temperature, as that may be one along all axes, and all together, for which it must explain
    more; as it must for a claim alone.
    """
    groups: dict[str, list[int]] = {}
    for place, member in enumerate(selection.members):
        ball = _ball(run, member.effect, member.setting)
        family = 'frame' if member.name in ALONG_TIME else member.name.partition('_')[0]
        of = IN_TIME[member.name][0] if member.name in IN_TIME else family
        shared = f'ball {ball}' if ball else member.setting.word('of') or of
        groups.setdefault(shared, []).append(place)
    found = [(MERGE * len(group) * (len(group) - 1) / 2, group) for group in groups.values()]
    size = len(selection.members)
    curves = ('free_time', *(('frame_temperature', 'frame_temperature_lag') if temperature_step(run) else ()))
    found += [(MERGE, [place, curve]) for curve, free in enumerate(selection.members) if free.name in curves
              for place, member in enumerate(selection.members) if 'time' in member.effect.depends_on and member.named]
    found.append((MERGE * (size - 1) * (size - 2) / 2, list(range(size))))
    claims = [place for place, member in enumerate(selection.members) if member.named and member.name != 'outlier']
    several = [(margin, group) for margin, group in found if len(group) > 1 and not set(claims).isdisjoint(group)]
    return several + [(0.0, [place]) for place in claims]


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


def replaced_words(form: Member) -> str:
    """Return how a free form compares with the effects that it replaces, in words."""
    words = '{} together would make it, too' if form.alike else 'not as {}'
    return words.format(form.instead) if form.instead else ''


def free_instead(problem: Problem, selection: Selection, places: list[int],
                 searched: Sequence[str] = tuple(FREE_FORMS), alike: bool = False) -> Selection | None:
    """Return the selection with the best free form in place of some members, None where none is seen.

    Tried are those beside the members, and the best of some that are searched; alike: as of Member."""
    kept = [member for place, member in enumerate(selection.members) if place not in places]
    gone = [selection.members[place] for place in places]
    rest = problem.select(kept)
    tried = {(offer.family.name, offer.setting): offer.family.chances
             for offer in problem.offers([rest], searched, allow_repeats=True)[0][:6]}
    for member in gone:
        for form in forms_beside(problem.run, member.effect, member.setting):
            tried.setdefault(form, float(FREE_FORMS[form[0]].independent_settings(problem.run)))
    made = [problem.member(FREE_FORMS[name], setting, chances) for (name, setting), chances in tried.items()]
    words = ' and '.join(sorted({member.name if member.named else member.instead for member in gone} - {''}))
    found = [problem.select((*kept, replace(form, instead=words, alike=alike))) for form in made if form is not None]
    return max(found, key=lambda each: each.score, default=None)


def _one_instead(problem: Problem, selection: Selection, places: list[int]) -> Selection | None:
    """Return the selection with the best single effect in place of some members, None where there is none.

    Two steps are tried as a pulse between their moments: on the grid another pulse may look better."""
    rest = problem.select([member for place, member in enumerate(selection.members) if place not in places])
    offers = [offer for offer in problem.offers([rest], tuple(EFFECTS), allow_repeats=True)[0] if offer.score > 0][:3]
    made = [child for offer in offers if (child := problem.child(rest, offer))]
    gone = [selection.members[place] for place in places]
    pulse = next((family for family in problem.families if family.name == 'frame_pulse'), None)
    if pulse and [member.name for member in gone] == ['frame_step'] * 2:
        begin, end = sorted(member.setting.number('t0') for member in gone)
        member = problem.member(pulse.effect, Setting(axes='xyz', t0=begin, t1=end), pulse.chances)
        made += [problem.select((*rest.members, problem.refine(member, rest)))] if member else []
    return max(made, key=lambda each: each.score, default=None)


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
        for margin, group in _groups(problem.run, selection):
            alike = len(group) == 2 and all(selection.members[place].named for place in group) and not any(
                p * len(wrong) < WRONG_SHAPE and place in group for p, (place,) in wrong)
            tried = ((_one_instead(problem, selection, group), ONE),
                     (free_instead(problem, selection, group, alike=alike), margin)
                     ) if len(group) > 1 else ((free_instead(problem, selection, group, ()), margin),)
            for merged, worse in tried:
                if merged is not None and merged.score > max(selection.score - worse, better.score if better else 0.0):
                    better = merged
        if better is None:
            break
        selection = problem.polish(prune(better))
    return _of_time_alone(problem, selection)


def _of_time_alone(problem: Problem, selection: Selection) -> Selection:
    """Return the selection with a curve in time in place of a product of two variables that is hardly better.

    In an ordered run angles are times, and their products as well."""
    curves = [place for place, member in enumerate(selection.members) if member.name == 'free_time']
    for place, member in enumerate(selection.members):
        for group in ([place], [place, *curves]) if member.name in PRODUCTS else ():
            made = free_instead(problem, selection, group, ('free_time',))
            if made is not None and made.score > selection.score - SIMPLER:
                return _of_time_alone(problem, made)
    return selection

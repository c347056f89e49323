# SPDX-License-Identifier: Apache-2.0
"""What moves with what and by which law, in words."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.common_cause import going_together
from rosette_ros.core.effects import motions as move
from rosette_ros.core.effects.composed import GOING
from rosette_ros.core.effects.effect import Motion, PhysicalEffect
from rosette_ros.core.effects.free import FREE, OF, TIMES
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.sight.limits import CLAIM, SURE
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.words.effect_words import (
    MEANINGS,
    decimals,
    fixed,
    minutes_words,
    names,
    plain_name,
    scale_of,
    setting_words,
    title_of,
)

VARIABLES = {
    'time': 'time', 'temperature': 'the temperature',
    'travel': 'the table travel', 'table angle': 'the table angle', 'CMM position': 'the CMM position',
    'ball': 'the ball', 'table sense': 'the sense of rotation', 'move size': 'the size of the last table move',
    'time since move': 'the time since the last table move', 'pause': 'the pause before the reading',
    'cmm memory': 'the history of CMM moves', 'table memory': 'the history of table moves',
    'cmm direction': 'the direction of the CMM move', 'cmm distance': 'the length of the CMM move',
    'cmm sense': 'the sense of the CMM move', 'encoder': 'the line of the encoder', 'reading': 'one reading',
    'touches': 'the number of readings'}
"""What a run records of its readings, in words; what runs like another one is said in this order."""
VERBS = {
    'frame': 'the probe moves', 'plate': 'the plate moves', 'plate growing': 'the plate grows or shrinks',
    'plate distorting': 'the plate becomes oval', 'table or plate turning': 'the table or the plate turns',
    'table axis tilting': 'the table axis tilts', 'plate tilting': 'the plate tilts',
    'first scale of the CMM': 'the first scale of the CMM changes',
    'second scale of the CMM': 'the second scale of the CMM changes',
    'squareness of the CMM': 'the squareness of the CMM changes',
    'scales and squareness of the CMM': 'scales and squareness of the CMM change'}
"""What bodies do."""
NOUNS = {
    'frame': 'shift of the probe', 'plate': 'shift of the plate', 'plate growing': 'growth of the plate',
    'plate distorting': 'ovalling of the plate', 'table or plate turning': 'turn of the table or the plate',
    'table axis tilting': 'tilt of the table axis', 'plate tilting': 'tilt of the plate',
    'first scale of the CMM': 'change of the first CMM scale',
    'second scale of the CMM': 'change of the second CMM scale',
    'squareness of the CMM': 'change of the CMM squareness',
    'scales and squareness of the CMM': 'change of CMM scales and squareness'}
"""What that is, as a noun."""
BODIES = {'frame': 'probe', 'first scale of the CMM': 'first CMM scale', 'second scale of the CMM': 'second CMM scale',
          'squareness of the CMM': 'CMM squareness', 'scales and squareness of the CMM': 'CMM scales and squareness'}
"""Bodies of another name where they stand beside one that is said."""
MOST = 3
"""Alternatives that are said one by one, of bodies, variables, laws and names."""
MOVES: dict[type[Motion], str] = {
    move.FrameAxes: 'the probe moves', move.TableTurn: 'the table or the plate turns',
    move.AxisTilt: 'the table axis tilts', move.AxisShiftAndTilt: 'the table axis moves',
    move.TableAxial: 'the table grows',
    move.PlateSlide: 'the plate moves', move.PlateSlideAndTurn: 'the plate moves', move.PlateGrowth: 'the plate grows',
    move.PlateOnSupports: 'the plate tilts', move.PlateTilt: 'the plate tilts',
    move.PlateOval: 'the plate becomes oval', move.PlateSaddle: 'the plate warps', move.PlateBending: 'the plate bends',
    move.BallInPlate: 'a ball moves', move.AlongTableFrame: 'the ball centre is off',
    move.BallForm: 'the balls are not round', move.CmmScales: 'the scales of the CMM grow',
    move.CmmSquareness: 'the angle between x and y changes', move.CmmDeformation: 'the CMM deforms',
    move.CmmReversal: 'the CMM lags',
    move.CmmReversalByPosition: 'the CMM lags', move.ProbeDeflection: 'the ball centre is off'}
"""What each motion does, before 'by' and a size."""
HOW = {type(going.course('m')): going.how for going in GOING}
"""How a body moves by each course."""
SIGNIFICANT = 2.0
"""Standard uncertainties from which on a component is said; the largest always is."""
MOST_SIZES = 3
"""Sizes that are said."""
NOT_IN_LIBRARY = 'not in the library'
"""Of a law that no entry of the library is, in every sentence."""
ALL_AXES = ('', 'x, y and z', 'its x, y and z')
"""Directions that need not be said."""
SAID_ELSEWHERE = ('axes', 'ball', 'reading', 't0', 't1', 'driver', 'start')


class Said:
    """What is the same here as something else: it is said once of a run."""

    def __init__(self) -> None:
        self._sets: list[frozenset[str]] = []

    def new(self, first: str, others: Sequence[str]) -> list[str]:
        """Return what was not yet said to be the same as the first; from now on it is."""
        out = [one for one in others if not any({first, one} <= some for some in self._sets)]
        self._sets.append(frozenset((first, *others)))
        return out


class _Statement(NamedTuple):
    """What moves, in brackets what else that may be; with what, and in brackets what runs like that and how probable it
    is; by which law. Or all in the first."""

    who: str
    others: str = ''
    way: str = ''
    alike: str = ''
    probability: str = ''
    law: str = ''

    @property
    def words(self) -> str:
        first = [self.who, _bracket(self.others)] if self.who else []
        last = _bracket(*[self.others] * (not self.who), self.alike, self.probability)
        return ' '.join(filter(None, (*first, self.way, last))) + self.law


def _bracket(*parts: str) -> str:
    said = '; '.join(filter(None, parts))
    return f'({said})' if said else ''


def chance(probability: float) -> str:
    """Return a probability in whole percent, from 1 to 99 %."""
    return f'{100 * min(max(probability, 0.01), 0.99):.0f} %'


def titles(every: Iterable[str]) -> str:
    """Return effects by their titles, each once with how often it is there."""
    found = list(every)
    return names(f'{title_of(one)}{f" ({found.count(one)} times)" if found.count(one) > 1 else ""}'
                 for one in dict.fromkeys(found))


def unnamed_words(*every: MissingEffect, said: Said | None = None) -> str:
    """Return what moves with what by laws without a name: 'the probe moves in y with time (97 %); its law is not ...'.
    """
    said = said or Said()
    once = [one for place, one in enumerate(every) if one.cause not in [other.cause for other in every[:place]]]
    law = 'their laws are' if len(once) > 1 else 'its law is'
    return f'{_joined([_free_statement(one, said) for one in once])}; {law} {_unnamed_law(once)}'


def _unnamed_law(every: Sequence[MissingEffect]) -> str:
    """Return what is known of the laws of motions without a name: that the library has none, or nothing, where it has
    several for one of them."""
    laws = [one.cause.laws for one in every if one.cause and one.cause.laws]
    if any(likeliest for (likeliest, _), *_ in laws):
        return 'not known'
    least, said = (chance(min(some)) for some in (
        [dict(one).get((), 1.0) for one in laws] or [1.0], [one.probability for one in every]))
    return NOT_IN_LIBRARY + f' ({least})' * bool(laws and least != said)


def member_words(name: str) -> str:
    """Return a member of an explanation: an effect by its title, else by the variables with which something moves."""
    of, _, body = name.partition(OF)
    *places, variable = of.split(TIMES) if of.startswith('one ') else ('', of)
    what = NOUNS[body] if body in NOUNS else ' at '.join(filter(None, ('motion', *places)))
    return plain_name(name) or f'{what} {with_words(variable.split(TIMES))} ({NOT_IN_LIBRARY})'


def variable_words(variable: str) -> str:
    """Return a variable in words, as it is where it has none."""
    return VARIABLES.get(variable, variable)


def missing_words(one: MissingEffect) -> str:
    """Return what is missing as far as it is known: its law; or what moves with what, and the likeliest law; or names.

    'slip of one ball (99 %)', 'the probe moves with time (99 %), most likely warm-up of the machine (61 %)'.
    """
    return _joined([_statement(one, Said())])


def causes_words(every: Sequence[MissingEffect], said: Said) -> str:
    """Return what is missing, each as of `missing_words`, what one body does and what has one cause together."""
    once = [one for place, one in enumerate(every)  # several names may be one motion
            if one.depth != 1 or one.cause not in [other.cause for other in every[:place]]]
    return _joined([_together(one, said) for one in going_together(once)])


def experience_words(one: MissingEffect) -> str:
    """Return which part of a probability is experience: 'in 7 of 9 earlier runs; this run alone: 62 %'."""
    if one.learnt is None:
        return ''
    runs = f'in {one.learnt.expected:.0f} of {one.learnt.judged} earlier runs; ' if one.learnt.judged else ''
    return f'{runs}this run alone: {chance(one.alone)}'


def laws_words(cause: Cause, most: int = MOST) -> str:
    """Return so many of the laws of a cause, the likeliest first, until one of them would be claimed, and none that is
    unlikely: 'linear probe drift (61 %), warm-up of the machine (36 %)'."""
    likely, held = list[tuple[tuple[str, ...], float]](), 0.0
    for law, p in cause.laws[:most]:
        if likely and (held >= CLAIM or p < 1 - SURE):
            break
        likely.append((law, p))
        held += p
    words = [titles(law) if law else f'one that is {NOT_IN_LIBRARY}' for law, _ in likely]
    for place, ((before, _), (law, _)) in enumerate(pairwise(likely), 1):
        if len({*before}) == 1 and {*before} == {*law}:  # one law so many times or so many
            words[place] = f'{len(law)} times' if len(law) > 1 else 'once'
    return ', '.join(f'{law} ({chance(p)})' for law, (_, p) in zip(words, likely))


def moves_words(one: MissingEffect) -> str:
    """Return what moves with what: 'the probe moves with time'; or names."""
    if one.name == FREE.name:
        return _free_statement(one, Said())._replace(probability='').words
    said = _moving(one, Said()) if one.depth else None
    return said.words if said else ' or '.join(map(title_of, (one.name, *one.look_alikes)))


def with_words(variables: Iterable[str]) -> str:
    """Return with what something moves: 'with time'; what is the same at every reading moves with nothing."""
    found = [*map(variable_words, variables)]
    return f'with {names(found)}' if found else 'by a constant amount'


def _joined(every: Iterable[_Statement]) -> str:
    """Return statements, each once, all that one body does in one: 'the probe moves with time (99 %), and with ...'."""
    found: list[list[_Statement]] = []
    for one in dict.fromkeys(every):
        same = [some for some in found if one.way and some[0].who == one.who]
        if same:
            same[0].append(one)
        else:
            found.append([one])
    return '; '.join(', and '.join([first.words, *(
        one._replace(who='', way='by another law' if one.way == before.way else one.way).words
        for before, one in pairwise((first, *further)))]) for first, *further in found)


def _free_statement(one: MissingEffect, said: Said) -> _Statement:
    """Return what moves with what of a motion without a name, and what runs like a variable."""
    body, _, along = one.motion.partition(' along ')
    axes = 'along ' * along.startswith('its') or 'in ' * bool(along)
    where = '' if along in ALL_AXES else f'{axes}{along} '
    cause = one.cause
    if cause is None:
        return _Statement(VERBS[body], way=where + with_words(()), probability=chance(one.probability))
    number = cause.number('ball')
    way, alike = _driven(cause, () if number is None else ('ball',), said)
    return _Statement(VERBS[body] if number is None else f'ball {number} moves',
                      _others_words(cause, said, (body,)) if number is None else '', where + way, alike,
                      chance(one.probability))


def _statement(one: MissingEffect, said: Said) -> _Statement:
    """Return what is missing, as of `missing_words`."""
    title, cause = title_of(one.name), one.cause
    if cause is None:
        return _Statement(title)
    learnt = f' [{experience_words(one)}]' if one.learnt else ''
    if one.depth == 1:
        (likeliest, p), *_ = cause.laws
        law = ('' if cause.number('reading') else  # which has one law only
               f', most likely {laws_words(cause, 1)}' if likeliest else f'; its law is {NOT_IN_LIBRARY} ({chance(p)})')
        moving = _moving(one, said) or _Statement(moves_words(one))
        return moving._replace(probability=chance(cause.probability), law=law + learnt)
    place = next((f', {key} {one.setting[key]}' for key in ('reading', 'ball') if one.setting.get(key)), '')
    others = [f'{title_of(name)} ({chance(p)})' for name, p in one.alternatives if not one.depth]
    every = few([f'{title}{place} ({chance(cause.law_probability)})', *others], 'one of ')
    return _Statement(', or '.join(every) + learnt)


def _moving(one: MissingEffect, said: Said) -> _Statement | None:
    """Return what moves with what, by the verb of its law, and what runs like a variable, of a sure law what is
    plainer; None of a law that has none."""
    effect, cause = MEANINGS.get(one.name), one.cause
    if cause is None or not isinstance(effect, PhysicalEffect):
        return None
    ball, reading = cause.number('ball'), cause.number('reading')
    if reading:
        return _Statement(f'reading {reading} is off')
    own = effect.motion.variables
    driven = _driven(cause if cause.law_probability < SURE else _with_plainer(cause), own, said)
    return _Statement(MOVES[type(effect.motion)] if ball is None else _does(effect, f'ball {ball}'),
                      _others_words(cause, said, effect.moved(one.setting)), *driven)


def _with_plainer(cause: Cause) -> Cause:
    """Return a cause of a sure law with those variables that run like its own and are plainer: with which it moves as
    well."""
    plainer = {one: [*VARIABLES][:place] for place, one in enumerate(VARIABLES)}
    return replace(cause, variables=tuple(
        (first, *(one for one in others if one in plainer.get(first, ()))) for first, *others in cause.variables))


def _together(some: Sequence[MissingEffect], said: Said) -> _Statement:
    """Return what is missing as far as it is known; of several motions of one course that they are one cause.

    'the probe moves and the table axis tilts with time (99 %), most likely by one cause, with a fixed period in time
    (period 11.3 min) (96 %)'."""
    first, *others = some
    effect = MEANINGS.get(first.name)
    if not others or not isinstance(effect, PhysicalEffect) or first.cause is None:
        return _statement(first, said)
    numbers = {part.name: first.setting[part.name] for part in effect.course.searched
               if part.name in first.setting and part.kind != 'choice'}
    setting = setting_words(first.name, numbers, time=first.time_unit)
    every = [one for one in (_moving(one, said) for one in some) if one]
    moving = names([one._replace(way='', alike='').words for one in every])
    there = min(one.probability for one in some)
    known = min(max((p for law, p in one.cause.laws if law), default=0.0) for one in some if one.cause)
    way = f'{_driven_words(first.cause, effect.motion.variables)} {_bracket(every[0].alike, chance(there))}'
    return _Statement(f'{moving} {way}, most likely by one cause, {HOW[type(effect.course)]} ({setting}) '
                      f'({chance(known)})')


def _driven(cause: Cause, own: Sequence[str], said: Said) -> tuple[str, str]:
    """Return with what something moves, but for what it is itself, `own`, and with what else that may be; in brackets
    what runs like a variable, of the last one beside it: 'with time', 'number of readings and table travel run alike'.
    """
    beyond = [some for some in cause.variables if some[0] not in own] or cause.variables
    itself = {first for first, *_ in beyond}
    variables = [(variable_words(first), _alike_words([one for one in said.new(first, others) if one not in itself]))
                 for first, *others in beyond]
    if not variables:
        return _ways(with_words(()), *map(with_words, cause.or_with)), ''
    *others, (last, alike) = variables
    beside = '' if cause.or_with else alike  # else it stands in the middle
    every = [*others, (last, '' if beside else alike)]
    first = f'with {names(" ".join(filter(None, (one, _bracket(run)))) for one, run in every)}'
    return _ways(first, *map(with_words, cause.or_with)), beside


def _ways(*every: str) -> str:
    """Return with what something moves, or may move as well: 'with time, or with the temperature'."""
    return ', or '.join(few(every, 'with one of '))


def _driven_words(cause: Cause, own: Sequence[str] = ()) -> str:
    """Return with what something moves, and with what else that may be; own: what its verb says beside others."""
    every = [[first for first, *_ in cause.variables], *cause.or_with]
    return _ways(*(with_words([one for one in some if one not in own] or some) for some in every))


def _alike_words(variables: Sequence[str]) -> str:
    """Return what runs like a variable, '' where nothing does."""
    in_order = sorted(variables, key=lambda one: [*VARIABLES, one].index(one))
    every = few([variable_words(one).removeprefix('the ') for one in in_order], beside=1)
    return f'{names(every)} run{"s" * (len(every) == 1)} alike' if every else ''


def _others_words(cause: Cause, said: Said, own: Collection[str]) -> str:
    """Return which bodies it may be as well, beside its own, and which are the same in this order."""
    others = said.new(min(own), [body for body in cause.bodies if body not in own and body in VERBS])
    apart, alike = ([BODIES.get(body, body) for body in others if (body in cause.alike) == is_alike]
                    for is_alike in (False, True))
    return '; '.join([f'{lead} {names(few(some, "one of ", beside=1), "or")}'
                      for lead, some in (('or', apart), ('the same here:', alike)) if some])


def few(every: Sequence[str], lead: str = '', beside: int = 0) -> list[str]:
    """Return some alternatives one by one, and after `lead` how many more there are; beside: said before them."""
    said = MOST - beside
    more = len(every) - said
    return [*every[:said], *['one more' if more == 1 else f'{lead}{more} more'] * (more > 0)]


def _does(effect: PhysicalEffect, who: str) -> str:
    """Return what an effect of one ball or reading does with it."""
    return f'{who} {"moves" if isinstance(effect.motion, move.BallInPlate) else "is off"}'


def does_words(one: MissingEffect) -> str:
    """Return what it does: 'ball 11 moves by 1.92 ± 0.05 µm in x between 37.4 and 49.7 min'; a base term: its meaning.
    """
    effect = MEANINGS.get(one.name)
    if not isinstance(effect, PhysicalEffect):
        return effect.meaning if effect else ''
    verb, setting = MOVES[type(effect.motion)], one.setting
    for key in ('ball', 'reading'):
        number = str(setting.get(key, ''))
        if number.isdigit():
            verb = _does(effect, f'{key} {number}' if number != '0' else f'every {key}')
    sizes = _sizes([part for part in one.parameters if part.name not in setting])
    rest = setting_words(one.name, setting, SAID_ELSEWHERE, time=one.time_unit)
    return ' '.join(filter(None, [verb, f'by {sizes}' if sizes else '', _when(one), f'({rest})' if rest else '']))


def _sizes(parameters: 'Sequence[Parameter]') -> str:
    """Return the sizes of amplitudes with U (k = 2), those along one axis and of one unit together, as their length:
    '2.5 ± 0.3 µm/h in x, 1.5 ± 0.3 µm/h in z'; what is no larger than its U is not determined."""
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for one in parameters:
        axis = one.name[-1] if one.name[-2:] in ('_x', '_y', '_z') else ''
        groups.setdefault((one.unit, axis), []).append(one)
    found = []
    for (unit, axis), some in groups.items():
        length = sum(one.value**2 for one in some)**0.5
        u = sum((one.value / length * one.u)**2 for one in some)**0.5 if length else max(one.u for one in some)
        found.append((length / u if u else math.inf, some[0].value if len(some) == 1 else length, u, unit, axis))
    found.sort(key=lambda each: -each[0])
    said = [each for each in found[:MOST_SIZES] if each[0] > SIGNIFICANT] or found[:1]
    out = []
    for ratio, value, u, unit, axis in sorted(said, key=lambda each: (each[3], each[4])):
        scale = scale_of(unit)
        expanded = COVERAGE_FACTOR * scale.factor * u
        places, is_known = decimals(expanded), ratio > SIGNIFICANT
        size = (f'{fixed(scale.factor * value, places)} ± {fixed(expanded, places)} {scale.unit}'.rstrip() if is_known
                else f'an amount that is not determined (U = {fixed(expanded, places)} {scale.unit})'
                if math.isfinite(expanded) else 'an amount that is not determined')
        out.append(size + (f' {"about" if unit.startswith("rad") else "in"} {axis}' if axis and is_known else ''))
    return ', '.join(out)


def _when(one: MissingEffect) -> str:
    """Return when it begins and ends, where that is a part of it."""
    out = []
    for name, lead, at in (('t0', '', 'from'), ('t1', 'until ', 'to')):
        if name in one.moments:
            when = one.moments[name]
            times = f'{minutes_words(when.low, when.high)}, ' * (one.time_unit == 's')
            out.append(f'{lead}between readings {when.last} and {when.first} ({times}{chance(when.probability)})')
        elif name in one.setting:
            moment = setting_words(one.name, {name: one.setting[name]}, time=one.time_unit)
            out.append(f'{at} {moment.partition(" ")[2]}')
    return ' '.join(out)

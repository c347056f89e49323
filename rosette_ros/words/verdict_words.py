# SPDX-License-Identifier: Apache-2.0
"""A verdict, and the noise of a run, in words: every interface prints these as they stand."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import hypot, isnan

from rosette_ros.core.diagnosis.cause import Cause, MissingEffect
from rosette_ros.core.diagnosis.common_cause import CommonCause, common_causes
from rosette_ros.core.diagnosis.limits import LISTED, SURE
from rosette_ros.core.diagnosis.noise_facts import NoiseFacts
from rosette_ros.core.diagnosis.verdict import Outcome, Residual, Verdict, VerdictText
from rosette_ros.core.diagnosis.wrong_readings import WRONG, WrongReading
from rosette_ros.core.effects import motions as move
from rosette_ros.core.effects.composed import GOING
from rosette_ros.core.effects.effect import Motion, PhysicalEffect
from rosette_ros.core.effects.free import OF
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.model.noise import Group
from rosette_ros.core.run.number_words import SCALES, micrometres, multiple, p_words, significant
from rosette_ros.core.run.records import SI_UNITS
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.stated_environment import LABORATORY, Unseen
from rosette_ros.words.effect_words import (
    MEANINGS,
    capital,
    decimals,
    fixed,
    minutes_words,
    names,
    plain_name,
    scale_of,
    setting_words,
    title_of,
)
from rosette_ros.words.reading_words import remark_words

HEADLINES = {
    Outcome.UNIT: 'NOT JUDGED, THE UNIT OF THE READINGS IS IN DOUBT',
    Outcome.FITS: 'THE MODEL FITS', Outcome.NAMED: 'SYSTEMATIC EFFECT FOUND, NOT IN THE MODEL',
    Outcome.SUSPECTED: 'SYSTEMATIC EFFECT SUSPECTED, NOT IN THE MODEL',
    Outcome.UNNAMED: 'SYSTEMATIC EFFECT FOUND, CAUSE NOT IDENTIFIED',
    Outcome.SCATTERS: 'THE READINGS SCATTER MORE THAN STATED',
    Outcome.DOUBTFUL_READINGS: 'THE MODEL FITS, READINGS IN DOUBT',
    Outcome.NOISE: 'THE NOISE IS UNUSUAL',
    Outcome.NO_REPEATABILITY: 'NOT JUDGED, THE REPEATABILITY IS NOT KNOWN',
    Outcome.NOT_DETERMINABLE: 'TOO FEW READINGS FOR THE MODEL'}
"""How an outcome is shown; files and messages have its value."""
SHORT = {
    Outcome.UNIT: 'unit in doubt', Outcome.FITS: 'model fits', Outcome.NAMED: 'effect found',
    Outcome.SUSPECTED: 'effect suspected', Outcome.UNNAMED: 'cause not identified',
    Outcome.SCATTERS: 'scatters too much', Outcome.DOUBTFUL_READINGS: 'readings in doubt',
    Outcome.NOISE: 'noise is unusual', Outcome.NO_REPEATABILITY: 'repeatability not known',
    Outcome.NOT_DETERMINABLE: 'too few readings'}
"""An outcome in at most three words, where many runs stand in a list."""
NOTHING_TO_DO = 'Nothing needs to be done.'
VARIABLES = {
    'time': 'time', 'table angle': 'the table angle', 'CMM position': 'the CMM position',
    'ball': 'the ball that is measured',
    'travel': 'the angle that the table has turned', 'move size': 'the size of the last table move',
    'time since move': 'the time since the last table move', 'table sense': 'the sense of rotation of the table',
    'touches': 'the number of readings', 'pause': 'the pause before the reading',
    'cmm memory': 'the last few CMM moves', 'cmm direction': 'the direction of the last CMM move',
    'cmm distance': 'the length of the last CMM move', 'cmm sense': 'the senses of the last CMM moves',
    'temperature': 'the temperature', 'encoder': 'the lines of the encoder', 'reading': 'one reading'}
"""What a run records of its readings, in words."""
MOTIONS = {
    'plate growing': 'makes the plate grow or shrink', 'table or plate turning': 'turns the table or the plate',
    'table axis tilting': 'tilts the table axis', 'plate tilting': 'tilts the plate',
    'plate distorting': 'makes the plate oval',
    'first scale of the CMM': 'changes the scale of the first axis of the CMM',
    'second scale of the CMM': 'changes the scale of the second axis of the CMM',
    'squareness of the CMM': 'changes the squareness of the CMM',
    'scales and squareness of the CMM': 'changes the scales and the squareness of the CMM'}
"""Motions of bodies but for displacements along axes, as verbs."""
VERBS = {
    'frame': 'the probe moves', 'plate': 'the plate moves', 'plate growing': 'the plate grows or shrinks',
    'plate distorting': 'the plate becomes oval', 'table or plate turning': 'the table or the plate turns',
    'table axis tilting': 'the table axis tilts', 'plate tilting': 'the plate tilts',
    'first scale of the CMM': 'the scale of the first axis of the CMM changes',
    'second scale of the CMM': 'the scale of the second axis of the CMM changes',
    'squareness of the CMM': 'the squareness of the CMM changes',
    'scales and squareness of the CMM': 'the scales and the squareness of the CMM change'}
"""What bodies do that may have moved as well."""
MOST_OTHERS = 3
"""Alternatives that are said one by one."""
MOVES: dict[type[Motion], str] = {
    move.FrameAxes: 'the probe moves', move.TableTurn: 'the table or the plate turns',
    move.AxisTilt: 'the table axis tilts', move.AxisShiftAndTilt: 'the table axis moves',
    move.TableAxial: 'the table grows',
    move.PlateSlide: 'the plate moves', move.PlateSlideAndTurn: 'the plate moves', move.PlateGrowth: 'the plate grows',
    move.PlateOnSupports: 'the plate tilts', move.PlateTilt: 'the plate tilts',
    move.PlateOval: 'the plate becomes oval', move.PlateSaddle: 'the plate warps', move.PlateBending: 'the plate bends',
    move.BallInPlate: 'a ball moves', move.AlongTableFrame: 'the ball centre is off',
    move.BallForm: 'the balls are not round', move.CmmScales: 'the scales of the CMM grow',
    move.CmmSquareness: 'the angle between x and y changes', move.CmmReversal: 'the CMM lags',
    move.CmmReversalByPosition: 'the CMM lags', move.ProbeDeflection: 'the ball centre is off'}
"""What each motion does, before 'by' and a size."""
HOW = {type(going.course('m')): going.how for going in GOING}
"""How a body moves by each course."""
SIGNIFICANT = 2.0
"""Standard uncertainties from which on a component is said; the largest always is."""
MOST_SIZES, MOST_WRONG = 3, 4
"""Sizes, and wrong readings, that are said."""
OTHER_UNIT = 100.0
"""Ratio of the repeatability of axes from which on a wrong unit is the likelier cause."""
MOST_OF_U = 0.5
"""Share of a variance from which on it is most of it."""
MOST_LAWS = 3
"""Laws of a cause that are said at most."""
MOST_SETS = 3
"""Sets of variables that are said to drive one motion."""
NOT_IN_LIBRARY = 'not in the library'
"""Of a law that no entry of the library is, in every sentence."""
SAID_ELSEWHERE = ('axes', 'ball', 'reading', 't0', 't1')
_ALONG = re.compile(r'(\w+) along (its )?(.+)')


def verdict_text(verdict: Verdict) -> VerdictText:
    """Return a verdict in words."""
    if verdict.outcome == Outcome.NOT_DETERMINABLE:
        remove = f', or remove {titles(verdict.added)} from the model' if verdict.added else ''
        return VerdictText(verdict.outcome, verdict.reason, f'Measure the missing balls{remove}.')
    actions = '; '.join(_actions(verdict))
    return VerdictText(verdict.outcome, ' '.join(_sentences(verdict)), f'{capital(actions)}.' if actions else
                       NOTHING_TO_DO, tuple(_limits(verdict)), verdict.unseen)


def titles(every: Iterable[str]) -> str:
    """Return effects by their titles, each once with how often it is there."""
    found = list(every)
    return names(f'{title_of(one)}{f" ({found.count(one)} times)" if found.count(one) > 1 else ""}'
                 for one in dict.fromkeys(found))


def unexplained_words(verdict: Verdict) -> str:
    """Return what no named effect explains, empty where nothing is left."""
    return '; '.join(map(unnamed_words, verdict.unnamed)) or (
        _against_repeatability(verdict.after) if verdict.unexplained and verdict.after else '')


def unnamed_words(one: MissingEffect) -> str:
    """Return what moves and with what: 'something moves the frame in y with the time since the last table move; ...'.
    """
    ball = re.match(r'ball (\d+)', one.setting.word('of'))
    along = _ALONG.fullmatch(one.motion)
    if along:
        body = f'ball {ball[1]}' if ball else f'the {along[1]}'
        moves = f'moves {body} {f"along its {along[3]}" if along[2] else f"in {along[3]}"}'
    else:
        moves = MOTIONS.get(one.motion, f'moves ({one.motion})')
    moves += _others_words(one.cause, one.motion.partition(' along ')[0]) if one.cause else ''
    return f'something {moves} {_driven_words(one.cause, own=("ball",) if ball else ())}; its law is {NOT_IN_LIBRARY}'


def _driven_words(cause: Cause | None, own: Sequence[str]) -> str:
    """Return with what something moves, but for what it is itself, `own`: what is correlated with a variable in a
    bracket, then other sets of variables.

    'with time (correlated with it here: the number of readings)', 'with time, or with the table angle'."""
    variables, others = (cause.variables, cause.or_with) if cause else ((), ())
    sets = [*map(with_words, others[:MOST_SETS - 1])]
    more = len(others) - len(sets)
    said = [_in_words(first) + (f' (correlated with it here: {names(map(_in_words, alike))})' if alike else '')
            for first, *alike in variables if first not in own]
    first = f'with {names(said)}' if said else 'by a constant amount'
    return ', or '.join([first, *sets, *[f'with one of {more} other sets of variables'] * (more > 0)])


def member_words(name: str) -> str:
    """Return a member of an explanation: an effect by its title, else by the variables with which something moves."""
    variables, _, body = name.partition(OF)
    who = f'a motion of the {body}' if body else 'a motion'
    return plain_name(name) or f'{who} with {_in_words(variables)} that is {NOT_IN_LIBRARY}'


def _in_words(variable: str) -> str:
    return VARIABLES.get(variable, variable)


def _sentences(verdict: Verdict) -> list[str]:
    out = [*_outcome(verdict), *_wrong(verdict)]
    if verdict.too_large:
        out.append(f'The stated repeatability is {multiple(verdict.too_large)} times what the readings show, so '
                   'uncertainties based on it are too large.')
    if verdict.noise.is_other:
        out.append(f'The noise is {noise_kind(verdict.noise)}: {"; ".join(_other_noise(verdict.noise))}.')
    out += [f'{capital(one)}.' for one in _rounding_words(verdict.noise)]
    beside = [one for one in verdict.doubtful if one[1] >= SURE and (verdict.missing or verdict.unnamed)]
    out += [f'{lead}: {names(f"{title_of(name)} ({chance(p)})" for name, p in some)}.' for lead, some in (
        ('Not added to the model, as it may be a part of the motion above', beside),
        ('Possible, but not certain', [one for one in verdict.doubtful if one not in beside])) if some]
    if not verdict.has_motions:
        out.append('The model has no error motions of the table: their curves are zero by assumption.')
    if (one := verdict.unseen) and one.environment and one.share > MOST_OF_U:
        out.append(f'Most of U of {one.curve} is what this order cannot show, first of all {title_of(one.largest)}.')
    return out


def _outcome(verdict: Verdict) -> list[str]:
    """Return what was decided, in sentences."""
    before, after = verdict.before, verdict.after
    if not (before and after):
        return []
    basis = [] if before.repeatability is not None else [
        'The repeatability is not known, so this rests on the structure of the residual alone.']
    match verdict.outcome:
        case Outcome.UNIT:
            return [f'{capital(remark_words(remark))}.' for remark in verdict.remarks
                    if remark.kind is RemarkKind.UNIT_OF_COORDINATES]
        case Outcome.NAMED | Outcome.SUSPECTED | Outcome.UNNAMED if verdict.missing:
            it = ('them' if len(verdict.missing) > 1 else
                  'the likeliest of them' if not verdict.missing[0].depth and verdict.missing[0].alternatives else 'it')
            known = '' if before.repeatability is None else f' (repeatability {micrometres(before.repeatability)})'
            what = capital('; '.join(dict.fromkeys(map(_together_words, common_causes(verdict.missing)))))
            lacks = (f'{what}. With {it} the residual standard deviation falls from {micrometres(before.rms)} to '
                     f'{micrometres(after.rms)}{known}.')
            scatters = [f'Even with {it}, the readings scatter more than stated: '
                        f'{_against_repeatability(after)}.'] * (after.scatters and not verdict.unnamed)
            return [lacks, *_unnamed_sentences(verdict.unnamed), *scatters, *basis]
        case Outcome.UNNAMED | Outcome.SUSPECTED:
            return [*_unnamed_sentences(verdict.unnamed), *basis]
        case Outcome.SCATTERS:
            return [f'The readings scatter more than stated: {_against_repeatability(after)}.']
        case Outcome.NO_REPEATABILITY:
            shows = 'is' if verdict.noise.is_correlated else 'shows no structure and is'
            return ['Whether the model fits cannot be said, as the repeatability is not known; the residual '
                    f'{shows} {micrometres(before.rms)}.']
        case Outcome.DOUBTFUL_READINGS:
            return [f'{_fits(verdict, before)} The readings themselves are in doubt.']
    return [_fits(verdict, before), *unseen_sentences(verdict.unseen)]


def _fits(verdict: Verdict, residual: Residual) -> str:
    """Return that a model fits; of a residual that has structure only that no effect of the grammar explains it."""
    if verdict.has_structure:
        return f'No missing effect is found, but {_against_repeatability(residual)}.'
    return f'The model fits: {_against_repeatability(residual)} and shows no structure.'


def unseen_sentences(one: Unseen | None) -> list[str]:
    """Return whether U contains what the order cannot show, a sentence where that matters."""
    if one is None:
        return []
    if one.environment:
        return [f'U contains what this order cannot show (environment: {one.environment}).']
    scale = scale_of(SI_UNITS[one.curve])
    alone, whole = (f'{fixed(scale.factor * u, decimals(scale.factor * one.alone))} {scale.unit}'
                    for u in (one.alone, one.whole))
    return [f'U of {one.curve}, {alone}, does not contain what this order cannot show; in a {LABORATORY.name} '
            f'environment it is {whole}.']


def missing_words(one: MissingEffect) -> str:
    """Return what is missing as far as it is known: its law; or what moves with what, and the likeliest law; or names.

    'slip of one ball (99 %)', 'the probe moves with time (99 %), most likely warm-up of the machine (61 %)'.
    """
    title, cause = title_of(one.name), one.cause
    if cause is None:
        return title
    if one.learnt is not None:
        known = replace(one, learnt=None)
        return f'{missing_words(known)} [{experience_words(one)}]'
    if one.depth == 1:
        what = f'{moves_words(one)} ({chance(cause.probability)})'
        (likeliest, p), *_ = cause.laws
        return (f'{what}, most likely {laws_words(cause)}' if likeliest else
                f'{what}; its law is {NOT_IN_LIBRARY} ({chance(p)})')
    number = cause.number('reading') or cause.number('ball')
    place = '' if number is None else f', {"reading" if cause.number("reading") else "ball"} {number}'
    others = ''.join(f', or {title_of(name)} ({chance(p)})' for name, p in one.alternatives if not one.depth)
    return f'{title}{place} ({chance(cause.law_probability)}){others}'


def experience_words(one: MissingEffect) -> str:
    """Return which part of a probability is experience: 'in 7 of 9 earlier runs; this run alone: 62 %'."""
    if one.learnt is None:
        return ''
    runs = f'in {one.learnt.expected:.0f} of {one.learnt.judged} earlier runs; ' if one.learnt.judged else ''
    return f'{runs}this run alone: {chance(one.alone)}'


def laws_words(cause: Cause, most: int = MOST_LAWS) -> str:
    """Return so many of the likeliest laws of a cause: 'slip of one ball (95 %), creep of one ball (4 %)'."""
    likely = [(law, p) for law, p in cause.laws if p >= LISTED][:most] or cause.laws[:1]
    return ', '.join(f'{titles(law) if law else f"a law that is {NOT_IN_LIBRARY}"} ({chance(p)})' for law, p in likely)


def moves_words(one: MissingEffect) -> str:
    """Return what moves with what: 'the probe moves with time'; or names."""
    verb, cause = _verb(one) if one.depth else '', one.cause
    if not verb or cause is None:
        return ' or '.join(map(title_of, (one.name, *(name for name, _ in one.alternatives))))
    return verb if cause.number('reading') else f'{verb} {_with_cause(cause)}'


def _verb(one: MissingEffect) -> str:
    """Return what moves, with the bodies that it may be as well: 'the probe moves'; '' where that is not known."""
    effect, cause = MEANINGS.get(one.name), one.cause
    if cause is None or not isinstance(effect, PhysicalEffect):
        return ''
    ball, reading = cause.number('ball'), cause.number('reading')
    if reading:
        return f'reading {reading} is off'
    verb = MOVES[type(effect.motion)] if ball is None else _does(effect, f'ball {ball}')
    return f'{verb}{_others_words(cause, *effect.moved(one.setting))}'


def _with_cause(cause: Cause) -> str:
    """Return with what something moves, and with what else that may be: 'with time, or with the table angle'."""
    return ', or '.join(map(with_words, ([first for first, *_ in cause.variables], *cause.or_with)))


def _together_words(some: CommonCause) -> str:
    """Return what is missing as far as it is known; of several motions of one course that they are one cause.

    'the probe moves and the table axis tilts with time (99 %), most likely by one cause, with a fixed period in time
    (period 11.3 min) (96 %)'."""
    first, *others = some.effects
    effect = MEANINGS.get(first.name)
    if not others or not isinstance(effect, PhysicalEffect) or first.cause is None:
        return missing_words(first)
    numbers = {part.name: first.setting[part.name] for part in effect.course.searched if part.name in first.setting}
    setting = setting_words(first.name, numbers, time=first.time_unit)
    return (f'{names(map(_verb, some.effects))} {_with_cause(first.cause)} ({chance(some.probability)}), '
            f'most likely by one cause, {HOW[type(effect.course)]} ({setting}) ({chance(some.law_probability)})')


def _others_words(cause: Cause, *said: str) -> str:
    """Return in brackets which bodies it may be as well, beside those that are said."""
    every = [VERBS[body] for body in cause.bodies if body not in said and body in VERBS]
    more = [f'{len(every) - MOST_OTHERS} more'] * (len(every) > MOST_OTHERS)
    return f' (or {" or ".join([*every[:MOST_OTHERS], *more])}: the same here)' if every else ''


def with_words(variables: Iterable[str]) -> str:
    """Return with what something moves: 'with time'; what is the same at every reading moves with nothing."""
    found = [*map(_in_words, variables)]
    return f'with {names(found)}' if found else 'by a constant amount'


def _does(effect: PhysicalEffect, who: str) -> str:
    """Return what an effect of one ball or reading does with it."""
    return f'{who} {"moves" if isinstance(effect.motion, move.BallInPlate) else "is off"}'


def _unnamed_sentences(every: Sequence[MissingEffect]) -> list[str]:
    """Return a sentence for each structure without a name."""
    return [f'{capital(unnamed_words(one))} (probability {chance(one.probability)}).' for one in every]


def _wrong(verdict: Verdict) -> list[str]:
    if not verdict.wrong:
        return []
    listed, others = verdict.wrong[:MOST_WRONG], verdict.wrong[MOST_WRONG:]
    more = [f'{len(others)} more'] * bool(others)
    return [f'Wrong readings, off by more than {WRONG:.0f} times the scatter of the others: '
            f'{"; ".join([*map(_reading, listed), *more])}.']


def _reading(one: WrongReading) -> str:
    scale = SCALES['s']
    after = '' if isnan(one.time) else f' after {fixed(scale.factor * one.time, 1)} {scale.unit},'
    return (f'reading {one.number}, table position {one.table_position}, ball {one.ball},{after} '
            f'{micrometres(one.size)} along {one.axis}')


def _against_repeatability(residual: Residual) -> str:
    """Return how large the residual is against the stated repeatability; empty where none is stated."""
    known, p = residual.repeatability, residual.p
    if known is None or p is None:
        return ''
    together = hypot(known, residual.rounding)
    ratio = residual.rms / together
    rounded = f' with rounding, together {micrometres(together)}' * bool(residual.rounding)
    part = (f', {multiple(residual.quietest * ratio)} times in its quietest part'
            if residual.quietest < 0.5 else '')
    return (f'the residual of {micrometres(residual.rms)} is {multiple(ratio)} times the stated repeatability of '
            f'{micrometres(known)}{rounded}{part} '
            f'({p_words(p)})')


def _actions(verdict: Verdict) -> list[str]:
    """Return what to do, most urgent first."""
    out = [f'check the readings: {remark_words(remark)}' for remark in verdict.remarks
           if remark.kind is not RemarkKind.UNIT_OF_COORDINATES]
    if verdict.outcome == Outcome.UNIT:
        return [*out, 'correct the unit, and evaluate again']
    if verdict.missing:
        it, cause = ('it', 'the cause') if len(verdict.missing) == 1 else ('them', 'the causes')
        out.append(f'eliminate {cause} and repeat the measurement, or include {it} in the evaluation model')
    elif verdict.unnamed:
        out += _checks(verdict.unnamed)
    elif verdict.outcome == Outcome.SCATTERS:
        out.append('measure the repeatability again, check the resolution of the coordinates, and look at the '
                   'residual maps')
    elif verdict.outcome == Outcome.NO_REPEATABILITY:
        out.append('measure the repeatability')
    if verdict.outliers or verdict.wrong:
        out.append('measure the wrong readings again')
    if verdict.too_large:
        out.append('measure the repeatability again, and check its unit')
    if verdict.present:
        out.append('compensated numerically; the cause remains to be eliminated: ' + names(
            f'{title_of(name)} ({micrometres(rms)} rms)' for name, rms in verdict.present))
    out += noise_actions(verdict.noise)
    if verdict.not_needed:
        out.append(f'remove {titles(verdict.not_needed)} from the model: without it the residual rises by no more '
                   'than chance')
    if not verdict.has_motions:
        out.append('add the error motions of the table to the model')
    if (one := verdict.unseen) and (not one.environment or one.share > MOST_OF_U):
        state = '' if one.environment else 'state the environment of the cell, or '
        out.append(f'{state}use the interleaved order')
    return out


def _limits(verdict: Verdict) -> list[str]:
    """Return what the run cannot tell, a sentence each."""
    out: list[str] = []
    for one in verdict.missing:
        said = {name for law, _ in one.cause.laws for name in law} if one.cause else set()
        others = [f'{title_of(name)} ({chance(p)})' for name, p in one.alternatives if name not in said]
        if others and one.depth:  # else they are named in the first sentence
            out.append(f'This run cannot distinguish {title_of(one.name)} from {" or ".join(others)}.')
    out = [*dict.fromkeys(out)]
    if verdict.hidden:
        out.append(f'This run could not have shown {titles(verdict.hidden)}.')
    return out


def chance(probability: float) -> str:
    """Return a probability in whole percent, from 1 to 99 %."""
    return f'{100 * min(max(probability, 0.01), 0.99):.0f} %'


# Causes


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


def _checks(unnamed: Sequence[MissingEffect]) -> list[str]:
    """Return what to check for motions without a name: what changes with the variables that may drive them."""
    causes = [one.cause for one in unnamed if one.cause]
    drive = dict.fromkeys(name for cause in causes for some in (*cause.variables, *cause.or_with) for name in some)
    several = any(len(cause.alternatives) > 1 for cause in causes)
    return [f'check the cell for what changes with {" or ".join(map(_in_words, drive))}' if drive else
            'check the cell for what is off by a constant amount',
            *['measure further readings to distinguish these'] * several]


def noise_kind(noise: NoiseFacts) -> str:
    """Return what noise is not: 'not white and not equal'."""
    lacks = [name for name, is_it in (('white', noise.is_correlated), ('equal', noise.worse or noise.noisiest),
                                      ('normal', noise.tail)) if is_it]
    return ' and '.join(f'not {one}' for one in lacks)


def kind_words(kind: str) -> str:
    """Return a kind of noise, as of NoiseKinds."""
    return {'z': 'unequal scatter in z', 'axis': 'unequal scatter of the axes', 'wander': 'random drift of the frame',
            'reading': 'heavy tails of readings', 'coordinate': 'heavy tails of coordinates'}.get(
        kind, f'scatter differs by {kind}')


def noise_words(noise: NoiseFacts) -> list[str]:
    """Return in what the noise of a run is other than white and equal, rounding too."""
    return [*_rounding_words(noise), *_other_noise(noise)]


def _rounding_words(noise: NoiseFacts) -> list[str]:
    return [f'the readings are rounded to {micrometres(noise.step)}, which accounts for {100 * noise.rounded:.0f} % of '
            'the variance of the residual'] * (noise.step > 0)


def _other_noise(noise: NoiseFacts) -> list[str]:
    out = []
    if noise.worse:
        each = ', '.join(significant(1e6 * one, 2) for one in noise.scatter)
        out.append(f'standard deviations in x, y, z: {each} µm')
    if noise.tail:
        out.append(f'single {noise.tail}s are farther off than a normal distribution allows (Student, '
                   f'{noise.tail_dof:g} degrees of freedom)')
    if noise.noisiest:
        where, *alike = map(_group, noise.noisiest)
        same = f' (this run cannot distinguish it from {" or ".join(alike)})' if alike else ''
        out.append(f'{where} scatters {noise.factor:.1f} times as much as the others{same}')
    if noise.walk:
        out.append(f'the frame wanders by {micrometres(noise.walk)} over the run (random walk)')
    elif noise.wander:
        out.append(f'the frame wanders by {micrometres(noise.wander)} within about {noise.readings:.0f} readings')
    elif noise.correlation:
        out.append(f'autocorrelation (lag 1) {noise.correlation:+.1f}'.replace('-', '−'))
    return out


def noise_actions(noise: NoiseFacts) -> list[str]:
    """Return what to do about each of these."""
    out = []
    if noise.worse:
        axes = names(_axes(one) for one, _ in noise.worse)
        out.append(f'check the probe and the slide of {axes} (the readings are weighted accordingly)'
                   if max(ratio for _, ratio in noise.worse) < OTHER_UNIT else 'check that x, y and z have one unit')
    if noise.tail:
        out.append('clean balls and stylus (readings that stand out have less weight)')
    if noise.noisiest:
        out.append(f'check {_group(noise.noisiest[0])}')
    if noise.walk or noise.wander or noise.correlation:
        out.append('check probe and stylus, look for draughts, vibration and changes of temperature of the frame, or '
                   'measure faster')
    return out


def _group(one: Group) -> str:
    return f'part {one.number} of {one.groups} of the run' if one.by == 'time' else f'{one.by} {one.number}'


def _axes(letters: str) -> str:
    return names(letters)

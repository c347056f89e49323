# SPDX-License-Identifier: Apache-2.0
"""A verdict, and the noise of a run, in words: every interface prints these as they stand."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, isnan

from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.noise_facts import NoiseFacts
from rosette_ros.core.diagnosis.verdict import Outcome, Residual, Verdict, VerdictText
from rosette_ros.core.diagnosis.wrong_readings import WRONG, WrongReading
from rosette_ros.core.model.noise import Group
from rosette_ros.core.run.number_words import SCALES, micrometres, multiple, p_equation, p_words, significant
from rosette_ros.core.run.records import SI_UNITS
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.core.sight.limits import SURE
from rosette_ros.core.uncertainty.stated_environment import LABORATORY, Unseen
from rosette_ros.words.effect_words import (
    capital,
    decimals,
    fixed,
    names,
    scale_of,
    title_of,
)
from rosette_ros.words.motion_words import (
    Said,
    causes_words,
    chance,
    few,
    titles,
    unnamed_words,
    variable_words,
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
MOST_WRONG = 4
"""Wrong readings that are said."""
OTHER_UNIT = 100.0
"""Ratio of the repeatability of axes from which on a wrong unit is the likelier cause."""
MOST_OF_U = 0.5
"""Share of a variance from which on it is most of it."""


def verdict_text(verdict: Verdict) -> VerdictText:
    """Return a verdict in words."""
    if verdict.outcome == Outcome.NOT_DETERMINABLE:
        remove = f', or remove {titles(verdict.added)} from the model' if verdict.added else ''
        return VerdictText(verdict.outcome, verdict.reason, f'Measure the missing balls{remove}.')
    actions = '; '.join(_actions(verdict))
    return VerdictText(verdict.outcome, ' '.join(_sentences(verdict)), f'{capital(actions)}.' if actions else
                       NOTHING_TO_DO, tuple(_limits(verdict)), verdict.unseen)


def unexplained_words(verdict: Verdict) -> str:
    """Return what no named effect explains, empty where nothing is left."""
    if verdict.unnamed:
        return unnamed_words(*verdict.unnamed)
    return _against_repeatability(verdict.after) if verdict.unexplained and verdict.after else ''


def _sentences(verdict: Verdict) -> list[str]:
    noise = verdict.noise
    first = [] if verdict.missing or verdict.unnamed else _found_in_noise(noise)
    if first:  # it is said
        noise = replace(noise, walk=0.0, wander=0.0, noisiest=())
    out = [*first, *_outcome(verdict), *_wrong(verdict)]
    if verdict.too_large:
        out.append(f'The stated repeatability is {multiple(verdict.too_large)} times what the readings show, so '
                   'uncertainties based on it are too large.')
    if others := _other_noise(noise):
        out.append(f'The noise is {noise_kind(noise)}: {"; ".join(others)}.')
    out += [f'{capital(one)}.' for one in _rounding_words(noise)]
    beside = [one for one in verdict.doubtful if one[1] >= SURE and (verdict.missing or verdict.unnamed)]
    out += [f'{lead}: {names(f"{title_of(name)} ({chance(p)})" for name, p in some)}.' for lead, some in (
        ('Not added, as it may be part of the motion above', beside),
        ('Possible', [one for one in verdict.doubtful if one not in beside])) if some]
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
    said = Said()
    basis = [] if before.repeatability is not None else [
        'The repeatability is not known, so this rests on the structure of the residual alone.']
    match verdict.outcome:
        case Outcome.UNIT:
            return [f'{capital(remark_words(remark))}.' for remark in verdict.remarks
                    if remark.kind is RemarkKind.UNIT_OF_COORDINATES]
        case Outcome.NAMED | Outcome.SUSPECTED | Outcome.UNNAMED:
            named, unnamed = (max((one.probability for one in some), default=0.0)
                              for some in (verdict.missing, verdict.unnamed))
            say = [(verdict.missing, lambda some: causes_words(some, said)),
                   (verdict.unnamed, lambda some: unnamed_words(*some, said=said))][::1 if named >= unnamed else -1]
            return [*(f'{capital(words(some))}.' for some, words in say if some), _residual_sentence(verdict), *basis]
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
    if _found_in_noise(verdict.noise):
        return f'{capital(_against_repeatability(residual))}.'
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
    return (f'the residual of {micrometres(residual.rms)} is '
            f'{_times(residual, known, f"the stated repeatability of {micrometres(known)}")} ({p_words(p)})')


def _in_repeatabilities(residual: Residual) -> str:
    """Return how many times the repeatability a residual is, after a sentence that says how large it is."""
    known, p = residual.repeatability, residual.p
    return '' if known is None or p is None else f'{_times(residual, known, "the repeatability")} ({p_equation(p)})'


def _times(residual: Residual, known: float, repeatability: str) -> str:
    """Return how many times what is known of the repeatability a residual is; repeatability: this in words."""
    together = hypot(known, residual.rounding)
    ratio = residual.rms / together
    rounded = f' with rounding, together {micrometres(together)}' * bool(residual.rounding)
    part = (f', {multiple(residual.quietest * ratio)} times in its quietest part'
            if residual.quietest < 0.5 else '')
    return f'{multiple(ratio)} times {repeatability}{rounded}{part}'


def _residual_sentence(verdict: Verdict) -> str:
    """Return the residual with all that is said to be missing."""
    before, after, missing, unnamed = verdict.before, verdict.after, verdict.missing, verdict.unnamed
    if not (before and after):
        return ''
    it = ('them' if len(missing) + len(unnamed) > 1 else
          'the likeliest of them' if missing and not missing[0].depth and missing[0].alternatives else 'it')
    known = (f', still {_in_repeatabilities(after)}' if after.scatters and not unnamed else
             '' if before.repeatability is None else f' (repeatability {micrometres(before.repeatability)})')
    rms = min([after.rms, *(one.after for one in unnamed)])
    comes = f'falls from {significant(1e6 * before.rms)} to' if rms < before.rms else 'is'
    return f'With {it} the residual standard deviation {comes} {micrometres(rms)}{known}.'


def _actions(verdict: Verdict) -> list[str]:
    """Return what to do, most urgent first."""
    out = [f'check the readings: {remark_words(remark)}' for remark in verdict.remarks
           if remark.kind is not RemarkKind.UNIT_OF_COORDINATES]
    if verdict.outcome == Outcome.UNIT:
        return [*out, 'correct the unit, and evaluate again']
    if verdict.missing:
        it, cause = ('it', 'the cause') if len(verdict.missing) == 1 else ('them', 'the causes')
        out.append(f'eliminate {cause} and repeat the measurement, or include {it} in the evaluation model')
    if verdict.unnamed:
        out.append(_check(verdict.unnamed))
    if verdict.is_open:
        out.append('consider further readings (advise --readings)')
    if verdict.outcome == Outcome.SCATTERS and not _wander_words(verdict.noise):
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
        said = {*one.cause.laws[0][0]} if one.cause else set()
        others = [f'{title_of(name)} ({chance(p)})' for name, p in one.alternatives if name not in said]
        if others and one.depth:  # else they are named in the first sentence
            out.append(f'This run cannot distinguish {title_of(one.name)} from {" or ".join(others)}.')
    out = [*dict.fromkeys(out)]
    if verdict.hidden:
        out.append(f'This run could not have shown {titles(verdict.hidden)}.')
    return out


def _check(unnamed: Sequence[MissingEffect]) -> str:
    """Return what to check for motions without a name: what changes with the variables that may drive them."""
    every = [some for one in unnamed if one.cause for some in (*one.cause.variables, *one.cause.or_with)]
    drive = dict.fromkeys([*(first for first, *_ in every), *(name for some in every for name in some)])
    what = (f'changes with {names(few([*map(variable_words, drive)], "one of "), "or")}' if drive else
            'is off by a constant amount')
    return f'check the cell for what {what}'


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
    if scatters := _noisiest_words(noise):
        out.append(scatters)
    if wander := _wander_words(noise):
        out.append(f'the frame wanders by {wander}')
    elif noise.correlation:
        out.append(f'autocorrelation (lag 1) {noise.correlation:+.1f}'.replace('-', '−'))
    return out


def _found_in_noise(noise: NoiseFacts) -> list[str]:
    """Return in sentences what in the noise has a place in the cell: a probe that wanders, a ball that scatters."""
    wander, scatters = _wander_words(noise), _noisiest_words(noise)
    return [*[f'The probe wanders with time, by {wander}.'] * bool(wander), *[f'{capital(scatters)}.'] * bool(scatters)]


def _noisiest_words(noise: NoiseFacts) -> str:
    """Return which part of the readings scatters, and by how much, empty where none does."""
    if not noise.noisiest:
        return ''
    where, *alike = map(_group, noise.noisiest)
    same = f' (this run cannot distinguish it from {" or ".join(alike)})' if alike else ''
    return f'{where} scatters {noise.factor:.1f} times as much as the others{same}'


def _wander_words(noise: NoiseFacts) -> str:
    """Return by how much the frame wanders, empty where it does not."""
    if noise.walk:
        return f'{micrometres(noise.walk)} over the run (random walk)'
    return f'{micrometres(noise.wander)} within about {noise.readings:.0f} readings' if noise.wander else ''


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
        out.append(f'check why {_group(noise.noisiest[0])} scatters more')
    if noise.walk or noise.wander or noise.correlation:
        out.append('check probe and stylus, look for draughts, vibration and changes of temperature of the frame, or '
                   'measure faster')
    return out


def _group(one: Group) -> str:
    return f'part {one.number} of {one.groups} of the run' if one.by == 'time' else f'{one.by} {one.number}'


def _axes(letters: str) -> str:
    return names(letters)

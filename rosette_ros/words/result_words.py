# SPDX-License-Identifier: Apache-2.0
"""Comparisons, second runs and joint evaluations in words."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.noise_facts import noise_facts
from rosette_ros.core.diagnosis.second_run import CheckedEffect, CheckOutcome, CrossCheck
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.joint.conclusion import Conclusion, JointOutcome
from rosette_ros.core.joint.sharing import ITEMS
from rosette_ros.core.model.noise import AXES
from rosette_ros.core.run.number_words import micrometres, multiple, p_words
from rosette_ros.core.run.records import UNLIKELY
from rosette_ros.words.effect_words import capital, names, title_of
from rosette_ros.words.verdict_words import noise_kind, noise_words, unseen_sentences

DOES_NOT_FIT = 'The model does not fit: the residual is more than noise.'
"""Of a model that lacks something, without what it lacks, which a diagnosis names."""


@dataclass(frozen=True)
class ConclusionText:
    """What several runs say together, in words: level, one sentence, and what to do."""

    level: Level
    sentence: str
    action: str


def conclusion_text(conclusion: Conclusion) -> ConclusionText:
    """Return the conclusion of a joint evaluation in words."""
    who, s, do = (f'The {conclusion.runs} runs', '', 'do') if conclusion.runs > 1 else ('The run', 's', 'does')
    residual, items = f'residual {micrometres(conclusion.rms)} per coordinate', ', '.join(
        ITEMS[item] for item in conclusion.items)
    lack = '' if conclusion.p is None else f' ({p_words(conclusion.p)} given the repeatability)'
    sentence, action = {
        JointOutcome.CONTRADICTED: (f'{who} contradict{s} what was declared the same: {items}; {residual}.',
                                    'Declare it separate, or measure again.'),
        JointOutcome.REFUTED: (f'{who} {do} not fit one model: {residual}{lack}.',
                               'Diagnose each run.'),
        JointOutcome.IN_PART: (f'{who} fit{s} one model without: {items}; {residual}.',
                               'Find out why these differ between the runs.'),
        JointOutcome.UNKNOWN: (f'Whether one model fits cannot be said, as the repeatability is not known; {residual}.',
                               'Measure the repeatability before the run.'),
        JointOutcome.FITS: (' '.join([f'{who} fit{s} one model: {residual}.', *unseen_sentences(conclusion.unseen)]),
                            'State the environment of the cell (--environment).' if conclusion.lacks_environment
                            else 'Nothing needs to be done.')}[conclusion.outcome]
    return ConclusionText(conclusion.level, sentence, action)


def comparison_words(comparison: Comparison) -> str:
    """Return how large the residual is and where it is largest; this judges nothing."""
    chi = comparison.fit.reduced_chi_square
    times = '' if chi is None else f', {multiple(float(np.sqrt(chi)))} times the repeatability'
    places = sorted((one for one in comparison.distinct if one.p < UNLIKELY), key=lambda one: one.p)
    where = names([f'along {AXES[int(np.argmax(comparison.axis_rms))]}', *(
        f'at {one.label} {one.keys[one.worst]}' if one.keys[one.worst].isdigit() else one.keys[one.worst]
        for one in places[:3])])
    alike = (f'; autocorrelation (lag 1) {comparison.neighbour_correlation:+.2f}, significant'.replace('-', '−')
             if comparison.neighbour_p < UNLIKELY else '')
    return f'The residual is {micrometres(comparison.fit.rms)}{times}. It is largest {where}{alike}.'


def check_words(check: CrossCheck) -> str:
    """Return what the second run confirms, and how its residual changes."""
    parts = list(map(_checked, check.effects))
    if any(one.outcome is CheckOutcome.CONFIRMED for one in check.effects):
        parts.append(f'The residual standard deviation of this run falls from {micrometres(check.before.rms)} to '
                     f'{micrometres(check.after.rms)}.')
    if check.carried is not None:
        parts.append('With the amplitudes of the first run and nothing fitted, the residual is '
                     f'{micrometres(check.carried.rms)}.')
    if (noise := noise_facts(check.after)).is_other:
        parts.append(f'The noise of this run is {noise_kind(noise)}, which is taken into account: '
                     f'{"; ".join(noise_words(noise))}.')
    return ' '.join(parts) or 'No effect was found in the first run, so there is nothing to check.'


def _checked(one: CheckedEffect) -> str:
    title = capital(title_of(one.name))
    if one.outcome is CheckOutcome.CONFIRMED:
        size = {True: ', with the same size', False: ', with another size', None: ''}[one.same_size]
        return f'{title} is confirmed{size}.'
    said = 'is not seen' if one.outcome is CheckOutcome.NOT_SEEN else 'cannot be checked'
    return f'{title} {said}: {reason_words(one)}.'


def reason_words(one: CheckedEffect) -> str:
    """Return why the second run says so of an effect."""
    match one.outcome:
        case CheckOutcome.CONFIRMED:
            return 'it is there'
        case CheckOutcome.NOT_SEEN if one.cross_validation_with < one.cross_validation_without:
            return f'the residual falls with it by no more than chance (p = {one.p:.2g})'
        case CheckOutcome.NOT_SEEN:
            return 'the cross-validation residual does not fall with it'
        case CheckOutcome.TOO_WEAK:
            return f'at the size learnt it is {one.strength:.1f} sigma above the noise here, too little to be decided'
        case CheckOutcome.HIDDEN:
            return 'it is not observable in this order of measurement'
        case CheckOutcome.EVENT:
            return 'an event of the first run, which need not happen again'
        case CheckOutcome.NOT_JUDGED:
            return one.unavailable

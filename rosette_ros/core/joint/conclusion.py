# SPDX-License-Identifier: Apache-2.0
"""What a joint evaluation says in one sentence: whether the runs fit one model, and what they do not share."""

from rosette_ros.core.diagnosis.verdict import UNLIKELY, Conclusion, Level
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.sharing import ITEMS
from rosette_ros.core.number_words import micrometres, p_words


def fits(result: JointResult) -> bool | None:
    """Return whether the runs fit one model, as of one run: p of lack of fit at least UNLIKELY; None: not known."""
    return None if result.lack_of_fit_p is None else result.lack_of_fit_p >= UNLIKELY


def conclude(result: JointResult) -> Conclusion:
    """Return the Conclusion of a joint evaluation."""
    count, residual = len(result.solution.model.runs), f'residual {micrometres(result.rms)} per coordinate'
    who, s, does = (f'The {count} runs', '', 'do') if count > 1 else ('The run', 's', 'does')
    untrue = [ITEMS[test.item] for test in result.tests if test.is_contradicted and test.is_used]
    unused = [ITEMS[test.item] for test in result.tests if test.item != 'sense' and not test.is_used]
    if untrue:
        return Conclusion(Level.BAD, f'{who} contradict{s} what was declared the same: {", ".join(untrue)}; '
                          f'{residual}.',
                          'Declare it separate, or measure again.')
    if result.lack_of_fit_p is not None and fits(result) is False:
        return Conclusion(Level.BAD, f'{who} {does} not fit one model: {residual}, {p_words(result.lack_of_fit_p)} '
                          'beside the repeatability.', 'Diagnose each run: rosette diagnose RUN.')
    if unused:
        return Conclusion(Level.DOUBTFUL, f'{who} fit{s} one model without: {", ".join(unused)}; {residual}.',
                          'Find out why it differs between the runs.')
    if fits(result) is None:
        return Conclusion(Level.DOUBTFUL, f'Whether one model fits cannot be said, there is no repeatability; '
                          f'{residual}.', 'Measure the repeatability before the run.')
    return Conclusion(Level.GOOD, f'{who} fit{s} one model: {residual}.', 'Nothing needs to be done.')

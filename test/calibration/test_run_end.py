# SPDX-License-Identifier: Apache-2.0
"""The end of a run: success is said of what the log holds."""

import pytest
from sequences import RESULTS, make_sequence, run_through, verification

from rosette_ros.calibration.state_machine import Finish, PublishState
from rosette_ros.io.messages import Phase


def logged(missing=()):
    """Return (sequence, commands) of a run whose log holds all answers, after its results were published."""
    sequence = make_sequence()
    sequence.verifies = True
    commands = run_through(sequence)
    assert commands[-1] == verification(sequence)
    assert sequence.verified(set(sequence.answers.good_stamps()), (), 0.0) == (PublishState(),)
    assert sequence.phase is Phase.EVALUATION
    assert sequence.evaluated(RESULTS, 0.0) == (verification(sequence, RESULTS),)
    assert sequence.phase is Phase.EVALUATION
    return sequence, sequence.verified(set(), missing, 0.0)


def test_success_is_said_when_the_log_holds_results_and_last_state():
    """First the results, then the state DONE; only then the calibration has ended."""
    sequence, commands = logged()
    assert commands == (PublishState(), verification(sequence, RESULTS, Phase.DONE))
    assert sequence.phase is Phase.DONE
    assert sequence.verified(set(), (), 0.0) == (Finish(Phase.DONE, 'error motions are published'),)


def test_a_log_without_its_results_is_no_success():
    """It says what is missing; nothing is asked again."""
    sequence, commands = logged(('error motions', 'a diagnosis'))
    assert commands[-1].phase is Phase.FAILED
    assert 'the log lacks error motions, a diagnosis; all ball centres are in it' in commands[-1].text
    assert sequence.verified(set(), (), 0.0) == ()


@pytest.mark.parametrize('at_once', [True, False])
def test_a_log_without_its_last_state_is_no_success(at_once):
    """Whether the recorder reports that it is missing, or does not answer."""
    sequence, _ = logged()
    step = sequence.verified(set(), ('state done',), 0.0) if at_once else sequence.not_verified('it is silent', 0.0)
    assert step[-1].phase is Phase.FAILED
    assert step[-1].text.startswith('the log lacks state done' if at_once else 'the log cannot be verified: it is')


def test_a_cancelled_run_is_not_verified_any_more():
    """An answer of the recorder that comes late has no consequence."""
    sequence = make_sequence()
    sequence.begin(0.0)
    sequence.cancel()
    assert sequence.verified(set(), ('error motions',), 0.0) == ()

# SPDX-License-Identifier: Apache-2.0
"""The end of a run: success is said of what the log holds."""

from sequences import LIMITS, make_sequence, results_of, run_through

from rosette_ros.calibration.state_machine import Finish, PublishRun, PublishState, Verify
from rosette_ros.io.messages import Phase


def logged(missing=()):
    """Return (sequence, commands) of a run that has a log, after its results were published."""
    sequence = make_sequence()
    sequence.verifies = True
    assert run_through(sequence)[-2:] == [PublishRun(), PublishState()]
    results = results_of(sequence)
    assert sequence.evaluated(results) == (Verify(results),)
    assert sequence.evaluated(results) == ()
    assert sequence.phase is Phase.EVALUATION
    return sequence, sequence.verified(missing)


def test_success_is_said_when_the_log_holds_results_and_readings():
    """Only then the calibration has ended."""
    sequence, commands = logged()
    assert commands == (PublishState(), Finish(Phase.DONE, 'error motions are published'))
    assert sequence.verified(('the model',)) == ()


def test_results_of_other_readings_are_passed_over():
    """An evaluator publishes those of an earlier attempt again: the run ended with "the log lacks the readings"."""
    sequence = make_sequence()
    sequence.verifies = True
    run_through(sequence)
    right = results_of(sequence)
    assert sequence.evaluated(right._replace(readings_hash='of an earlier attempt')) == ()
    assert sequence.evaluated(right) == (Verify(right),)
    assert sequence.verified(())[-1].phase is Phase.DONE


def test_a_log_without_its_results_is_no_success():
    """It says what is missing; nothing is asked again."""
    sequence, commands = logged(('the error motions', 'the readings'))
    assert commands[-1] == Finish(Phase.FAILED, 'the log lacks the error motions, the readings; evaluate it offline, '
                                  'or resume the run')
    assert sequence.verified(()) == ()


def test_a_recorder_that_is_restarted_in_the_evaluation_is_waited_for():
    """Then the run is published and evaluated again; a recorder that does not say what it has ends it in words."""
    sequence = make_sequence()
    sequence.verifies = True
    run_through(sequence)
    for _ in range(LIMITS.attempts):
        sequence.evaluated(results_of(sequence))
        assert sequence.not_verified('it was restarted', 1.0)[1:] == (PublishState(),)
        assert sequence.evaluated(results_of(sequence)) == sequence.verified(()) == ()
        assert sequence.resume_asking(2.0, restarted=True)[1:] == (PublishRun(), PublishState())
    sequence.evaluated(results_of(sequence))
    end = Finish(Phase.FAILED, 'the log cannot be verified: it was restarted')
    assert sequence.not_verified('it was restarted', 3.0)[-1] == end


def test_a_cancelled_run_is_not_verified_any_more():
    """An answer of the recorder that comes late has no consequence."""
    sequence = make_sequence()
    sequence.begin(0.0)
    sequence.cancel()
    assert sequence.verified(('the error motions',)) == ()

# SPDX-License-Identifier: Apache-2.0
"""What the sequencer waits for before it believes what a log holds."""

from types import SimpleNamespace

import pytest
from rosette_msgs.srv import Recorded

from rosette_ros.nodes.node_requests import RecorderLink, Requests

PATIENCE = 4.0


class Recorder:
    """A recorder that answers at once, and the time between its answers."""

    def __init__(self, logs):
        """Take what its log holds at each request, (seq, stamp) of answers and what is missing; the last one stays."""
        self.logs, self.now, self.asked = list(logs), 0.0, 0

    def ask(self, request):
        """Answer a request, as the client of a service does."""
        answers, missing = self.logs[min(self.asked, len(self.logs) - 1)]
        self.asked += 1
        response = Recorded.Response(success=True, missing=missing, seq=[seq for seq, _ in answers],
                                     stamp_ns=[stamp for _, stamp in answers])
        return SimpleNamespace(add_done_callback=lambda call: call(SimpleNamespace(result=lambda: response)))


@pytest.fixture
def verified():
    """Return a function that verifies answers against a recorder; it returns the response and the time it took, s."""

    def verify(recorder, answers):
        link, found = RecorderLink.__new__(RecorderLink), []
        Requests.__init__(link, SimpleNamespace(seconds=lambda: recorder.now), 'recorder')
        link._recorded = SimpleNamespace(call_async=recorder.ask, service_is_ready=lambda: True, srv_type=Recorded)
        link.recorded(Recorded.Request(), answers, PATIENCE, 10.0, found.append)
        while not found:
            recorder.now += 0.1
            link.tick(recorder.now)
        return found[0], recorder.now

    return verify


def test_what_the_log_holds_is_believed_at_once(verified):
    """Nothing is missing: one request."""
    recorder = Recorder([([(1, 10), (2, 20)], [])])
    assert verified(recorder, {(1, 10), (2, 20)})[1] == 0.0
    assert recorder.asked == 1


@pytest.mark.parametrize('early', [
    [(1, 10)], [(1, 10), (1, 11)], [(1, 10), (2, 19)]], ids=['late', 'another came twice', 'an earlier one is there'])
def test_an_answer_that_comes_late_is_waited_for(verified, early):
    """Also where others make up the number: a ball that was answered twice let the run ask three times in 40 ms for
    one that the recorder had not taken yet, and fail."""
    recorder = Recorder([(early, [])] * 5 + [([*early, (2, 20)], [])])
    response, took = verified(recorder, {(1, 10), (2, 20)})
    assert (2, 20) in zip(response.seq, response.stamp_ns, strict=True)
    assert recorder.asked == 6
    assert took < PATIENCE


def test_what_does_not_come_is_waited_for_as_long_as_it_may_change(verified):
    """Then the answer says what is there."""
    recorder = Recorder([([(1, 10), (1, 11)], [])])
    response, took = verified(recorder, {(1, 10), (2, 20)})
    assert list(response.seq) == [1, 1]
    assert took == pytest.approx(PATIENCE, abs=0.3)


def test_results_are_waited_for_as_answers_are(verified):
    """What is missing by name."""
    recorder = Recorder([([(1, 10)], ['the diagnosis']), ([(1, 10)], [])])
    response, took = verified(recorder, {(1, 10)})
    assert not response.missing
    assert 0.0 < took < 1.0

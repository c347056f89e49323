# SPDX-License-Identifier: Apache-2.0
"""Requests of nodes to recorder and evaluator."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.task import Future
from rosette_msgs.msg import CalibrationEvent
from rosette_msgs.srv import Recall, Recorded, StartRecording, StopRecording

from rosette_ros.io.messages import Phase
from rosette_ros.nodes import names
from rosette_ros.nodes.base_node import WAKE_PERIOD, CellNode
from rosette_ros.nodes.interfaces import introspected_client

END_EVENTS: dict[int, int] = {Phase.DONE: CalibrationEvent.SUCCEEDED, Phase.CANCELLED: CalibrationEvent.CANCELLED,
                              Phase.FAILED: CalibrationEvent.FAILED}
RECALL_TIMEOUT = 60.0  # how long the recorder may read in its logs, s


@dataclass(eq=False)
class _Call:
    """A request that waits for its response."""

    client: Client
    request: Any
    timeout: float  # of each response, s
    done: Callable[[Any], None]
    repeat: Callable[[Any], Any]  # returns the next request on a response that is not final, else None
    future: Future | None = None  # None until it is sent (again)
    deadline: float = 0.0  # steady time, s


class Requests:
    """Requests to one other node; every one is answered, by it or, after the timeout, in its place."""

    def __init__(self, node: CellNode, other: str) -> None:
        """Take the name of the other node, for messages."""
        self._node, self._other = node, other
        self._calls: list[_Call] = []

    def tick(self, now: float) -> None:
        """Repeat requests and answer those that are overdue; call it from a timer. now: steady time, s."""
        for call in list(self._calls):
            if now > call.deadline:
                self._answer(call, f'the {self._other} did not answer within {call.timeout:g} s')
            elif not call.client.service_is_ready():
                self._answer(call, f'the {self._other} disconnected before it answered')
            elif call.future is None:
                self._send(call)

    def give_up(self, words: str) -> None:
        """Answer all requests in place of the other node, which will not."""
        for call in list(self._calls):
            self._answer(call, words)

    def _answer(self, call: _Call, words: str) -> None:
        self._calls.remove(call)
        if call.future is not None:
            call.client.remove_pending_request(call.future)
        call.done(call.client.srv_type.Response(success=False, message=words))

    def call(self, client: Client, request: Any, timeout: float, done: Callable[[Any], None],
             repeat: Callable[[Any], Any] = lambda response: None) -> None:
        """Send a request of a client; done(response) is called once; timeout, s, repeat: as of _Call."""
        call = _Call(client, request, timeout, done, repeat)
        self._calls.append(call)
        self._send(call)

    def _send(self, call: _Call) -> None:
        call.deadline = self._node.seconds() + call.timeout
        call.future = call.client.call_async(call.request)
        call.future.add_done_callback(lambda future: self._on_response(call, future))

    def _on_response(self, call: _Call, future: Future) -> None:
        if call not in self._calls:
            return
        request = call.repeat(future.result())
        if request is not None:
            call.request, call.future = request, None
            return
        self._calls.remove(call)
        call.done(future.result())


class Recalls(Requests):
    """Reads the logs of the recorder."""

    def __init__(self, node: CellNode) -> None:
        super().__init__(node, names.RECORDER)
        # Not introspected: the response is in a log already. In a group of its own: a coroutine that waits for it
        # holds the group of the node.
        self._recall = node.create_client(Recall, names.RECALL, callback_group=MutuallyExclusiveCallbackGroup())

    @property
    def is_there(self) -> bool:
        """Whether the service is offered."""
        return self._recall.service_is_ready()

    def recall(self, run: str, done: Callable[[Recall.Response], None]) -> None:
        """Request what is recorded of a run; done(response) is called once."""
        self.call(self._recall, Recall.Request(run=run), RECALL_TIMEOUT, done)


class Progress:
    """Whether a quantity that is looked at every WAKE_PERIOD may still change.

    For `patience` s after it did, and for as many looks as fit into them: a process that stood still meanwhile, waiting
    for its disk or for a processor, has not yet taken what came."""

    def __init__(self, seconds: Callable[[], float], patience: float) -> None:
        """Start; seconds: returns the steady time, s."""
        self._seconds, self._patience = seconds, patience
        self._value: int | None = None
        self._since, self._times = 0.0, 0

    def is_expected(self, value: int) -> bool:
        """Look at it once more; return whether it may still change."""
        if value != self._value:
            self._value, self._since, self._times = value, self._seconds(), 0
        self._times += 1
        return self._times * WAKE_PERIOD < self._patience or self._seconds() - self._since < self._patience


def recorded_answers(response: Recorded.Response) -> set[tuple[int, int]]:
    """Return (seq, stamp in ns) of all usable answers that are in a log."""
    return set(zip(response.seq, response.stamp_ns, strict=True))


class RecorderLink(Recalls):
    """The sequencer's side of the protocol with the recorder."""

    def __init__(self, node: CellNode) -> None:
        super().__init__(node)
        self._start = introspected_client(node, StartRecording, names.START_RECORDING)
        self._stop = introspected_client(node, StopRecording, names.STOP_RECORDING)
        self._recorded = node.create_client(Recorded, names.RECORDED)

    @property
    def is_there(self) -> bool:
        """Whether all services are offered."""
        return super().is_there and self._start.service_is_ready() and self._stop.service_is_ready()

    def start(self, run_id: str, resumes: str, timeout: float, done: Callable[[StartRecording.Response], None]) -> None:
        """Request a log; resumes: of the log that the run goes on from, '' for none."""
        self.call(self._start, StartRecording.Request(run_id=run_id, resumes=resumes), timeout, done)

    def stop(self, request: StopRecording.Request, timeout: float,
             done: Callable[[StopRecording.Response], None]) -> None:
        """Request to close the log of a run that has ended, until the recorder has closed it or says why not."""
        self.call(self._stop, request, timeout, done,
                   lambda response: request if response.missing and not response.log else None)

    def recorded(self, request: Recorded.Request, answers: Collection[tuple[int, int]], patience: float, timeout: float,
                 done: Callable[[Recorded.Response], None]) -> None:
        """Request what of a run is in its log; answers, (seq, stamp in ns), and what is named, are waited for as in
        Progress."""
        progress = Progress(self._node.seconds, patience)

        def repeat(response: Recorded.Response) -> Recorded.Request | None:
            lacking = len(set(answers) - recorded_answers(response)) + len(response.missing)
            return request if response.success and lacking and progress.is_expected(lacking) else None

        self.call(self._recorded, request, timeout, done, repeat)

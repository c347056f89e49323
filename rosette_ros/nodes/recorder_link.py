# SPDX-License-Identifier: Apache-2.0
"""What other nodes ask of the recorder."""

from dataclasses import dataclass

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rosette_msgs.srv import Recall, Recorded, StartRecording, StopRecording

from rosette_ros.nodes import names
from rosette_ros.nodes.introspection import introspected_client


@dataclass(eq=False)
class _Call:
    """A call that waits for its answer until `deadline`, steady time, s."""

    client: object
    request: object
    timeout: float
    deadline: float
    done: object
    future: object = None


class Recalls:
    """Asks the recorder what a log holds; every call is answered, by the recorder or the clock."""

    def __init__(self, node):
        """Create the client on a CellNode."""
        self._node = node
        # Not recorded: the answer is what stands in a log already. In a group of its own: whoever waits for
        # it may hold the group of the node.
        self._recall = node.create_client(Recall, names.RECALL, callback_group=MutuallyExclusiveCallbackGroup())
        self._calls = []

    @property
    def is_there(self):
        """Whether the service is offered."""
        return self._recall.service_is_ready()

    def recall(self, run, timeout, done):
        """Ask for what is recorded of a run; done(Recall.Response) is called once."""
        self._call(self._recall, Recall.Request(run=run), timeout, done)

    def tick(self, now):
        """Answer in the recorder's place where it is late; now: steady time, s."""
        for call in list(self._calls):
            if now > call.deadline:
                self._answer(call, f'the recorder did not answer within {call.timeout:g} s')
            elif not call.client.service_is_ready():
                self._answer(call, 'the recorder has gone before it answered')

    def give_up(self, words):
        """Answer all calls in the recorder's place: it will not."""
        for call in list(self._calls):
            self._answer(call, words)

    def _answer(self, call, words):
        self._calls.remove(call)
        call.client.remove_pending_request(call.future)
        call.done(call.client.srv_type.Response(success=False, message=words))

    def _call(self, client, request, timeout, done):
        call = _Call(client, request, timeout, self._node.seconds() + timeout, done)
        self._calls.append(call)
        call.future = client.call_async(request)
        call.future.add_done_callback(lambda future: self._answered(call, future))

    def _answered(self, call, future):
        if call in self._calls:
            self._calls.remove(call)
            call.done(future.result())


class RecorderLink(Recalls):
    """The sequencer's side of the handshake with the recorder."""

    def __init__(self, node):
        """Create the clients on a CellNode."""
        super().__init__(node)
        self._start = introspected_client(node, StartRecording, names.START_RECORDING)
        self._stop = introspected_client(node, StopRecording, names.STOP_RECORDING)
        self._recorded = node.create_client(Recorded, names.RECORDED)

    @property
    def is_there(self):
        """Whether all services are offered."""
        return super().is_there and self._start.service_is_ready() and self._stop.service_is_ready()

    def start(self, run_id, resumes, timeout, done):
        """Ask for a log, resumes: of the log that it goes on from, '' for none; done(response) is called once."""
        self._call(self._start, StartRecording.Request(run_id=run_id, resumes=resumes), timeout, done)

    def stop(self, run_id, timeout, done):
        """Ask to close the log; done(response) is called once."""
        self._call(self._stop, StopRecording.Request(run_id=run_id), timeout, done)

    def recorded(self, run_id, wanted, timeout, done):
        """Ask which answers of a run are in its log; done(response) is called once."""
        self._call(self._recorded, Recorded.Request(run_id=run_id, wanted=wanted), timeout, done)

# SPDX-License-Identifier: Apache-2.0
"""The sequencer's side of the handshake with the recorder."""

from rosette_msgs.srv import StartRecording, StopRecording

from rosette_ros.nodes import names
from rosette_ros.nodes.introspection import introspected_client


class RecorderLink:
    """Opens and closes the log of a run; every call is answered, by the recorder or the clock."""

    def __init__(self, node):
        """Create the clients on a CellNode."""
        self._node = node
        self._start = introspected_client(node, StartRecording, names.START_RECORDING)
        self._stop = introspected_client(node, StopRecording, names.STOP_RECORDING)
        self._pending = None

    @property
    def is_there(self):
        """Whether both services are offered."""
        return self._start.service_is_ready() and self._stop.service_is_ready()

    def start(self, run_id, timeout, done):
        """Ask for a log; done(success, message, log) is called once."""
        self._call(self._start, StartRecording.Request(run_id=run_id), timeout, done)

    def stop(self, run_id, timeout, done):
        """Ask to close the log; done(success, message, log) is called once."""
        self._call(self._stop, StopRecording.Request(run_id=run_id), timeout, done)

    def tick(self, now):
        """Answer in the recorder's place where it is late; now: steady time, s."""
        if self._pending is None:
            return
        client, deadline, timeout, done, future = self._pending
        if client.service_is_ready() and now <= deadline:
            return
        words = (f'the recorder did not answer within {timeout:g} s' if now > deadline else
                 'the recorder has gone before it answered')
        self._pending = None
        client.remove_pending_request(future)
        done(False, words, '')

    def _call(self, client, request, timeout, done):
        future = client.call_async(request)
        self._pending = (client, self._node.seconds() + timeout, timeout, done, future)
        future.add_done_callback(self._answered)

    def _answered(self, future):
        if self._pending is None or self._pending[-1] is not future:
            return
        done, response = self._pending[-2], future.result()
        self._pending = None
        done(response.success, response.message, response.log)

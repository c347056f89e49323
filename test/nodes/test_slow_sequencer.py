# SPDX-License-Identifier: Apache-2.0
"""A sequencer that is slow to accept a goal, or ends before it does: no run begins that nobody waits for."""

import os
import signal
import threading
import time

import pytest
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, RunState

from rosette_ros.nodes import names, qos

pytestmark = pytest.mark.long

SLOW = 2.0
"""Time until a goal is accepted, s."""


class SlowSequencer:
    """Accepts each goal after a while and runs until it is cancelled; events: what happened to it."""

    def __init__(self, node):
        """Serve on a node."""
        self.events = []
        self._is_cancelled = Future()
        self._state = node.create_publisher(RunState, names.RUN_STATE, qos.STATE)
        node.create_publisher(CalibrationEvent, names.CALIBRATION_EVENT, qos.EVENT)
        self.server = ActionServer(node, Calibrate, names.CALIBRATE, self._execute, goal_callback=self._accept,
                                   cancel_callback=self._cancel)
        self._state.publish(RunState(process='sequencer 1'))

    def _accept(self, goal):
        self.events.append('requested')
        time.sleep(SLOW)
        return GoalResponse.ACCEPT

    def _cancel(self, handle):
        self.events.append('cancelled')
        self._is_cancelled.set_result(None)
        return CancelResponse.ACCEPT

    async def _execute(self, handle):
        await self._is_cancelled
        handle.canceled()
        return Calibrate.Result()


@pytest.fixture
def sequencer(peer):
    """Yield a SlowSequencer on the test's peer."""
    made = SlowSequencer(peer.node)
    peer.start()
    yield made
    made.server.destroy()


def test_ctrl_c_before_the_goal_is_accepted_cancels_the_run(sequencer, client, wait_until):
    """The client ended, and the run went on without it."""
    def interrupt():
        wait_until(lambda: sequencer.events, 30.0)
        os.kill(os.getpid(), signal.SIGINT)
    threading.Thread(target=interrupt).start()
    outcome = client.calibrate()
    assert outcome.cancelled and not outcome.success
    assert sequencer.events == ['requested', 'cancelled']

# SPDX-License-Identifier: Apache-2.0
"""An action server for jobs that other callbacks carry on, without a task that waits."""

from rclpy.action import ActionServer


class LongActionServer(ActionServer):
    """An action server whose goals end by `finish` and not by the return of a callback.

    A coroutine that waits for hours is looked at by the executor in every step, or keeps it from
    resting at all.
    """

    def __init__(self, node, action_type, name, **callbacks):
        """Create the server; callbacks: goal_callback, handle_accepted_callback and so on."""
        super().__init__(node, action_type, name, _nothing, **callbacks)

    def notify_execute(self, goal_handle, execute_callback):
        """Start nothing: the goal is executing, somebody else sees to it."""

    def finish(self, goal_handle, result):
        """Send the result of a goal whose final state is set."""
        super().notify_execute(goal_handle, lambda _: result)


def _nothing(goal_handle):
    """Stand where rclpy wants a callback."""

# SPDX-License-Identifier: Apache-2.0
"""A managed (lifecycle) node of the cell: an integrator decides when it works."""

from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn

from rosette_ros.nodes.runner import CellNode
from rosette_ros.nodes.settings import Wanted

AUTOSTART = Wanted('autostart', True, 'whether the node configures and activates itself; false: a lifecycle '
                   'manager does', read_only=True)
_ACTIVE = 'active'


class ManagedNode(LifecycleNodeMixin, CellNode):
    """A CellNode with the states of a managed node; its interfaces stand in all of them.

    What is not active refuses in words instead of not being there. Source: design.ros2.org, managed nodes.
    """

    def __init__(self, name, wanted=()):
        """Declare the parameters; raises InvalidConfig in words."""
        CellNode.__init__(self, name, (*wanted, AUTOSTART))
        LifecycleNodeMixin.__init__(self)

    def autostart(self):
        """Become active where nobody else is to decide that; call it when all interfaces stand."""
        if self.parameters[AUTOSTART.name]:
            self.trigger_configure()
            self.trigger_activate()

    @property
    def state(self):
        """The label of the present state: unconfigured, inactive, active, finalized."""
        return self._state_machine.current_state[1]

    @property
    def is_active(self):
        """Whether the node works."""
        return self.state == _ACTIVE

    def on_deactivate(self, state):
        """Refuse to stop in the middle of something."""
        return self._unless_busy('deactivate')

    def on_shutdown(self, state):
        """Refuse to stop in the middle of something."""
        return self._unless_busy('shut down')

    def _unless_busy(self, what):
        if not self.is_busy:
            return TransitionCallbackReturn.SUCCESS
        self.get_logger().warning(f'asked to {what}: wanted nothing to be on, got: {self.health()[1]}; cancel it '
                                  'or wait for its end')
        return TransitionCallbackReturn.FAILURE

# SPDX-License-Identifier: Apache-2.0
"""What all nodes of the cell share: start, clean end, parameters, health."""

import signal
import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rosette_ros.core.errors import RosetteError
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.parameters import Parameters

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
WAKE_PERIOD = 0.1
"""How soon a node notices that it shall end, s."""
HEALTH_PERIOD = 1.0


class CellNode(Node):
    """A node with declared parameters, a steady clock and a health report once per second."""

    def __init__(self, name, wanted=()):
        """Declare the parameters; raises InvalidConfig in words."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.parameters = Parameters(self, wanted)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.system = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._health = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.HEALTH)
        self.create_timer(HEALTH_PERIOD, self._tell_health, clock=self.steady)
        self.create_timer(WAKE_PERIOD, self.wake, clock=self.steady)

    def create_publisher(self, *args, **kwargs):
        """Create a publisher without events: in Python each costs as much as a subscription."""
        kwargs.setdefault('event_callbacks', PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(*args, **kwargs)

    def create_subscription(self, *args, **kwargs):
        """Create a subscription without events, see create_publisher."""
        kwargs.setdefault('event_callbacks',
                          SubscriptionEventCallbacks(use_default_callbacks=False))
        return super().create_subscription(*args, **kwargs)

    def health(self):
        """Return (level, sentence, values) about this node; values: name to printable."""
        return OK, 'running', {}

    def wake(self):
        """Do what a node has to do by the wall clock; called every WAKE_PERIOD."""

    def step(self):
        """Do the next thing; returns after WAKE_PERIOD at the latest."""
        self.executor.spin_once()

    def finish(self):
        """End in good order; `step` may still be called."""

    def seconds(self):
        """Return the steady wall time, s."""
        return 1e-9 * self.steady.now().nanoseconds

    def now(self):
        """Return the ROS time, and the wall time as long as no /clock has been heard."""
        time = self.get_clock().now()
        return time if time.nanoseconds > 0 else self.system.now()

    def has_time(self):
        """Return whether the ROS time runs: always on the wall clock, else after a /clock."""
        return self.get_clock().now().nanoseconds > 0

    def _tell_health(self):
        level, sentence, values = self.health()
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name().lstrip('/'), message=sentence,
            hardware_id=self.get_namespace().lstrip('/'),
            values=[KeyValue(key=str(key), value=str(value)) for key, value in values.items()])
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.now().to_msg()
        self._health.publish(message)


class _Stop:
    """Remembers that SIGINT or SIGTERM came; further ones change nothing: the end is bounded."""

    def __init__(self):
        self.requested = False
        self._before = {number: signal.signal(number, self._take)
                        for number in (signal.SIGINT, signal.SIGTERM)}

    def _take(self, number, frame):
        self.requested = True

    def restore(self):
        for number, handler in self._before.items():
            signal.signal(number, handler)


def run_node(name, make_node, args=None):
    """Run one node until SIGINT or SIGTERM and return the exit code.

    0 after a clean end, 2 where the node cannot run as asked: one line on stderr says why.
    """
    stop = _Stop()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        _spin(make_node, stop)
    except (RosetteError, NameValidationException, ParameterException,
            rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError) as error:
        print(f'{name}: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
        stop.restore()
    return 0


def _spin(make_node, stop):
    node = make_node()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        node.get_logger().info(names.READY)
        while not stop.requested:
            node.step()
        node.finish()
    finally:
        executor.shutdown()
        node.destroy_node()

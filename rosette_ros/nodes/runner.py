# SPDX-License-Identifier: Apache-2.0
"""What all nodes of the cell share: start, clean end, parameters, health."""

import math
import os
import signal
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock as ClockMessage

from rosette_ros.core.errors import RosetteError
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.alive import Beat
from rosette_ros.nodes.ears import Aside, Ears, take_all
from rosette_ros.nodes.parameters import Parameters

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
WAKE_PERIOD, HEALTH_PERIOD = 0.1, 1.0
BUSY_PERIOD, IDLE_PERIOD = 0.02, 0.05
"""How often a node looks after services, parameters and timers, s; nobody waits longer."""
_MOST_AT_ONCE = 100


class CellNode(Node):
    """A node of the cell: parameters, ears, a health report, and steps that it takes by itself."""

    _clock_subscription = None
    is_patient = False
    """Whether it lets messages wait for a while, in order to take many at once."""

    def __init__(self, name, wanted=()):
        """Declare the parameters; raises InvalidConfig in words."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.parameters = Parameters(self, wanted)
        self.ears = Ears(self, self.lost)
        self.system = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._handlers = {}
        self._served = self._woken = self._reported = -math.inf
        self._health = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.HEALTH)
        self._beat = Beat(self)

    # What a node is made of

    def on(self, name, message_class, handler, profile, tell_incompatible=False):
        """Subscribe; handler(message) is called in the order of receipt over all topics."""
        topic = self.resolve_topic_name(name)
        self._handlers[topic] = handler
        self.ears.listen(topic, message_class, profile, tell_incompatible=tell_incompatible)

    def create_publisher(self, *args, **kwargs):
        """Create a publisher without events: in Python each costs as much as a subscription."""
        kwargs.setdefault('event_callbacks', PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(*args, **kwargs)

    def create_subscription(self, msg_type, *args, **kwargs):
        """Create a subscription without events; the one to /clock is looked into by now()."""
        kwargs.setdefault('event_callbacks',
                          SubscriptionEventCallbacks(use_default_callbacks=False))
        if msg_type is not ClockMessage or 'callback_group' in kwargs:
            return super().create_subscription(msg_type, *args, **kwargs)
        self._clock_subscription = super().create_subscription(
            msg_type, *args, callback_group=Aside(), **kwargs)
        return self._clock_subscription

    def destroy_subscription(self, subscription):
        """Destroy a subscription."""
        if subscription is self._clock_subscription:
            self._clock_subscription = None
        return super().destroy_subscription(subscription)

    # What a node does

    @property
    def is_busy(self):
        """Whether something is on that shall not wait."""
        return False

    def hear(self, heard):
        """Take what was said since the last step, entries as of Ears.take."""
        for _, topic, message, _ in heard:
            self._handlers[topic](message)

    def lost(self, topic, count):
        """Take note that messages were lost on the way."""
        self.get_logger().error(f'{count} messages on {topic} were lost on the way')

    def wake(self):
        """Do what a node has to do by the wall clock; called every WAKE_PERIOD."""

    def health(self):
        """Return (level, sentence, values) about this node; values: name to printable."""
        return OK, 'running', {}

    def finish(self):
        """End in good order; `step` may still be called."""

    def step(self):
        """Hear what was said, do what else is due, and rest; ends after IDLE_PERIOD at most."""
        self.hear(self.ears.take())
        now, period = self.seconds(), BUSY_PERIOD if self.is_busy else IDLE_PERIOD
        if now - self._served >= period:
            self._served = now
            self._serve(now)
        if self.is_patient:
            time.sleep(period)
        else:
            self.ears.wait(period)

    def _serve(self, now):
        """Run what the executor has, and what is due by the wall clock."""
        try:
            for _ in range(_MOST_AT_ONCE):
                task, _, _ = self.executor.wait_for_ready_callbacks(timeout_sec=0)
                task()
                if task.exception() is not None:
                    raise task.exception()
        except TimeoutException:
            pass
        self._beat.beat_if_due(now)
        if now - self._woken >= WAKE_PERIOD:
            self._woken = now
            self.wake()
        if now - self._reported >= HEALTH_PERIOD:
            self._reported = now
            self._tell_health()

    # Times

    def seconds(self):
        """Return the steady wall time, s."""
        return time.monotonic()

    def now(self):
        """Return the ROS time, and the wall time as long as no /clock has been heard."""
        ros_time = self._ros_time()
        return ros_time if ros_time.nanoseconds > 0 else self.system.now()

    def has_time(self):
        """Return whether the ROS time runs: always on the wall clock, else after a /clock."""
        return self._ros_time().nanoseconds > 0

    def _ros_time(self):
        if self._clock_subscription is not None:
            for message, _ in take_all(self._clock_subscription):
                self._clock_subscription.callback(message)
        return self.get_clock().now()

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


class _Parent:
    """The process that started this node to end it: without it the node ends by itself."""

    def __init__(self):
        wanted = os.environ.get(names.PARENT_PID, '')
        self._pid = int(wanted) if wanted.isdigit() else None

    @property
    def has_gone(self):
        """Whether there was such a process and it is no more."""
        return self._pid is not None and os.getppid() != self._pid


def _spin(make_node, stop):
    parent = _Parent()
    node = make_node()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        node.get_logger().info(names.READY)
        while not (stop.requested or parent.has_gone):
            node.step()
        if parent.has_gone:
            node.get_logger().warning('the process that started this cell has gone; ending')
        node.finish()
    finally:
        executor.shutdown()
        node.destroy_node()

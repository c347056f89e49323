# SPDX-License-Identifier: Apache-2.0
"""The base classes of the cell's nodes and how one is run: parameters, status, lifecycle, clean end."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, SimpleManagedEntity, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.time import Time

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import CellError, InvalidConfig, InvalidData, RosetteError
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.environment import check_environment
from rosette_ros.nodes.graph_node import GraphNode
from rosette_ros.nodes.interfaces import decoded
from rosette_ros.nodes.liveliness import NodeMonitor, NodeMonitors, ServiceServers, StatusPublisher, TopicPublishers
from rosette_ros.nodes.parameters import Parameters, refuse_unknown_sections

RCLError = rclpy_implementation.RCLError
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
WAKE_PERIOD, HEALTH_PERIOD = 0.2, 1.0
AUTOSTART = Wanted('autostart', True, 'whether the node configures and activates itself; false: a lifecycle '
                   'manager does', read_only=True)
_SIGNAL_PERIOD = 0.05  # a signal, or the end of the parent process, is noticed within this time, s

_REFUSED = 'ROS refuses the arguments or the environment'

Health = tuple[bytes, str, dict[str, object]]
"""Level of DiagnosticStatus, one sentence, values by name."""


class CellNode(GraphNode):
    """A node of the cell.

    Topics: publishes `/diagnostics` (diagnostic_msgs/DiagnosticArray) twice a second; `health` is asked every
    HEALTH_PERIOD. All callbacks run in one thread, in the order in which messages were received.

    wake_period: time between two calls of `wake`, s."""

    wake_period = WAKE_PERIOD

    def __init__(self, name: str, wanted: Sequence[Wanted] = ()) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.parameters = Parameters(self, tuple(wanted))
        self.system = Clock(clock_type=ClockType.SYSTEM_TIME)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.status = StatusPublisher(self, self.now)
        self._disturbances = frozenset[str]()
        self.every(HEALTH_PERIOD, self._describe)
        self._monitors = NodeMonitors(self)
        self._own = self.monitor(name)
        self._publishers_of: dict[str, TopicPublishers] = {}
        self._servers_of: dict[str, ServiceServers] = {}
        self.every(self.wake_period, self._wake)

    def on(self, name: str, message_class: type, handler: Callable[[Any], None], profile: QoSProfile,
           raw: bool = False, from_one: bool = False) -> Subscription:
        """Subscribe; raw: the handler gets CDR bytes; from_one: of a topic in names.PUBLISHERS nothing is handled while
        several nodes publish it, of one in names.SIGNED nothing but what the process says that has the role."""
        known = self.publishers_of(name) if from_one and name in names.PUBLISHERS else None
        role = self.monitor(names.SIGNED[name]) if from_one and name in names.SIGNED else None

        def sender_of(message: Any) -> str:
            try:
                return str((decoded(message, message_class) if raw else message).process)
            except InvalidData:  # bytes that are no such message
                return ''

        def admitted(message: Any) -> None:
            if role is not None:
                role.admit(sender_of(message), name, lambda: handler(message))
            elif known is None or known.admits():
                handler(message)

        made = self.create_subscription(message_class, name, admitted, profile, raw=raw)
        if known is not None:
            known.judge(made)
        return made

    def say(self, publisher: Publisher, message: Any) -> None:
        """Publish a message on a topic in names.SIGNED."""
        message.process = self.status.process
        publisher.publish(message)

    def refuse_second(self, patience: float = 0.0) -> None:
        """Raise CellError where another process that runs has the role of this one.

        patience: s, for the status of one that the graph shows, before this one does anything."""
        deadline = self.seconds() + patience
        while (not (elder := self._own.elder(self.status)) and self.seconds() < deadline
               and len(self._own.publishers()) > 1):
            time.sleep(_SIGNAL_PERIOD)
            self._monitors.take()
        if elder:
            raise CellError(f'expected no other {self._own.peer} in the namespace {self.get_namespace()} of this '
                            'domain, '
                            f'found process {elder.removeprefix(self._own.peer).rpartition(" ")[0].strip()}, which '
                            'runs; '
                            'end that one, or give this one a namespace or domain of its own')

    def monitor(self, peer: str) -> NodeMonitor:
        """Return the monitor of another node of the cell."""
        return self._monitors.of(peer)

    def publishers_of(self, topic: str) -> TopicPublishers:
        """Return what is known about the publishers of a topic in names.PUBLISHERS."""
        if topic not in self._publishers_of:
            self._publishers_of[topic] = TopicPublishers(self, topic, self.monitor(names.PUBLISHERS[topic]))
        return self._publishers_of[topic]

    def servers_of(self, service: str) -> ServiceServers:
        """Return what is known about the servers of a service in names.SERVERS."""
        if service not in self._servers_of:
            self._servers_of[service] = ServiceServers(self, service, self.monitor(names.SERVERS[service]))
        return self._servers_of[service]

    @property
    def has_single_publishers(self) -> bool:
        """Whether no topic in names.PUBLISHERS that is used has two publishers."""
        return all(one.is_single for one in self._publishers_of.values())

    def destroy_node(self) -> None:
        """End the status and destroy the node."""
        self.status.end()
        super().destroy_node()

    def _wake(self) -> None:
        self.status.serve()
        for words in self._monitors.watch():
            self.get_logger().warning(words)
        for one in (*self._publishers_of.values(), *self._servers_of.values()):
            one.watch()
        self.wake()

    def every(self, period: float, callback: Callable[[], None]) -> None:
        """Call back every `period` s of wall time, whatever the simulated time does."""
        self.create_timer(period, callback, clock=self._steady)

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        """Call back once after `delay` s of wall time, at once where it is 0."""
        if delay <= 0:
            callback()
            return

        def once() -> None:
            if self.destroy_timer(timer):  # an executor that was late may call a timer twice
                callback()

        timer = self.create_timer(delay, once, clock=self._steady)

    def spin_until(self, condition: Callable[[], bool], timeout: float) -> None:
        """Run callbacks until the condition holds, at most for `timeout` s; not to be called in a callback."""
        deadline = self.seconds() + timeout
        while not condition() and self.seconds() < deadline:
            self.executor.spin_once(timeout_sec=_SIGNAL_PERIOD)

    def wake(self) -> None:
        """Do what is due by the wall clock; called every `wake_period`."""

    def health(self) -> Health:
        """Return what `/diagnostics` says about this node."""
        return OK, 'running', {}

    def finish(self) -> None:
        """End in good order; called outside callbacks, may call spin_until."""

    def seconds(self) -> float:
        """Return the steady wall time, s."""
        return time.monotonic()

    def now(self) -> Time:
        """Return the ROS time, and the wall time until the first /clock is received."""
        ros_time = self.get_clock().now()
        return ros_time if ros_time.nanoseconds > 0 else self.system.now()

    @property
    def has_simulated_time(self) -> bool:
        """Whether the ROS time is that of /clock."""
        return bool(self.get_parameter('use_sim_time').value)

    def has_time(self) -> bool:
        """Return whether the ROS time runs: always on the wall clock, else after the first /clock."""
        return self.get_clock().now().nanoseconds > 0

    def _describe(self) -> None:
        level, sentence, values = self.health()
        conflicts = {f'{one.conflict}: what they publish is not used'
                     for one in self._publishers_of.values() if one.conflict and not one.is_tried}
        conflicts |= {f'{one.conflict}: nothing is asked of them' for one in self._servers_of.values() if one.conflict}
        before, self._disturbances = self._disturbances, frozenset(self.unconnected() | conflicts)
        for words in sorted(self._disturbances):
            level, sentence = max(level, WARN), f'{sentence}; {words}'
            if words not in before:
                self.get_logger().warning(words)
        self.status.describe(level, sentence, values)


class ManagedNode(LifecycleNodeMixin, CellNode):
    """A CellNode with the states of a managed node; its interfaces exist in all of them.

    While it is not active it refuses in words. Source: design.ros2.org, managed nodes."""

    def __init__(self, name: str, wanted: Sequence[Wanted] = ()) -> None:
        CellNode.__init__(self, name, (*wanted, AUTOSTART))
        LifecycleNodeMixin.__init__(self)
        self._active = SimpleManagedEntity()
        self.add_managed_entity(self._active)

    def autostart(self) -> None:
        """Become active unless a lifecycle manager decides that; call it when all interfaces exist."""
        if self.parameters[AUTOSTART.name]:
            self.trigger_configure()
            self.trigger_activate()

    @property
    def is_active(self) -> bool:
        """Whether the node works."""
        return self._active.is_activated

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse to stop in the middle of something."""
        return super().on_deactivate(state) if self._may('deactivate') else TransitionCallbackReturn.FAILURE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refuse to stop in the middle of something."""
        if not self._may('shut down'):
            return TransitionCallbackReturn.FAILURE
        self._active.on_deactivate(state)
        return super().on_shutdown(state)

    def _may(self, what: str) -> bool:
        if self.is_busy:
            self.get_logger().warning(f'asked to {what}: expected no calibration running, found: {self.health()[1]}; '
                                      'cancel it or wait for its end')
        return not self.is_busy


class TakenSignals(AbstractContextManager['TakenSignals']):
    """Remembers that a signal was received, in place of what it does otherwise; outside the main thread takes none.

    once: whether a second one acts as usual."""

    def __init__(self, *numbers: signal.Signals, once: bool = False) -> None:
        self.is_received, self._once, self._before = False, once, dict[int, Any]()
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._take) for number in numbers}

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        self.is_received = True
        if self._once:
            signal.signal(number, self._before[number])


def run_node(name: str, make_node: Callable[[], CellNode], args: list[str] | None = None) -> int:
    """Run one node until SIGINT or SIGTERM and return the exit code.

    0 after a clean end, 2 where the node cannot run as configured: one line on stderr gives the reason."""
    with TakenSignals(signal.SIGINT, signal.SIGTERM) as stop:  # further ones change nothing: the end is bounded in time
        try:
            _init(args)
            _spin(make_node, stop, sys.argv if args is None else args)
        except (RosetteError, NameValidationException, ParameterException) as error:
            print(f'{name}: {" ".join(str(error).split())}', file=sys.stderr)
            return 2
        finally:
            rclpy.try_shutdown()
    return 0


def _init(args: list[str] | None) -> None:
    """Initialise rclpy; raises InvalidConfig where it refuses arguments or environment, by a RuntimeError."""
    check_environment(None)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InvalidConfig(f'{_REFUSED}: {error}') from error


def make_executor(context: Context | None = None) -> Executor:
    """Return the executor of a node (context: None for the default one).

    It costs a tenth of SingleThreadedExecutor, which goes through all entities of the node for every message. Its
    spin() does not return in rclpy 7.1.6; spin_once does."""
    return EventsExecutor(context=context)


def _spin(make_node: Callable[[], CellNode], stop: TakenSignals, arguments: Sequence[str]) -> None:
    parent = os.environ.get(names.PARENT_PID, '')

    def is_orphaned() -> bool:
        return parent.isdigit() and os.getppid() != int(parent)

    try:
        node = make_node()
    except RCLError as error:
        raise InvalidConfig(f'{_REFUSED}: {error}') from error
    executor = make_executor()
    try:
        refuse_unknown_sections(arguments, node)
        node.refuse_second(qos.STATUS_LOST)
        executor.add_node(node)
        node.get_logger().info(names.READY)
        while not (stop.is_received or is_orphaned()):
            executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
            node.refuse_second()  # not in a callback: the executor would print where it was raised
        if is_orphaned():
            node.get_logger().warning('the process that started this cell has ended; ending')
        node.finish()
    finally:
        executor.shutdown()
        node.destroy_node()

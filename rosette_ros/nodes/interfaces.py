# SPDX-License-Identifier: Apache-2.0
"""ROS interfaces: classes by their names, messages from their bytes, services whose traffic can be recorded."""

import importlib
import re
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer
from rclpy.client import Client
from rclpy.executors import await_or_execute
from rclpy.node import Node
from rclpy.qos import qos_profile_services_default
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rosette_msgs.action import Calibrate

from rosette_ros.core.run.errors import InvalidConfig, InvalidData, plain

_NAME = re.compile(r'([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)')


def interface_class(type_name: str) -> type:
    """Return the class of `package/msg/Type`, `package/srv/Type_Event` or `package/action/Type_FeedbackMessage`.

    Raises InvalidConfig where it is not installed."""
    match = _NAME.fullmatch(type_name)
    if not match:
        raise InvalidConfig(f'message type: expected package/msg/Type, found {type_name!r:.100}')
    package, kind, name = match.groups()
    try:
        module = importlib.import_module(f'{package}.{kind}')
        if name.endswith('_Event'):
            return getattr(module, name.removesuffix('_Event')).Event
        if name.endswith('_FeedbackMessage'):
            return getattr(module, name.removesuffix('_FeedbackMessage')).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise InvalidConfig(f'{type_name}: expected an installed interface, found: {error}') from error


def decoded(data: bytes, message_class: type) -> Any:
    """Return the message of CDR bytes, an instance of its class; raises InvalidData where they are none of it."""
    try:
        return deserialize_message(bytes(data), message_class)
    except RuntimeError as error:  # each middleware has its own words
        raise InvalidData(f'{message_class.__name__}: expected its CDR, found {len(data)} bytes that are none; was it '
                          'sent with another version of the message?') from error


def introspected_client(node: Node, service_type: type, name: str) -> Client:
    """Return a client that publishes its traffic on `<name>/_service_event`."""
    client = node.create_client(service_type, name)
    client.configure_introspection(node.get_clock(), qos_profile_services_default, ServiceIntrospectionState.CONTENTS)
    return client


def introspected_service(node: Node, service_type: type, name: str, callback: Callable[..., Any]) -> Service:
    """Return a service that publishes its traffic on `<name>/_service_event`."""
    service = node.create_service(service_type, name, callback)
    service.configure_introspection(node.get_clock(), qos_profile_services_default, ServiceIntrospectionState.CONTENTS)
    return service


def waiting_service(node: Node, service_type: type, name: str, callback: Callable[..., Any]) -> Service:
    """Return a service whose callback is a coroutine: while it waits, the node's other callbacks run.

    An EventsExecutor (rclpy 7.1.6) takes what the callback returns for the response."""
    service = node.create_service(service_type, name, callback)
    send = service.send_response

    def finish(work: Any, header: Any) -> None:
        async def respond() -> None:
            send(await work, header)

        run_task(node, respond)

    service.send_response = finish
    return service


def run_task(node: Node, work: Callable[[], Any]) -> None:
    """Have the executor of a node run a function or a coroutine; what fails in it is in the log of the node.

    An exception of a task ends a process with one node by SIGSEGV: the EventsExecutor of rclpy 7.1 looks for the logger
    in an index of a set."""
    async def told() -> None:
        try:
            await await_or_execute(work)
        except Exception:
            tell_defect(node)

    node.executor.create_task(told)


def tell_defect(node: Node) -> str:
    """Write the exception that is being handled into the log of a node, and return it in one line."""
    node.get_logger().error(f'error of the program: {traceback.format_exc()}')
    return plain(f'expected no error of the program, found {traceback.format_exc().strip().splitlines()[-1]}; please '
                 'report it with the messages of this node')


class CalibrateServer(ActionServer):
    """An action server whose goals end by `send_result` and not by the return of a callback.

    A coroutine that waits for hours would be run by the executor in every step."""

    async def execute(self, taken_data: Any) -> None:
        """Serve requests, as a task of the executor: see run_task."""
        try:
            await super().execute(taken_data)
        except Exception:
            tell_defect(self._node)

    def notify_execute(self, goal_handle: Any, execute_callback: Callable[..., Any] | None) -> None:
        """Start nothing: the state machine carries the goal on."""

    def send_result(self, goal_handle: Any, result: Calibrate.Result) -> None:
        """Send the result of a goal whose final state is set."""
        super().notify_execute(goal_handle, lambda _: result)

# SPDX-License-Identifier: Apache-2.0
"""ROS interfaces: classes by their names, messages from their bytes, services whose traffic can be recorded."""

import importlib
import re
from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.action import ActionServer
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import qos_profile_services_default
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rosette_msgs.action import Calibrate

from rosette_ros.core.run.errors import InvalidConfig, InvalidData

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

    async def finish(work: Coroutine[Any, Any, Any], header: Any) -> None:
        send(await work, header)

    service.send_response = lambda work, header: node.executor.create_task(finish, work, header)
    return service


class CalibrateServer(ActionServer):
    """An action server whose goals end by `send_result` and not by the return of a callback.

    A coroutine that waits for hours would be run by the executor in every step."""

    def notify_execute(self, goal_handle: Any, execute_callback: Callable[..., Any] | None) -> None:
        """Start nothing: the state machine carries the goal on."""

    def send_result(self, goal_handle: Any, result: Calibrate.Result) -> None:
        """Send the result of a goal whose final state is set."""
        super().notify_execute(goal_handle, lambda _: result)

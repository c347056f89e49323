# SPDX-License-Identifier: Apache-2.0
"""Message classes by their names, parts of services and actions included, and messages from their bytes."""

import importlib
import re

from rclpy.serialization import deserialize_message

from rosette_ros.core.errors import InvalidConfig, InvalidData

_NAME = re.compile(r'([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9_]*)')


def interface_class(type_name):
    """Return the class of a type name.

    type_name: `package/msg/Type`, `package/srv/Type_Event` or `package/action/Type_FeedbackMessage`.

    Raises InvalidConfig where it is not installed.
    """
    match = _NAME.fullmatch(type_name)
    if not match:
        raise InvalidConfig(f'message type: wanted package/msg/Type, got {type_name!r:.100}')
    package, kind, name = match.groups()
    try:
        module = importlib.import_module(f'{package}.{kind}')
        if name.endswith('_Event'):
            return getattr(module, name.removesuffix('_Event')).Event
        if name.endswith('_FeedbackMessage'):
            return getattr(module, name.removesuffix('_FeedbackMessage')).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise InvalidConfig(f'{type_name}: wanted an installed interface, got: {error}') from error


def decoded(data, message_class):
    """Return the message that CDR bytes hold; raises InvalidData where they are none of it."""
    try:
        return deserialize_message(bytes(data), message_class)
    except RuntimeError as error:  # whatever the middleware calls it
        raise InvalidData(f'{message_class.__name__}: wanted its CDR, got {len(data)} bytes that are none; was it '
                          'sent with another version of the message?') from error

# SPDX-License-Identifier: Apache-2.0
"""Message classes by their names, parts of services and actions included."""

import importlib

from rosette_ros.core.errors import InvalidConfig


def interface_class(type_name):
    """Return the class of a type name.

    type_name: `package/msg/Type`, `package/srv/Type_Event` or `package/action/Type_FeedbackMessage`.

    Raises InvalidConfig where it is not installed.
    """
    package, _, rest = type_name.partition('/')
    kind, _, name = rest.partition('/')
    try:
        module = importlib.import_module(f'{package}.{kind}')
        if name.endswith('_Event'):
            return getattr(module, name.removesuffix('_Event')).Event
        if name.endswith('_FeedbackMessage'):
            return getattr(module, name.removesuffix('_FeedbackMessage')).Impl.FeedbackMessage
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        raise InvalidConfig(f'{type_name}: wanted an installed interface, got: {error}') from error

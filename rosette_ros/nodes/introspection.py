# SPDX-License-Identifier: Apache-2.0
"""Services whose requests and responses can be recorded."""

from rclpy.qos import qos_profile_services_default
from rclpy.service_introspection import ServiceIntrospectionState


def introspected_client(node, service_type, name):
    """Return a client that publishes its traffic on `<name>/_service_event`."""
    client = node.create_client(service_type, name)
    _publish_events(node, client)
    return client


def introspected_service(node, service_type, name, callback, group=None):
    """Return a service that publishes its traffic on `<name>/_service_event`."""
    service = node.create_service(service_type, name, callback, callback_group=group)
    _publish_events(node, service)
    return service


def _publish_events(node, endpoint):
    endpoint.configure_introspection(
        node.get_clock(), qos_profile_services_default, ServiceIntrospectionState.CONTENTS)

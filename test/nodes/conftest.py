# SPDX-License-Identifier: Apache-2.0
"""ROS contexts, clients and witnesses for tests of the nodes."""

import contextlib
import threading
import time
from collections import defaultdict

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from rosette_ros.cell.client import CellClient
from rosette_ros.nodes import names
from rosette_ros.nodes.interfaces import interface_class, introspected_client
from rosette_ros.nodes.liveliness import NodeMonitors
from rosette_ros.nodes.recorder import Recorder


@pytest.fixture
def ros(domain_id):
    """Return a context manager that initialises rclpy with arguments in the test's domain."""

    @contextlib.contextmanager
    def initialise(*args):
        rclpy.init(args=['--ros-args', *args], domain_id=domain_id)
        try:
            yield
        finally:
            rclpy.try_shutdown()

    return initialise


@pytest.fixture
def client(domain_id):
    """Yield a CellClient in the test's domain."""
    with CellClient(domain_id) as made:
        yield made


@pytest.fixture(scope='session')
def trigger():
    """Return a function that calls a Trigger service of a client's cell and returns (success, message)."""

    def call(client, name):
        service = introspected_client(client._node, Trigger, name)
        assert client._spin_until(service.service_is_ready, 60.0)
        for _ in range(3):  # a server that was killed is ready for 20 s more, and takes no request
            answer = service.call_async(Trigger.Request())
            if client._spin_until(answer.done, 30.0):
                break
        client._node.destroy_client(service)
        return answer.result().success, answer.result().message

    return call


class Peer:
    """A node of the test in a thread of its own: hears raw messages, publishes, answers."""

    def __init__(self, domain, namespace='/rosette', name='peer'):
        """Join the graph."""
        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = Node(name, namespace=namespace, context=self.context)
        self.heard = defaultdict(list)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._subscriptions = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin)

    def listen(self, topic, type_name):
        """Hear a topic; the bytes of its messages go to heard[topic]."""
        self._subscriptions.append(self.node.create_subscription(
            interface_class(type_name), topic, self.heard[topic].append,
            QoSProfile(depth=10_000), raw=True))

    def start(self):
        """Start listening; returns once the nodes that publish send it here, too."""
        self._thread.start()
        self._wait(lambda: all(one.get_publisher_count() for one in self._subscriptions), 'publishers of all topics')
        # DDS announces subscriptions in their order: a node whose status comes here knows of all the others.
        found = {info.node_name for one in self._subscriptions
                 for info in self.node.get_publishers_info_by_topic(one.topic_name)} & set(names.NODES)
        every = NodeMonitors(self.node)
        monitors = [every.of(name) for name in found]
        self._wait(lambda: all(monitor.process for monitor in monitors), f'statuses of {", ".join(found)}')
        return self

    @staticmethod
    def _wait(condition, wanted):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, f'expected {wanted} within 60 s'
            time.sleep(0.02)

    def stop(self):
        """Leave the graph."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _spin(self):
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=0.05)


@pytest.fixture
def recorder(ros, tmp_path):
    """Yield a Recorder whose messages come from the test alone."""
    with ros('-r', '__ns:=/rosette', '-p', f'log_dir:={tmp_path}'):
        node = Recorder()
        yield node
        if node._session.is_open:
            node._close()
        node.destroy_node()


@pytest.fixture
def peer(domain_id):
    """Yield a Peer in the test's domain; the test starts it."""
    made = Peer(domain_id)
    yield made
    made.stop()


@pytest.fixture(scope='session')
def make_peer():
    """Return the class Peer, for any domain."""
    return Peer

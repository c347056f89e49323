# SPDX-License-Identifier: Apache-2.0
"""Services of a CMM node: while one waits for the machine, the others are answered."""

import socket
import threading
import time

import pytest
import rclpy
import yaml
from rosette_msgs.srv import CheckPlan
from std_srvs.srv import Trigger

from rosette_ros.nodes import names
from rosette_ros.nodes.base_node import make_executor
from rosette_ros.nodes.dme_cmm import DmeCmmNode

ACK = 5.0
SETTINGS = {'schema': 'rosette-dme/1', 'table': {'balls': 6}, 'timeouts': {'ack_s': ACK},
            'path': {'box_low_mm': [0, 0, -400], 'box_high_mm': [700, 600, 100]}}


@pytest.fixture
def silent_server(tmp_path):
    """Yield the settings of a server that accepts connections and never says a word."""
    with socket.create_server(('127.0.0.1', 0)) as server:
        path = tmp_path / 'dme.yaml'
        path.write_text(yaml.safe_dump({**SETTINGS, 'server': {'port': server.getsockname()[1]}}), encoding='utf-8')
        yield path


def test_recover_keeps_nothing_else_waiting(ros, silent_server, domain_id, make_peer, wait_until):
    """It waits for the server for five seconds; a plan is checked meanwhile."""
    with ros('-r', f'__ns:=/{names.NAMESPACE}', '-p', f'settings:={silent_server}'):
        node, executor, over = DmeCmmNode(), make_executor(), threading.Event()
        executor.add_node(node)

        def spin():
            while not over.is_set():
                executor.spin_once(timeout_sec=0.05)

        thread = threading.Thread(target=spin)
        thread.start()
        peer = make_peer(domain_id)
        recover, check = (peer.node.create_client(kind, name) for kind, name in (
            (Trigger, names.RECOVER), (CheckPlan, names.CHECK_PLAN)))
        peer.start()
        assert recover.wait_for_service(20.0) and check.wait_for_service(20.0)
        wait_until(lambda: node._trouble)
        began = time.monotonic()
        recovered, checked = recover.call_async(Trigger.Request()), check.call_async(CheckPlan.Request())
        wait_until(checked.done)
        assert time.monotonic() - began < 0.5 * ACK and not recovered.done()
        wait_until(recovered.done)
        assert time.monotonic() - began >= 0.9 * ACK
        assert not recovered.result().success and 'expected its Ack within 5 s' in recovered.result().message
        over.set()
        thread.join()
        node.finish()
        executor.shutdown()
        node.destroy_node()
        peer.stop()
    assert not rclpy.ok()

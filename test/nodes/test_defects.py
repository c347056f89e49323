# SPDX-License-Identifier: Apache-2.0
"""Errors of the program itself in what an executor runs as a task: they end what was asked for, not the process."""

import pytest
from rclpy.action import ActionClient
from rosette_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rosette_ros.nodes import names, sequencer
from rosette_ros.nodes.base_node import make_executor
from rosette_ros.nodes.interfaces import run_task, waiting_service
from rosette_ros.nodes.run_control import RunControl
from rosette_ros.nodes.sequencer import Sequencer


def broken(*_):
    raise ZeroDivisionError('on purpose')


@pytest.fixture
def executor():
    made = make_executor()
    yield made
    made.shutdown()


@pytest.fixture
def node(ros, executor):
    """Yield a sequencer that is alone in its process, as in a cell; no node is missing to it."""
    with ros('-r', f'__ns:=/{names.NAMESPACE}', '-p', 'require_recorder:=false'):
        made = Sequencer()
        executor.add_node(made)
        yield made
        made.destroy_node()


def answer_of(future, executor, wait_until):
    def is_done():
        executor.spin_once(timeout_sec=0.02)
        return future.done()

    wait_until(is_done, 20.0)
    return future.result()


@pytest.mark.parametrize('place, name, goal', [
    (sequencer.Request, 'of_goal', {}), (Sequencer, '_recalled', {}), (Sequencer, '_make_job', {}),
    (sequencer, 'goal_changes', {'resume': 'r1'}), (RunControl, '_open_log', {})])
def test_an_error_ends_the_goal(node, executor, wait_until, peer, monkeypatch, place, name, goal):
    """One node and one exception of a task: rclpy 7.1 ended the process by SIGSEGV. The next goal is answered, too."""
    monkeypatch.setattr(RunControl, 'lacks', '')
    monkeypatch.setattr(place, name, broken)
    client = ActionClient(peer.node, Calibrate, names.CALIBRATE)
    peer.start()
    assert client.wait_for_server(20.0)
    for _ in range(2):
        handle = answer_of(client.send_goal_async(Calibrate.Goal(**goal)), executor, wait_until)
        assert handle.accepted
        result = answer_of(handle.get_result_async(), executor, wait_until).result
        assert not result.success
        assert 'expected no error of the program, found ZeroDivisionError: on purpose' in result.message
    assert not node.is_busy


def test_an_error_in_a_waiting_service_leaves_the_others(node, executor, wait_until, peer):
    """The request has no answer; the process goes on."""
    async def fails(request, response):
        broken()

    waiting_service(node, Trigger, 'fails', fails)
    run_task(node, broken)
    fails, cancel = (peer.node.create_client(Trigger, name) for name in ('fails', names.CANCEL_CALIBRATION))
    peer.start()
    assert fails.wait_for_service(20.0) and cancel.wait_for_service(20.0)
    lost = fails.call_async(Trigger.Request())
    for _ in range(20):
        executor.spin_once(timeout_sec=0.02)
    assert not answer_of(cancel.call_async(Trigger.Request()), executor, wait_until).success
    assert not lost.done()

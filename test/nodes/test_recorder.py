# SPDX-License-Identifier: Apache-2.0
"""The recorder when something is heard at an unwelcome moment: what it hears is put into its ear."""

import pytest
from rclpy.serialization import serialize_message
from rosette_msgs.msg import RunState
from rosette_msgs.srv import Diagnose_Event, StartRecording, StopRecording
from service_msgs.msg import ServiceEventInfo

from rosette_ros.data.log_reader import read_log
from rosette_ros.nodes.recorder import Recorder

QUESTION = Diagnose_Event(info=ServiceEventInfo(event_type=ServiceEventInfo.REQUEST_RECEIVED))
IDLE = RunState(phase=RunState.PHASE_IDLE)


@pytest.fixture
def recorder(ros, tmp_path):
    """Yield (Recorder, what it will hear next: a list of (topic, message))."""
    with ros('-r', '__ns:=/rosette', '-p', f'log_dir:={tmp_path}'):
        node, soon = Recorder(), []
        node._until(lambda: False, 0.1)

        def take():
            heard = [(k + 1, topic, serialize_message(message), k + 1) for k, (topic, message) in enumerate(soon)]
            soon.clear()
            return heard

        node.ears.take = take
        yield node, soon
        node.finish()
        node.destroy_node()


def start(node, run_id):
    """Open the log of a run."""
    return node._on_start(StartRecording.Request(run_id=run_id), StartRecording.Response())


def stop(node, run_id):
    """Close it."""
    return node._on_stop(StopRecording.Request(run_id=run_id), StopRecording.Response())


def test_a_question_does_not_stand_in_the_way_of_a_run(recorder, tmp_path):
    """It is heard while the log of the next run is being opened: that one is opened all the same."""
    node, soon = recorder
    assert start(node, 'first').success
    assert stop(node, 'first').success
    soon.append(('/rosette/evaluator/diagnose/_service_event', QUESTION))
    response = start(node, 'second')
    assert response.success, response.message
    assert stop(node, 'second').success
    assert {path.name for path in tmp_path.iterdir()} >= {'first', 'second'}
    assert all(not read_log(path).truncated for path in tmp_path.iterdir())


def test_a_sequencer_that_is_started_anew_while_a_log_is_closed(recorder, tmp_path):
    """It says that nothing is on: the log is closed once, and whoever asked is told."""
    node, soon = recorder
    assert start(node, 'run').success
    soon.append(('/rosette/run_state', IDLE))
    response = stop(node, 'run')
    assert not response.success
    assert response.message.startswith('run run: its log was closed: run run: ')
    assert not read_log(tmp_path / 'run').truncated
    assert start(node, 'next').success
    soon.append(('/rosette/run_state', IDLE))
    node.finish()
    assert not node.is_busy
    assert not read_log(tmp_path / 'next').truncated

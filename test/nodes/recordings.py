# SPDX-License-Identifier: Apache-2.0
"""A recorder whose messages come from the test alone."""


from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from rosette_msgs.msg import (
    BallCentre,
    ProbeTarget,
    Touches,
)
from rosette_msgs.srv import StartRecording, StopRecording
from service_msgs.msg import ServiceEventInfo
from std_msgs.msg import Header


def receive(node, name, message):
    """Let a message arrive."""
    node._receive(node.resolve_topic_name(name), serialize_message(message))


def start(node, run_id):
    """Open the log of a run."""
    return node._on_start(StartRecording.Request(run_id=run_id), StartRecording.Response())


def stop(node, run_id, phase=0, is_recorded=True):
    """Close it; is_recorded: whether the traffic of the request arrives first."""
    request = StopRecording.Request(run_id=run_id, phase=phase)
    if is_recorded:
        info = ServiceEventInfo(event_type=ServiceEventInfo.REQUEST_RECEIVED)
        receive(node, 'recorder/stop_recording/_service_event', StopRecording.Event(info=info, request=[request]))
    return node._on_stop(request, StopRecording.Response())


def measure(node, *balls):
    """Let a target and its answer arrive for each ball, at table position 1."""
    for ball in balls:
        common = {'run_id': 'run', 'seq': ball, 'table_position': 1, 'ball': ball}
        receive(node, 'probe_target', ProbeTarget(attempt=1, phase=3, balls=3, radius=0.1, **common))
        header = Header(stamp=Time(sec=ball), frame_id='table')
        receive(node, 'touches', Touches(header=header, x=[0.1, 0.2], **common))
        receive(node, 'ball_centre', BallCentre(header=header, **common))

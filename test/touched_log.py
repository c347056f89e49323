# SPDX-License-Identifier: Apache-2.0
"""The log of a run of the simulated machine with all its touches, written without a cell by what its nodes send."""

import os
from functools import cache

from rclpy.serialization import serialize_message
from rosette_msgs.msg import BallCentre

from rosette_ros.core.run.scheme import plan
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_writer import whole_log
from rosette_ros.io.messages import MACHINE_FRAME, TABLE_FRAME, Phase, Target
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import conversions
from rosette_ros.simulation import Machine

TYPES = {'/rosette/probe_target': 'rosette_msgs/msg/ProbeTarget', '/rosette/touches': 'rosette_msgs/msg/Touches',
         '/rosette/ball_centre': 'rosette_msgs/msg/BallCentre', '/tf_static': 'tf2_msgs/msg/TFMessage'}


@cache
def library():
    """Return the definitions of the installed messages."""
    return TypeLibrary.from_environment(os.environ)


def write_touched_log(folder, config, order='random', change=lambda answer, touches: touches):
    """Write the log of a complete run, one per folder, and return the readings; run_id: touched.

    change: makes of an answer and its touches what is published of the touches; None: nothing.
    """
    machine = Machine(config)
    scheme = plan(machine.n, order, 1)
    _, alignment, readings = machine.calibrate(scheme)
    places = alignment.frame.to_outer(scheme.centres(machine.radius))
    with whole_log(folder, folder.name) as writer:
        for topic, name in TYPES.items():
            writer.add_topic(topic, library().definition(name), (Qos(),))

        def write(topic, message, time):
            writer.write(topic, serialize_message(message), time, time)

        write('/tf_static', conversions.frame_message(
            alignment.frame, MACHINE_FRAME, TABLE_FRAME, conversions.time_message(0)), 0)
        for row in range(readings.size):
            one, asked, stamp = readings[row], row + 1, round(1e9 * readings.time[row])
            place = {'run_id': 'touched', 'seq': asked, 'table_position': one.table_position, 'ball': one.ball,
                     'cmm_position': (one.table_position + one.ball - 2) % machine.n + 1}
            target = Target(
                **place, attempt=1, session=1, phase=Phase.RUN, balls=machine.n, radius=machine.radius,
                table_angle=one.table_angle, approach=one.approach, centre=tuple(places[row]),
                frame_id=MACHINE_FRAME, stamp_ns=0)
            write('/rosette/probe_target', conversions.target_message(target, conversions.time_message(stamp - 1)),
                  stamp - 1)
            answer = BallCentre(**place)
            conversions.fill_answer(answer, one, conversions.time_message(stamp), MACHINE_FRAME)
            touches = change(answer, conversions.touches_message(
                answer, one.touch_point, one.touch_normal, one.touch_time - one.time, machine.pattern.tip))
            if touches is not None:
                write('/rosette/touches', touches, stamp)
            write('/rosette/ball_centre', answer, stamp)
    return readings

# SPDX-License-Identifier: Apache-2.0
"""The table corrector: publishes how a turning table really stands, by its angle and a correction file."""

import math
import sys
from functools import partial
from typing import Any

from geometry_msgs.msg import Point
from rosette_msgs.srv import CorrectPoint
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import InvalidConfig, InvalidData, plain
from rosette_ros.core.run.geometry import Frame, rotation_matrix
from rosette_ros.io.correction_file import read_correction
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.base_node import OK, WARN, CellNode, Health, run_node
from rosette_ros.nodes.conversions import frame_message

WANTED = (
    Wanted('correction', '', 'correction file (rosette correct RUN --for ros)', read_only=True),
    Wanted('joint', '', 'joint of the table in joint_states; empty: the only one', read_only=True),
    Wanted('sign', 1, 'sense in which the joint counts: 1 as the table of the run, -1 the other way', -1, 1,
           read_only=True),
    Wanted('zero_rad', 0.0, 'position of the joint where the table of the run is at angle 0, rad', -1e3, 1e3,
           read_only=True),
    Wanted('nominal_frame', 'table_nominal', 'frame of the ideal revolute joint, parent of corrected_frame',
           read_only=True),
    Wanted('corrected_frame', 'table_corrected', 'frame of the table as it stands', read_only=True))
LATE = 1.0
"""Without a joint state for so long the corrected frame is out of date, s."""


class TableCorrector(CellNode):
    """Publishes the pose of a table, with its errors, in the frame of its ideal joint.

        shift = R_z(-theta) c(theta),  rotation vector = R_z(-theta) r(theta),  theta = sign (position - zero_rad)

    Topics: subscribes to `joint_states` (sensor_msgs/JointState), publishes `/tf` with the stamp of each joint state.
    Service: `correct_point`. Parameters: WANTED. /diagnostics tells rate and latency, from the reception of a joint
    state to the end of its publication."""

    def __init__(self) -> None:
        super().__init__(names.TABLE_CORRECTOR, WANTED)
        if not self.parameters['correction']:
            raise InvalidConfig(f'{names.TABLE_CORRECTOR}: correction: expected a correction file (rosette correct RUN '
                                '--for ros), found none')
        if self.parameters['sign'] == 0:
            raise InvalidConfig(f'{names.TABLE_CORRECTOR}: sign: expected 1 or -1, found 0')
        self._correction, self._table = read_correction(self.parameters['correction'])
        self._joint, self._sign, self._zero, self._nominal, self._corrected = (
            self.parameters[name] for name in ('joint', 'sign', 'zero_rad', 'nominal_frame', 'corrected_frame'))
        self._angle, self._sense = math.nan, 1
        self._received, self._latencies = -math.inf, list[float]()
        self._refused = ''
        self._tf_out = self.create_publisher(TFMessage, names.TF, qos.TRANSFORMS)
        self.create_service(CorrectPoint, names.CORRECT_POINT, self._on_point)
        self.on(names.JOINT_STATES, JointState, self._on_joints, qos.JOINTS)

    def _on_joints(self, message: JointState) -> None:
        began = self.seconds()
        try:
            position = self._position(message)
        except InvalidData as error:
            if str(error) != self._refused:
                self._refused = str(error)
                self.get_logger().warning(self._refused)
            return
        angle = self._sign * (position - self._zero)
        if angle != self._angle and math.isfinite(self._angle):
            self._sense = 1 if angle > self._angle else -1
        self._angle, self._refused = angle, ''
        shift, turn = self._correction.pose(angle, self._sense)
        self._tf_out.publish(frame_message(Frame(rotation_matrix(turn), shift), self._nominal, self._corrected,
                                           message.header.stamp))
        self._received = self.seconds()
        self._latencies.append(self._received - began)

    def _position(self, message: JointState) -> float:
        """Return the position of the table's joint, rad; raises InvalidData where the message has none."""
        every = dict(zip(message.name, message.position))
        if not self._joint and len(every) > 1:
            raise InvalidData(f'joint_states: expected one joint, found {plain(", ".join(every))}; name that of the '
                              'table '
                              '(parameter joint)')
        position = every.get(self._joint, math.nan) if self._joint else next(iter(every.values()), math.nan)
        if not math.isfinite(position):
            raise InvalidData(f'joint_states: expected the position of joint {self._joint or "of the table"}, found '
                              f'{plain(", ".join(f"{name}: {value}" for name, value in every.items())) or "none"}')
        return position

    def _on_point(self, request: CorrectPoint.Request, response: CorrectPoint.Response) -> CorrectPoint.Response:
        point = (request.point.x, request.point.y, request.point.z)
        if not all(map(math.isfinite, (request.angle, *point))):
            response.message = f'expected a finite angle and point, found {request.angle:g} rad and {point}'
            return response
        x, y, z = map(float, self._correction.point(request.angle, point, -1 if request.sense < 0 else 1))
        response.success, response.corrected = True, Point(x=x, y=y, z=z)
        return response

    def health(self) -> Health:
        """Return rate and latency since the last time this was asked."""
        latencies, self._latencies = self._latencies, []
        values: dict[str, Any] = {'run_id': plain(self._correction.run_id), 'table': plain(self._table)}
        if self._refused:
            return WARN, self._refused, values
        if self.seconds() - self._received > LATE or not latencies:
            return WARN, f'no joint state for {LATE:g} s: {self._corrected} is out of date', values
        values |= {'rate_hz': len(latencies), 'latency_mean_ms': f'{1e3 * sum(latencies) / len(latencies):.3f}',
                   'latency_max_ms': f'{1e3 * max(latencies):.3f}'}
        return OK, f'correcting {len(latencies)} joint states a second', values


main = partial(run_node, names.TABLE_CORRECTOR, TableCorrector)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())

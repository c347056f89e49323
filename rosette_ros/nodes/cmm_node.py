# SPDX-License-Identifier: Apache-2.0
"""What every CMM node of this package has: targets in, answers and touches out, and how many there were."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from rclpy.duration import Duration
from rosette_msgs.msg import BallCentre, ProbeTarget, Touches
from rosette_msgs.srv import CheckPlan
from std_msgs.msg import Header

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.errors import CellError, InvalidPlan, RosetteError, one_line
from rosette_ros.core.geometry import Floats
from rosette_ros.io.messages import MACHINE_FRAME, short_frame
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import CellNode

_ROUND = 1e-6  # by which a unit vector may be off
FARTHEST = 100.0  # a centre that is farther from the origin of the machine is taken for a mistake, m


class CmmNode(CellNode, ABC):
    """A CMM of the cell. Topics: subscribes to `probe_target`; publishes `ball_centre` and `touches`. The service
    `cmm/check_plan` says of a whole plan whether it can be measured.

    measured, failed: how many targets were answered so."""

    def __init__(self, wanted: Sequence[Wanted]) -> None:
        super().__init__(names.CMM, wanted)
        self.measured = self.failed = 0
        # Before the topics: whoever finds those has to find the service, too, and DDS announces in this order.
        self.create_service(CheckPlan, names.CHECK_PLAN, self._on_check_plan)
        self.on(names.PROBE_TARGET, ProbeTarget, self.on_target, qos.ORDER)
        self.answers = self.create_publisher(BallCentre, names.BALL_CENTRE, qos.ANSWER)
        self.touches = self.create_publisher(Touches, names.TOUCHES, qos.ANSWER)

    @abstractmethod
    def check_plan(self, targets: Sequence[ProbeTarget]) -> None:
        """Raise RosetteError where these targets, in this order, cannot all be measured, as far as is known."""

    def _on_check_plan(self, request: CheckPlan.Request, response: CheckPlan.Response) -> CheckPlan.Response:
        try:
            self.check_plan(request.targets)
        except RosetteError as error:
            response.message = one_line(error)
        response.success = not response.message
        return response

    @abstractmethod
    def on_target(self, target: ProbeTarget) -> None:
        """Measure the ball of a target."""

    def aim_of(self, target: ProbeTarget) -> tuple[Floats, Floats]:
        """Return where a ball is expected, (3,), m, and its pole, (3,), 0, 0, 0 for none; raises CellError."""
        if short_frame(target.header.frame_id) != MACHINE_FRAME:
            raise CellError(f'wanted a target in the frame {MACHINE_FRAME!r}, got {target.header.frame_id!r}')
        aim, pole = conversions.point_array(target.centre), conversions.point_array(target.pole)
        if not (abs(aim) < FARTHEST).all():
            raise CellError(f'wanted a target within {FARTHEST:g} m, got the centre {tuple(aim.tolist())}')
        if pole.any() and not abs(np.linalg.norm(pole) - 1) < _ROUND:
            raise CellError(f'wanted a pole of length 1, or 0, 0, 0, got {tuple(pole.tolist())}')
        return aim, pole

    def answer_to(self, target: ProbeTarget) -> BallCentre:
        """Return an answer with the identity of its target."""
        return BallCentre(run_id=target.run_id, seq=target.seq, table_position=target.table_position, ball=target.ball,
                          cmm_position=target.cmm_position)

    def refuse(self, target: ProbeTarget, error: RosetteError, stamp: TimeMessage) -> BallCentre:
        """Return the answer to a target that was not measured, and count it."""
        self.failed += 1
        self.get_logger().warning(f'seq {target.seq}: {error}')
        answer = self.answer_to(target)
        is_final = isinstance(error, InvalidPlan)
        answer.status = BallCentre.STATUS_REFUSED if is_final else BallCentre.STATUS_FAILED
        answer.text = str(error)
        answer.header = Header(stamp=stamp, frame_id=target.header.frame_id)
        return answer

    def finish(self) -> None:
        """End once all subscribers have the answers: nobody could send them again what was lost in transport."""
        for publisher in (self.touches, self.answers):
            publisher.wait_for_all_acked(Duration(seconds=5))

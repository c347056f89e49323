# SPDX-License-Identifier: Apache-2.0
"""What every CMM node of this package has: targets in, answers and touches out, and how many there were."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from concurrent.futures import Future as ThreadFuture
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from rclpy.duration import Duration
from rclpy.task import Future
from rosette_msgs.msg import BallCentre, ProbeTarget, RunState, Touches
from rosette_msgs.srv import CheckPlan
from std_msgs.msg import Header

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import CellError, InvalidPlan, RosetteError, one_line
from rosette_ros.core.run.geometry import Floats
from rosette_ros.io.messages import MACHINE_FRAME, Phase, short_frame
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import CellNode
from rosette_ros.nodes.interfaces import run_task, waiting_service

T = TypeVar('T')
_ROUND = 1e-6  # by which a unit vector may be off
FARTHEST = 100.0  # a centre that is farther from the origin of the machine is taken for a mistake, m


class CmmNode(CellNode, ABC):
    """A CMM of the cell. Topics: subscribes to `probe_target` and `run_state`; publishes `ball_centre` and `touches`.
    The service `cmm/check_plan` says of a whole plan whether it can be measured.

    It obeys one process: while two publish targets it takes none, and says so. A sequencer whose state is that nothing
    is measured is none of two: `rosette check-cmm` may ask beside it.

    measured, failed: how many targets were answered so."""

    def __init__(self, wanted: Sequence[Wanted]) -> None:
        super().__init__(names.CMM, wanted)
        self.measured = self.failed = 0
        self._aside = ThreadPoolExecutor(1, 'aside')
        self._state = RunState(phase=RunState.PHASE_REPEATABILITY)
        # Before the topics: whoever finds those has to find the service, too, and DDS announces in this order.
        waiting_service(self, CheckPlan, names.CHECK_PLAN, self._on_check_plan)
        self.requesters, self._sequencer = self.publishers_of(names.PROBE_TARGET), self.monitor(names.SEQUENCER)
        self.requesters.is_idle = self._is_idle
        self.on(names.RUN_STATE, RunState, self.on_state, qos.STATE, from_one=True)
        self.on(names.PROBE_TARGET, ProbeTarget, self.on_target, qos.ORDER, from_one=True)
        self.answers = self.create_publisher(BallCentre, names.BALL_CENTRE, qos.ANSWER)
        self.touches = self.create_publisher(Touches, names.TOUCHES, qos.ANSWER)

    @abstractmethod
    def check_plan(self, targets: Sequence[ProbeTarget]) -> None:
        """Raise RosetteError where these targets, in this order, cannot all be measured, as far as is known."""

    async def ended(self, work: 'ThreadFuture[T]', timeout: float = 0.0) -> bool:
        """Wait, while other callbacks run, for the end of what another thread does; return whether it has ended.

        timeout: s, 0 for none."""
        waited = Future()
        work.add_done_callback(lambda _: run_task(self, lambda: waited.set_result(None)))
        if timeout:
            self.after(timeout, lambda: waited.set_result(None))
        await waited
        return work.done()

    async def _on_check_plan(self, request: CheckPlan.Request, response: CheckPlan.Response) -> CheckPlan.Response:
        work = self._aside.submit(self.check_plan, request.targets)
        await self.ended(work)
        try:
            work.result()
        except RosetteError as error:
            response.message = one_line(error)
        response.success = not response.message
        return response

    def on_state(self, state: RunState) -> None:
        """Take note of what the sequencer does."""
        self._state = state
        self.requesters.look()

    def is_state_of(self, endpoints: Iterable[bytes]) -> bool:
        """Return whether the process that has one of these endpoints (GIDs) publishes the state of the run."""
        return any(map(self._sequencer.is_of, endpoints))

    def _is_idle(self, gid: bytes) -> bool:
        """Return whether a publisher of targets is of a sequencer that measures nothing."""
        return self._state.phase in (Phase.IDLE, Phase.DONE, Phase.CANCELLED, Phase.FAILED) and self.is_state_of([gid])

    @abstractmethod
    def on_target(self, target: ProbeTarget) -> None:
        """Measure the ball of a target."""

    def aim_of(self, target: ProbeTarget) -> tuple[Floats, Floats]:
        """Return where a ball is expected, (3,), m, and its pole, (3,), 0, 0, 0 for none; raises CellError."""
        if short_frame(target.header.frame_id) != MACHINE_FRAME:
            raise CellError(f'expected a target in the frame {MACHINE_FRAME!r}, found {target.header.frame_id!r}')
        aim, pole = conversions.point_array(target.centre), conversions.point_array(target.pole)
        if not (abs(aim) < FARTHEST).all():
            raise CellError(f'expected a target within {FARTHEST:g} m, found the centre {tuple(aim.tolist())}')
        if pole.any() and not abs(np.linalg.norm(pole) - 1) < _ROUND:
            raise CellError(f'expected a pole of length 1, or 0, 0, 0, found {tuple(pole.tolist())}')
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
        self._aside.shutdown(cancel_futures=True)
        for publisher in (self.touches, self.answers):
            publisher.wait_for_all_acked(Duration(seconds=5))

# SPDX-License-Identifier: Apache-2.0
"""Before a run begins the CMM is asked whether it can measure the whole plan, where it offers to say so."""

from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING

from rclpy.task import Future
from rosette_msgs.msg import ProbeTarget
from rosette_msgs.srv import CheckPlan

from rosette_ros.calibration.state_machine import Sequence
from rosette_ros.core.errors import CellError, plain
from rosette_ros.io.messages import MACHINE_FRAME
from rosette_ros.nodes import conversions, names

if TYPE_CHECKING:
    from rosette_ros.nodes.base_node import CellNode

TIMEOUT = 30.0  # for the answer, s; the ways around 72 balls at all table positions take some seconds
AT_ONCE = 1000  # targets that are made at a time, between which the node answers others


class PlanCheck:
    """The question to the CMM, once for each run."""

    def __init__(self, node: 'CellNode') -> None:
        self._node = node
        self._client = node.create_client(CheckPlan, names.CHECK_PLAN)
        self._run_id, self._sent = '', 0.0
        self._targets: Iterator[ProbeTarget] | None = None
        self._question = CheckPlan.Request()
        self._answer: Future | None = None

    @property
    def is_asking(self) -> bool:
        """Whether the question is made, or its answer is awaited."""
        return self._targets is not None or (self._answer is not None and not self._answer.done())

    def is_passed(self, sequence: Sequence, now: float) -> bool:
        """Return whether the CMM takes the plan, or does not offer to say so; False while it is asked.

        now: steady time, s. Raises CellError where it does not, in its words."""
        if self._run_id != sequence.run_id:
            self._run_id, self._question, self._targets, self._answer = sequence.run_id, CheckPlan.Request(), None, None
            if self._client.service_is_ready():
                self._targets = self._targets_of(sequence)
        if self._targets is not None:
            more = list(islice(self._targets, AT_ONCE))
            self._question.targets.extend(more)
            if len(more) == AT_ONCE:
                return False
            self._targets, self._sent, self._answer = None, now, self._client.call_async(self._question)
        if self._answer is None:
            return True
        if not self._answer.done():
            if now > self._sent + TIMEOUT:
                self._client.remove_pending_request(self._answer)
                raise CellError(f'the CMM did not say within {TIMEOUT:g} s whether it can measure this plan')
            return False
        answer = self._answer.result()
        if not answer.success:
            raise CellError(f'the CMM cannot measure this plan: {plain(answer.message, most=2000)}')
        return True

    def _targets_of(self, sequence: Sequence) -> Iterator[ProbeTarget]:
        plan, stamp = sequence.plan, self._node.now().to_msg()
        for index in range(plan.total):
            target = plan.placed(plan.target(index), plan.taught, MACHINE_FRAME)
            yield conversions.target_message(target._replace(run_id=sequence.run_id), stamp)

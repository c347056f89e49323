# SPDX-License-Identifier: Apache-2.0
"""A CMM of your own: a function that measures one ball becomes a node of the cell (docs/interfaces.md)."""

import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from math import nan
from typing import NoReturn

from rclpy.time import Time
from rosette_msgs.msg import ProbeTarget
from std_msgs.msg import Header

from rosette_ros.core.run.errors import CellError, InvalidPlan, RosetteError
from rosette_ros.core.run.geometry import travel_to
from rosette_ros.io.messages import MACHINE_FRAME
from rosette_ros.nodes import conversions, names
from rosette_ros.nodes.base_node import OK, WARN, Health, run_node
from rosette_ros.nodes.cmm_node import CmmNode


@dataclass(frozen=True)
class Probed:
    """A ball as a CMM measured it.

    centre: of the fitted sphere, m, in the machine frame; stamp: mean time of the touches, s since the epoch, None for
    the time of the answer; table_angle: of the encoder, rad, None where it is as asked; form_error: m; temperature: °C
    at the plate, NaN where it is not known."""

    centre: Sequence[float]
    stamp: float | None = None
    table_angle: float | None = None
    form_error: float = 0.0
    temperature: float = nan


Measure = Callable[[ProbeTarget], Probed]
"""Turns the table to `table_angle` in the sense of `approach` (0: no move) and probes the ball that is expected at
`centre`; any exception is answered as a failure in its words, and the target is asked for again."""
Check = Callable[[Sequence[ProbeTarget]], None]
"""Raises an exception where a whole plan cannot be measured; nothing moves."""


class OwnCmm(CmmNode):
    """A CMM whose balls a function measures, one after the other, in a thread of its own; the node answers meanwhile.

    How far and in which sense the table has turned is counted from what was asked."""

    def __init__(self, measure: Measure, check: Check = lambda targets: None) -> None:
        super().__init__(())
        self._measure, self._check, self._worker = measure, check, ThreadPoolExecutor(1, 'measure')
        self._travel, self._sense, self._busy_since = 0.0, 0, 0.0

    def check_plan(self, targets: Sequence[ProbeTarget]) -> None:
        """Ask the function for whole plans."""
        try:
            self._check(targets)
        except Exception as error:
            raise InvalidPlan(str(error) or type(error).__name__) from error

    def on_target(self, target: ProbeTarget) -> None:
        """Have the ball measured; targets wait for each other."""
        self._worker.submit(self._do, target)

    def _do(self, target: ProbeTarget) -> None:
        self._busy_since = time.monotonic()
        try:
            probed = self._measure(target)
            self._travel = travel_to(self._travel, target.table_angle, target.approach)
            self._sense = target.approach or self._sense
            answer = self.answer_to(target)
            x, y, z = map(float, probed.centre)
        except Exception as error:
            failure = error if isinstance(error, RosetteError) else CellError(str(error) or type(error).__name__)
            self.answers.publish(self.refuse(target, failure, self.now().to_msg()))
            return
        finally:
            self._busy_since = 0.0
        stamp = self.now() if probed.stamp is None else Time(nanoseconds=round(1e9 * probed.stamp))
        answer.header, answer.status = Header(stamp=stamp.to_msg(), frame_id=MACHINE_FRAME), answer.STATUS_OK
        answer.centre = conversions.point((x, y, z))
        answer.table_angle = target.table_angle if probed.table_angle is None else probed.table_angle
        answer.table_travel, answer.approach = self._travel, self._sense
        answer.form_error, answer.temperature = probed.form_error, probed.temperature
        self.measured += 1
        self.answers.publish(answer)

    def health(self) -> Health:
        """Return what was measured, and since when the function is at work."""
        since = self._busy_since
        return (WARN if self.failed else OK, f'{self.measured} balls measured, {self.failed} targets failed',
                {'measured': self.measured, 'failed': self.failed,
                 'busy_s': f'{time.monotonic() - since:.1f}' if since else '0.0'})

    def finish(self) -> None:
        """End after the ball that is being measured."""
        self._worker.shutdown(cancel_futures=True)
        super().finish()


def run_cmm(measure: Measure, check: Check = lambda targets: None) -> NoReturn:
    """Run a CMM node until SIGINT or SIGTERM, and leave with its exit code; arguments as of ROS (--ros-args ...)."""
    sys.exit(run_node(names.CMM, partial(OwnCmm, measure, check)))

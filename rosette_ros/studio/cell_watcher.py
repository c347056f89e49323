# SPDX-License-Identifier: Apache-2.0
"""Receives what a running cell publishes, in a thread of its own, and requests calibrations in another."""

import os
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rosette_msgs.msg import BallCentre, Diagnosis, ErrorMotions, ProbeTarget, RunState
from tf2_msgs.msg import TFMessage

from rosette_ros.cell.client import CalibrationOutcome, CellClient, GraphClient
from rosette_ros.core.run.errors import CellError, RosetteError, one_line, plain
from rosette_ros.io.messages import answer_of, progress_of, table_frame_of, target_of, verdict_of
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import make_executor
from rosette_ros.studio.live_state import CellState, Health

TOPICS = (
    (names.RUN_STATE, RunState, qos.COLLECT_LATCHED), (names.PROBE_TARGET, ProbeTarget, qos.COLLECT_LATCHED),
    (names.TF_STATIC, TFMessage, qos.COLLECT_LATCHED), (names.BALL_CENTRE, BallCentre, qos.COLLECT),
    (names.ERROR_MOTIONS, ErrorMotions, qos.COLLECT_LATCHED), (names.DIAGNOSIS, Diagnosis, qos.COLLECT_LATCHED),
    (names.ROSOUT, Log, qos.COLLECT_LATCHED), (names.DIAGNOSTICS, DiagnosticArray, qos.COLLECT))


class CellWatcher(GraphClient):
    """Subscribes to the topics of a cell and can calibrate it; `lock` guards `state`.

    outcome, problem: of the last calibration requested here, None and '' before. Raises CellError where the domain
    (None: that of the environment) cannot be joined.
    """

    def __init__(self, domain_id: int | None = None, namespace: str = names.NAMESPACE) -> None:
        domain = os.environ.get('ROS_DOMAIN_ID') or 0 if domain_id is None else domain_id
        if str(domain) not in map(str, names.DOMAINS):
            raise CellError(f'studio: ROS domain: expected a whole number from 0 to {names.DOMAINS[-1]}, found '
                            f'{domain}')
        self.lock, self.state = threading.Lock(), CellState()
        self.outcome: CalibrationOutcome | None = None
        self.problem = ''
        self._cell, self._requests = (domain_id, namespace), ThreadPoolExecutor(1, 'calibrate')
        self._cancel = threading.Event()
        self._job: Future[None] | None = None
        super().__init__('studio', domain_id, namespace, make_executor,
                         cli_args=['--ros-args', *names.remap_arguments(names.remappings(namespace))])
        for topic, kind, profile in TOPICS:
            resolved = self._node.resolve_topic_name(topic)
            self._node.create_subscription(kind, topic, partial(self._receive, resolved), profile)
        self.spin_beside('cell watcher')

    def close(self) -> None:
        """Leave the graph; a calibration that was requested here is cancelled."""
        self._cancel.set()
        self._requests.shutdown(wait=True)
        super().close()

    # Calibrations

    @property
    def is_calibrating(self) -> bool:
        """Whether a calibration that was requested here is running."""
        return self._job is not None and not self._job.done()

    def calibrate(self, **goal: Any) -> None:
        """Request a calibration; goal: as of CellClient.calibrate; how it ends is kept in `outcome` or `problem`."""
        if not self.is_calibrating:
            self._cancel.clear()
            self.outcome, self.problem = None, ''
            self._job = self._requests.submit(self._calibrate, goal)

    def cancel(self) -> None:
        """Cancel the calibration that was requested here."""
        self._cancel.set()

    def _calibrate(self, goal: dict[str, Any]) -> None:
        is_accepted = is_cancelled = False

        def on_progress(_: object) -> None:
            nonlocal is_accepted
            is_accepted = True

        def check() -> None:
            nonlocal is_cancelled
            if self._cancel.is_set() and is_accepted and not is_cancelled:
                is_cancelled = True
                raise KeyboardInterrupt  # the client cancels and waits for the clean end

        try:
            with CellClient(*self._cell) as client:
                self.outcome = client.calibrate(**goal, on_progress=on_progress, check=check)
        except (RosetteError, TimeoutError) as error:
            self.problem = one_line(error)

    # Subscriptions

    def _receive(self, topic: str, message: Any) -> None:
        with self.lock:
            try:
                self._take(message)
            except RosetteError as error:
                self.state.add_fault(_clock(), f'{topic}: not used: {error}')

    def _take(self, message: Any) -> None:
        """Put what a message states into `state`; Any: messages of rclpy have no types."""
        state = self.state
        match message:
            case ProbeTarget():
                state.add_target(target_of(message))
            case BallCentre():
                state.add_answer(answer_of(message))
            case RunState():
                state.progress = progress_of(message)
            case TFMessage():
                for frame in filter(None, map(table_frame_of, message.transforms)):
                    state.add_frame(frame)
            case ErrorMotions():
                state.set_motions(conversions.published_motions(message))
            case Diagnosis():
                state.set_verdict(message.run_id, verdict_of(message))
            case Log() if message.level >= LoggingSeverity.WARN and names.is_of_cell(message.name, self._where):
                kind = Health.FAULT if message.level >= LoggingSeverity.ERROR else Health.WARNING
                state.add_fault(_clock(), f'{message.name.rsplit(".", 1)[-1]}: {plain(message.msg)}', kind)
            case DiagnosticArray():
                for one in message.status:
                    if one.hardware_id == self._node.get_namespace().lstrip('/'):
                        level = one.level[0] if isinstance(one.level, bytes) else int(one.level)
                        state.set_health(one.name.rsplit('/', 1)[-1], level, one.message, time.monotonic())


def _clock() -> str:
    return time.strftime('%H:%M:%S')

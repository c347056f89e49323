# SPDX-License-Identifier: Apache-2.0
"""A client of a running cell: asks for a calibration, shows progress, cancels on Ctrl-C."""

import os
import signal
import threading
import time
import uuid
from dataclasses import dataclass, replace
from pathlib import Path

import yaml
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, Diagnosis, RunState
from std_srvs.srv import Trigger

from rosette_ros.core.errors import CellError
from rosette_ros.core.records import ErrorMotions
from rosette_ros.data.plain_yaml import load_plain
from rosette_ros.nodes import convert, environment, names, qos
from rosette_ros.nodes.introspection import introspected_client
from rosette_ros.nodes.programme import Phase
from rosette_ros.nodes.settings import RESUME

CANCEL_TIMEOUT = 30.0
RESUME_TIMEOUT = 90.0
"""A sequencer has the recorder read in the log of a run before it accepts to resume it, s."""
_STEP = 0.1
_WORDS_TIMEOUT = 2.0
_GONE = 3.0
"""A sequencer that is not on the graph for so long has gone, s."""


@dataclass(frozen=True)
class Progress:
    """Where a calibration stands."""

    run_id: str
    phase: Phase
    order: str
    done: int
    total: int
    text: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """How a calibration has ended; error_motions: core record, None without success; verdict: what its
    diagnosis says, '' where there was none."""

    success: bool
    cancelled: bool
    message: str
    run_id: str
    log: Path | None
    error_motions: ErrorMotions | None
    verdict: str = ''


class _Interrupt:
    """Takes SIGINT while a calibration is on: an exception in the middle of rclpy would break it.

    A second one acts as usual. Outside the main thread nothing is taken.
    """

    def __init__(self):
        self.came = False

    def __enter__(self):
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._take)
        else:
            self._before = None
        return self

    def __exit__(self, *_):
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _take(self, number, frame):
        self.came = True
        signal.signal(signal.SIGINT, self._before)


class CellClient:
    """Talks to the sequencer of a cell; a context manager.

    domain_id: ROS domain, None for that of the environment; namespace: of the cell.
    """

    def __init__(self, domain_id=None, namespace=names.NAMESPACE):
        """Join the graph; only cells on this computer are seen unless the environment says so."""
        os.environ.update(environment.added(os.environ))
        self._where, self._domain_id = f'/{namespace.strip("/")}', domain_id
        self._context = Context()
        self._context.init(domain_id=domain_id)
        self._node = Node(f'client_{uuid.uuid4().hex[:8]}', namespace=self._where, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._rejections = []
        self._node.create_subscription(CalibrationEvent, names.CALIBRATION_EVENT,
                                       self._on_event, qos.EVENT)
        self._run_id, self._is_anew, self._has_state = '', False, False
        self._verdicts = {}
        self._node.create_subscription(Diagnosis, names.DIAGNOSIS, self._on_diagnosis, qos.RESULT)
        self._node.create_subscription(RunState, names.RUN_STATE, self._on_state, qos.STATE)
        self._action = ActionClient(self._node, Calibrate, names.CALIBRATE)
        self._start, self._cancel = (introspected_client(self._node, Trigger, name)
                                     for name in (names.START_CALIBRATION, names.CANCEL_CALIBRATION))

    def __enter__(self):
        """Return the client."""
        return self

    def __exit__(self, *_):
        """Leave the graph."""
        self.close()

    def close(self):
        """Leave the graph."""
        self._executor.shutdown()
        self._action.destroy()
        self._node.destroy_node()
        self._context.try_shutdown()

    def wait(self, timeout=10.0):
        """Wait for a sequencer; raises CellError where none answers in time."""
        deadline = time.monotonic() + timeout
        while not (self._action.server_is_ready() and self._is_heard()):
            if time.monotonic() > deadline:
                raise CellError(f'cell {self._where}: wanted a sequencer within {timeout:g} s, '
                                f'got none; start the cell, check namespace and ROS_DOMAIN_ID')
            self._executor.spin_once(timeout_sec=_STEP)

    def calibrate(self, order='', seed=0, options='', on_progress=None, check=None,
                  timeout=None, resume=''):
        """Run a calibration to its end and return its Outcome.

        order: '' as configured; options: YAML mapping; on_progress: called with Progress; check:
        called now and then, may raise (a cell's own check); timeout: s, after which the calibration
        is cancelled; resume: the log of a run to go on with, its name or path, '' for a new run.
        KeyboardInterrupt cancels the calibration and waits for its clean end.

        Raises CellError where the sequencer is not there, refuses, or goes away.
        """
        self.wait()
        self._rejections.clear()
        self._run_id, self._is_anew = '', False

        def on_feedback(message):
            if on_progress and message.feedback.state.phase in list(Phase):
                on_progress(progress_of(message.feedback.state))

        goal = Calibrate.Goal(order=order, seed=seed, options=_with_resume(options, resume))
        handle = self._await(self._action.send_goal_async(goal, feedback_callback=on_feedback),
                             RESUME_TIMEOUT if resume else 10.0, check)
        if not handle.accepted:
            raise CellError(f'cell {self._where}: calibration refused: {self._reason()}')
        result = handle.get_result_async()
        with _Interrupt() as interrupt:
            try:
                response = self._await(result, timeout, check, interrupt)
            except (KeyboardInterrupt, TimeoutError):
                handle.cancel_goal_async()
                response = self._await(result, CANCEL_TIMEOUT, check)
        outcome = outcome_of(response)
        return replace(outcome, verdict=self._verdicts.get(outcome.run_id, ''))

    def start(self):
        """Start the configured calibration by the plain service; return (started, words)."""
        return self._trigger(self._start)

    def cancel(self):
        """Cancel the calibration that is on, whoever has asked for it; return (cancelled, words)."""
        return self._trigger(self._cancel)

    def _trigger(self, client):
        deadline = time.monotonic() + 10.0
        while not client.service_is_ready():
            if time.monotonic() > deadline:
                raise CellError(f'cell {self._where}: wanted the service {client.srv_name}, got none; start the '
                                'cell')
            self._executor.spin_once(timeout_sec=_STEP)
        response = self._await(client.call_async(Trigger.Request()), 10.0, None)
        return response.success, response.message

    def _await(self, future, timeout, check, interrupt=None):
        began = seen = time.monotonic()
        while not future.done():
            self._executor.spin_once(timeout_sec=_STEP)
            if check:
                check()
            if interrupt and interrupt.came:
                raise KeyboardInterrupt
            now = time.monotonic()
            seen = now if self._action.server_is_ready() else seen
            if now - seen > _GONE or (interrupt and self._is_anew):
                has = 'was started anew' if self._is_anew else 'has gone'
                raise CellError(f'cell {self._where}: the sequencer {has}; what was measured '
                                f'is in the log{self._hint()}')
            if timeout is not None and now - began > timeout:
                raise TimeoutError(f'cell {self._where}: no answer within {timeout:g} s')
        return future.result()

    def _hint(self):
        return f', go on with: {self.resume_command(self._run_id)}' if self._run_id else ''

    def resume_command(self, run):
        """Return the command that goes on with a run of this cell."""
        domain = '' if self._domain_id is None else f' --domain {self._domain_id}'
        namespace = '' if self._where == f'/{names.NAMESPACE}' else f' --namespace {self._where[1:]}'
        return f'rosette calibrate --resume {run}{domain}{namespace}'

    def _on_diagnosis(self, message):
        self._verdicts = {message.run_id: message.verdict}

    def _on_state(self, state):
        """A sequencer that says that nothing is on while a calibration of it is on, is another one."""
        self._has_state = True
        if state.phase == Phase.IDLE:
            self._is_anew = True

    def _reason(self):
        """Return why the goal was rejected: the action says no more than that it was."""
        deadline = time.monotonic() + _WORDS_TIMEOUT
        while not self._rejections and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=_STEP)
        return self._rejections[-1] if self._rejections else 'see the log of the sequencer'

    def _is_heard(self):
        return self._has_state and self._node.count_publishers(names.CALIBRATION_EVENT) > 0

    def _on_event(self, event):
        if event.kind == CalibrationEvent.REJECTED and event.origin == names.CALIBRATE:
            self._rejections.append(event.text)
        elif event.kind == CalibrationEvent.ACCEPTED:
            self._run_id = event.run_id


def _with_resume(options, resume):
    """Return the options of a goal, YAML, with the log to go on from; what is no mapping stays as it is."""
    if not resume:
        return options
    try:
        given = load_plain(options) or {}
    except yaml.YAMLError:
        return options
    if not isinstance(given, dict):
        return options
    return yaml.safe_dump({**given, RESUME.name: resume}, sort_keys=False)


def progress_of(state):
    """Return the Progress of a RunState message."""
    return Progress(state.run_id, Phase(state.phase), state.order, state.done, state.total,
                    state.text)


def outcome_of(response):
    """Return the Outcome of a calibrate result with its status."""
    result = response.result
    motions = convert.error_motions_record(result.error_motions) if result.success else None
    return Outcome(
        success=result.success, cancelled=response.status == GoalStatus.STATUS_CANCELED,
        message=result.message, run_id=result.run_id,
        log=Path(result.log) if result.log else None, error_motions=motions)

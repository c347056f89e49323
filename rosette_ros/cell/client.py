# SPDX-License-Identifier: Apache-2.0
"""Clients of a running cell: one that joins its graph; one that asks for a calibration, and cancels on Ctrl-C."""

import os
import signal
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from action_msgs.msg import GoalStatus
from rcl_interfaces.msg import Log
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import ErrorMotions as ErrorMotionsMessage
from rosette_msgs.msg import RunState
from std_srvs.srv import Trigger

from rosette_ros.calibration.settings import NONE
from rosette_ros.cell.supervisor import Cell, added_environment, check_messages
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.run.errors import CellError, plain
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.invocation import command
from rosette_ros.io.messages import CalibrationProgress, Phase, progress_of, verdict_of
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import TakenSignals, make_executor
from rosette_ros.nodes.environment import check_environment
from rosette_ros.nodes.graph_node import GraphNode
from rosette_ros.nodes.liveliness import NodeMonitors, ServiceServers, started
from rosette_ros.nodes.log_session import run_of
from rosette_ros.nodes.node_requests import RESTART

CANCEL_TIMEOUT = 30.0
RECOVERY = 40.0  # a CMM that clears its errors or connects anew answers within this time, s
SEARCH = 3.5  # how long nodes of a cell are searched: one that was not found at once is found within 3 s, s
FOUND = 1.0  # likewise, where they have had time to be found, s
RESUME_TIMEOUT = 90.0  # a sequencer has the recorder read in the log of a run before it accepts to resume it, s
_STEP = 0.1
_DISCONNECTED = 3.0  # a sequencer that is not on the graph for so long is taken to be disconnected, s
_RETURN = 20.0  # likewise in the middle of a run: a cell that was suspended is found again within some seconds, s
_LOG_TOLD = 3.0  # a recorder tells the log that it writes within this time, s


@dataclass(frozen=True, eq=False)
class CalibrationOutcome:
    """How a calibration has ended; error_motions: the result, None without success; verdict: of the diagnosis of the
    run, None where there was none; is_joint: whether the run was evaluated as one with others; which: of the curves
    the result is; paused: whether the plan has a pause here, after which the run is to be resumed."""

    success: bool
    cancelled: bool
    message: str
    run_id: str
    log: Path | None
    error_motions: ErrorMotions | None
    verdict: VerdictText | None = None
    is_joint: bool = False
    which: str = ''
    paused: bool = False


class GraphClient:
    """A node beside those of the cell, with a context and an executor of its own; a context manager.

    domain_id: ROS domain, None for that of the environment; namespace: of the cell; settings: of the Node. Only cells
    on this computer are seen unless the environment says so. Raises CellError where the graph cannot be joined."""

    def __init__(self, name: str, domain_id: int | None, namespace: str,
                 make_executor: Callable[..., Executor] = SingleThreadedExecutor, **settings: Any) -> None:
        check_messages()
        check_environment(domain_id)
        os.environ.update(added_environment(os.environ))
        self._where, self._context = f'/{namespace.strip("/")}', Context()
        try:
            self._context.init(domain_id=domain_id)
            unique = f'{name}_{uuid.uuid4().hex[:8]}'
            self._node = GraphNode(unique, namespace=self._where, context=self._context, **settings)
        except (NameValidationException, RuntimeError, ValueError) as error:
            self._context.try_shutdown()
            where = f'domain {domain_id}, namespace {namespace!r}'
            raise CellError(f'{name}: {where}: cannot be joined: {error}') from error
        self._executor = make_executor(context=self._context)
        self._executor.add_node(self._node)
        self._is_closed = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._is_closed.set()
        if self._thread is not None:
            self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def spin_beside(self, name: str, then: Callable[[], object] = lambda: None) -> None:
        """Run callbacks, and `then` after each, in a thread of its own until `close`.

        It ends with the main thread, too: one that is still within rclpy while Python ends aborts the process."""

        def spin() -> None:
            while threading.main_thread().is_alive() and not self._is_closed.is_set():
                self._executor.spin_once(timeout_sec=_STEP)
                then()

        self._thread = threading.Thread(target=spin, name=name)
        self._thread.start()

    def _spin_until(self, condition: Callable[[], Any], timeout: float) -> Any:
        """Run callbacks until the condition holds, at most for `timeout` s; return what it returned last."""
        deadline = time.monotonic() + timeout
        while not (found := condition()) and (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(_STEP, left))
        return found


class CellClient(GraphClient):
    """Talks to the sequencer of a cell. After a restart of the sequencer, make a new one: until DDS drops what was
    killed, requests of the old one may go there.

    name: of its node, before what is drawn at the start; the policy of SROS2 has a profile for it."""

    name = 'client'

    def __init__(self, domain_id: int | None = None, namespace: str = names.NAMESPACE) -> None:
        super().__init__(self.name, domain_id, namespace)
        self._run_id, self._done_words, self._is_restarted, self._has_state = '', '', False, False
        self._motions = ErrorMotionsMessage()
        self._progress = CalibrationProgress()
        self._on_warning: Callable[[str], object] | None = None
        self._node.create_subscription(Log, names.ROSOUT, self._on_log, qos.EVENT)
        self._node.create_subscription(ErrorMotionsMessage, names.ERROR_MOTIONS, self._on_motions, qos.RESULT)
        self._action = ActionClient(self._node, Calibrate, names.CALIBRATE)
        # The last one: DDS announces subscriptions in their order, so a sequencer whose state is received knows those
        # of feedback and events, too.
        self._monitors = NodeMonitors(self._node)
        self._sequencer, self._recorder = map(self._monitors.of, (names.SEQUENCER, names.RECORDER))
        self._sequencer.on_change = self._on_restart
        self._servers = ServiceServers(self._node, f'{names.CALIBRATE}/_action/send_goal', self._sequencer)
        self._node.create_subscription(RunState, names.RUN_STATE, self._on_state, qos.STATE)
        self._node.create_timer(_STEP, self._monitors.watch)

    def close(self) -> None:
        """Leave the graph."""
        self._action.destroy()
        super().close()

    def wait(self, timeout: float = 10.0) -> None:
        """Wait for a sequencer; raises CellError where none answers in time."""
        if not self._spin_until(lambda: self._action.server_is_ready() and self._has_state, timeout):
            others = ', '.join(self.running(FOUND))
            raise CellError(f'cell {self._where}: expected a sequencer within {timeout:g} s, found ' + (
                f'only {others}: the sequencer is not started, has ended or hangs; {RESTART}' if others else
                'none; start the cell, check namespace and ROS_DOMAIN_ID'))

    def running(self, patience: float = SEARCH) -> list[str]:
        """Return which nodes of a cell are found within `patience`, s."""
        monitors = [self._monitors.of(name) for name in names.NODES]
        self._spin_until(lambda: all(monitor.count() for monitor in monitors), patience)
        return [monitor.peer for monitor in monitors if monitor.count()]

    def recover(self) -> str:
        """Tell a CMM that a person has looked, and return its answer; raises CellError where it is not ready."""
        service = self._node.create_client(Trigger, names.RECOVER)
        cmm = self._monitors.of(names.CMM)
        servers = ServiceServers(self._node, names.RECOVER, cmm)
        self._spin_until(lambda: service.service_is_ready() and cmm.process, SEARCH)
        if not service.service_is_ready():
            raise CellError(f'cell {self._where}: expected a CMM with the service {names.RECOVER}, found none; only '
                            'one '
                            'through I++ DME has it')
        _refuse_stranger(servers, self._where)
        answer = service.call_async(Trigger.Request())
        if not self._spin_until(answer.done, RECOVERY):
            raise CellError(f'cell {self._where}: expected an answer of the CMM within {RECOVERY:g} s, found none; '
                            'see its '
                            'output and /diagnostics')
        _refuse_stranger(servers, self._where)
        if not answer.result().success:
            raise CellError(f'cell {self._where}: {plain(answer.result().message)}')
        return plain(answer.result().message)

    def calibrate(
            self, order: str = '', seed: int = 0, options: str = '',
            on_progress: Callable[[CalibrationProgress], object] | None = None,
            check: Callable[[], object] | None = None, timeout: float | None = None, resume: str = '', *,
            on_warning: Callable[[str], object] | None = None, **fields: Any) -> CalibrationOutcome:
        """Run a calibration to its end and return its CalibrationOutcome.

        order, seed, options, resume: of the goal, as configured where empty; fields: its others, as in
        Calibrate.action; None: as configured, 0 or False: none at all. check: called now and then, may raise (a cell's
        own check); timeout: s, after which the calibration is cancelled. KeyboardInterrupt cancels it and waits for its
        clean end. on_warning: gets what the nodes of the cell warn of.

        Raises CellError where the sequencer is not there, refuses, or is disconnected."""
        self.wait()
        self._run_id, self._done_words, self._is_restarted, self._on_warning = '', '', False, None

        def on_feedback(message: Any) -> None:  # of this goal, while states may be those of the run before
            state = message.feedback.state

            def take() -> None:
                self._run_id = plain(state.run_id)
                if on_progress and state.phase in list(Phase):
                    on_progress(progress_of(state))

            self._sequencer.admit(state.process, names.CALIBRATE_FEEDBACK, take)

        given = {name: Calibrate.Goal.NONE if name in NONE and not value else value for name, value in fields.items()
                 if value is not None}  # Goal.NONE and Goal.NO are the same number
        goal = Calibrate.Goal(order=order, seed=seed, options=options, resume=resume, **given)
        _refuse_stranger(self._servers, self._where)
        # An exception in the middle of rclpy would break it.
        with TakenSignals(signal.SIGINT, once=True) as interrupt:
            accepted = self._action.send_goal_async(goal, feedback_callback=on_feedback)
            try:
                handle = self._await(accepted, RESUME_TIMEOUT if resume else 10.0, check, interrupt)
            except (KeyboardInterrupt, TimeoutError):  # else the run begins later, and nobody waits for it
                handle, timeout = self._await(accepted, CANCEL_TIMEOUT, check), 0.0
            _refuse_stranger(self._servers, self._where)
            self._on_warning = on_warning
            result = handle.get_result_async()
            try:
                response = self._await(result, timeout, check, interrupt, handle.get_result_async)
            except (KeyboardInterrupt, TimeoutError):
                handle.cancel_goal_async()
                response = self._await(result, CANCEL_TIMEOUT, check)
        if response is None:
            return self._outcome_without_result()
        if response.status == GoalStatus.STATUS_ABORTED and not response.result.run_id:
            raise CellError(f'cell {self._where}: calibration refused: {plain(response.result.message, most=2000)}')
        return outcome_of(response)

    def _outcome_without_result(self) -> CalibrationOutcome:
        """Return the outcome of a run that had succeeded, as it was published, before its sequencer ended."""
        motions = self._motions
        outcome = CalibrationOutcome(True, False, f'{self._done_words}; the sequencer ended before it said so',
                                     self._run_id, self._spin_until(self._log, _LOG_TOLD), None)
        return outcome if motions.run_id != self._run_id else _with_motions(outcome, motions)

    def _log(self) -> Path | None:
        """Return the log of the run, None where its recorder does not tell it."""
        log = Path(self._recorder.values.get('log', ''))
        return log if self._run_id and run_of(log.name) == self._run_id else None

    def _await(self, future: Future, timeout: float | None, check: Callable[[], object] | None,
               interrupt: TakenSignals | None = None, ask_again: Callable[[], Future] | None = None) -> Any:
        """Return the result of a future; ask_again: of a run, makes another one once its sequencer is found again."""
        began = seen = time.monotonic()
        is_run, patience = bool(ask_again), _RETURN if ask_again else _DISCONNECTED
        while not future.done():
            self._executor.spin_once(timeout_sec=_STEP)
            if check:
                check()
            if interrupt and interrupt.is_received:
                raise KeyboardInterrupt
            now, before = time.monotonic(), seen
            seen = now if self._action.server_is_ready() else seen
            if seen > before + _DISCONNECTED and ask_again:  # what it answered meanwhile may be lost
                future = ask_again()
            if now - seen > patience or (is_run and self._is_restarted):
                if is_run and self._done_words:
                    return None
                event = 'was restarted' if self._is_restarted else 'is disconnected'
                log = is_run and self._spin_until(self._log, _LOG_TOLD)
                hint = f', resume with: {self.resume_command(self._run_id)}' if self._run_id else ''
                raise CellError(f'cell {self._where}: the sequencer {event}; what was measured is in '
                                f'{log or "the log"}{hint}')
            if timeout is not None and now - began > timeout:
                raise TimeoutError(f'cell {self._where}: no answer within {timeout:g} s')
        return future.result()

    def resume_command(self, run: str | Path) -> str:
        """Return the command that resumes a run of this cell."""
        return command('calibrate', '--resume', run, *names.where(self._context.get_domain_id(), self._where))

    def _on_log(self, message: Log) -> None:
        node = message.name.rpartition('.')[2]
        is_told = node == names.SEQUENCER and message.level > LoggingSeverity.WARN  # that a run has failed: its result
        if (self._on_warning and message.level >= LoggingSeverity.WARN and not is_told
                and names.is_of_cell(message.name, self._where)):
            self._on_warning(f'{node}: {message.msg}')

    def _on_state(self, state: RunState) -> None:
        """A sequencer that is idle while a calibration of it is running, is another process."""
        def take() -> None:
            self._has_state, self._progress = True, progress_of(state)
            if state.phase == Phase.DONE and self._progress.run_id == self._run_id:
                self._done_words = self._progress.text
            self._is_restarted = self._is_restarted or state.phase == Phase.IDLE

        self._sequencer.admit(state.process, names.RUN_STATE, take)

    def _on_motions(self, message: ErrorMotionsMessage) -> None:
        self._monitors.of(names.EVALUATOR).admit(
            message.process, names.ERROR_MOTIONS, lambda: setattr(self, '_motions', message))

    def _on_restart(self) -> None:
        self._is_restarted = True


def _refuse_stranger(servers: ServiceServers, where: str) -> None:
    """Raise CellError where another node than the one with the role offers a service, too, or alone."""
    if words := servers.refusal():
        raise CellError(f'cell {where}: {words}; end that one')


class HangDetector(GraphClient):
    """Receives the statuses of the nodes of a running cell, in a thread of its own; a context manager.

    Raises CellError where the graph cannot be joined."""

    def __init__(self, cell: Cell) -> None:
        super().__init__('supervisor', cell.domain_id, cell.namespace, make_executor)
        self._processes = cell.processes
        self._every = NodeMonitors(self._node)
        self._monitors = [self._every.of(name) for name in cell.processes]
        self._heard_none = time.monotonic()
        self.spin_beside('hang detector', self._every.watch)

    def hanging(self) -> list[str]:
        """Return the nodes whose present process has published statuses, but none for STATUS_HANGS.

        A node that computes publishes them. None where no statuses at all were received within this time: then the
        fault is here, or all nodes stood still together. To be called often."""
        now = time.monotonic()
        if all(monitor.silence > qos.STATUS_LOST for monitor in self._monitors):
            self._heard_none = now
        if now - self._heard_none < qos.STATUS_HANGS:
            return []
        return [monitor.peer for monitor in self._monitors if monitor.silence > qos.STATUS_HANGS
                and monitor.process.startswith(started(monitor.peer, self._processes[monitor.peer].popen.pid))]


def outcome_of(response: Any) -> CalibrationOutcome:
    """Return the CalibrationOutcome of a calibrate result with its status."""
    result = response.result
    ended = CalibrationOutcome(
        result.success, response.status == GoalStatus.STATUS_CANCELED, result.message, result.run_id,
        Path(result.log) if result.log else None, None, is_joint=bool(result.joint_evaluation.run_ids),
        paused=result.paused)
    return _with_motions(ended, result.error_motions) if result.success else ended


def _with_motions(outcome: CalibrationOutcome, message: ErrorMotionsMessage) -> CalibrationOutcome:
    """Return an outcome with the result and the verdict in a message."""
    published = conversions.published_motions(message)
    return replace(outcome, error_motions=published.motions, which=published.which, verdict=verdict_of(message))

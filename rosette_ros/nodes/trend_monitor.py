# SPDX-License-Identifier: Apache-2.0
"""The trend monitor: a cell that calibrates itself on a schedule, keeps its runs in an archive and tells the trend."""

import math
import sys
from concurrent.futures import Future as Work
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.task import Future
from rosette_msgs.action import Calibrate
from rosette_msgs.msg import CalibrationEvent, Trend, TrendChange, TrendForecast
from rosette_msgs.srv import HoldCell
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from rosette_ros.archive.cell_schedule import CellSchedule
from rosette_ros.archive.cell_trend import CellTrend, add_and_judge
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import DAY
from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.error_summary import COVERAGE_FACTOR
from rosette_ros.core.errors import InvalidConfig, RosetteError, plain
from rosette_ros.core.records import CURVES
from rosette_ros.io.model_file import read_model
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WARN, CellNode, Health, run_node
from rosette_ros.nodes.conversions import time_message
from rosette_ros.nodes.interfaces import introspected_service

WANTED = (
    Wanted('archive', '', 'folder of the archive to which the runs of the cell are added', read_only=True),
    Wanted('every_s', 0.0, 'wall time from one calibration to the next, s; 0: on a service call only', 0.0, 1e9,
           read_only=True),
    Wanted('table', '', 'serial number of the table, as the identity states it: the schedule follows its runs; empty: '
           'those of the cell', read_only=True),
    Wanted('model', '', 'model file (YAML) under which runs are added; empty: the base model', read_only=True))
RETRY = 5.0
"""A calibration that was due and could not begin is tried again after so long, s; the first one waits as long."""
REQUESTING, CALIBRATING = 'requesting a calibration', 'calibrating'
ANSWER = 30.0
"""How long the answer of the sequencer to a request is waited for, s."""
REASON = 2.0
"""How long the reason of a refusal is waited for, s: it comes on another topic than the refusal."""


class TrendMonitor(CellNode):
    """Requests calibrations, adds each to an archive, publishes the trend and warns where a limit is passed.

    Topics: publishes `trend`. Services: `trend_monitor/hold`, `trend_monitor/release`, `trend_monitor/calibrate`.
    Action: client of `calibrate`. Parameters: WANTED. While a person or another job holds the cell, or the sequencer
    refuses, nothing begins, and log and /diagnostics say why."""

    def __init__(self) -> None:
        super().__init__(names.TREND_MONITOR, WANTED)
        if not self.parameters['archive']:
            raise InvalidConfig(f'{names.TREND_MONITOR}: archive: wanted the folder of an archive, got none')
        self._archive = RunArchive(self.parameters['archive'], make=True)
        self._archive.check_writable()
        self._model = read_model(self.parameters['model'] or None)
        self._schedule = CellSchedule(self._archive, self.get_namespace().strip('/'), self.parameters['table'],
                                      self.parameters['every_s'])
        self._due = self._schedule.due(_now())
        self._doing, self._process, self._why_not, self._failure = '', '', '', ''
        self._next_look, self._reason_until = self.seconds() + RETRY, 0.0  # the other nodes of a cell start, too
        self._goal: Any = None
        self._requested: Future | None = None
        self._answer_until = 0.0
        self._pool = ThreadPoolExecutor(1, 'archive')
        self._work: Work[CellTrend] | None = None
        self._trend: CellTrend | None = None
        self._trends = self.create_publisher(Trend, names.TREND, qos.RESULT)
        self._sequencer = self.monitor(names.SEQUENCER)
        self.on(names.CALIBRATION_EVENT, CalibrationEvent, self._on_event, qos.EVENT)
        self._action = ActionClient(self, Calibrate, names.CALIBRATE)
        introspected_service(self, HoldCell, names.HOLD, self._on_hold)
        introspected_service(self, HoldCell, names.RELEASE, self._on_release)
        introspected_service(self, Trigger, names.CALIBRATE_NOW, self._on_calibrate)
        self.get_logger().info(f'archive {self._archive.folder}; {self._plan}')

    def destroy_node(self) -> None:
        self._action.destroy()
        super().destroy_node()

    # Who holds the cell

    def _on_hold(self, request: HoldCell.Request, response: HoldCell.Response) -> HoldCell.Response:
        who = plain(request.who)
        if not who:
            return self._answer(response, True)
        if self._doing:
            return self._answer(response, False, f'the cell is {self._doing}; wait, or cancel the calibration')
        return self._changed(response, partial(self._schedule.take, who, plain(request.why), _now()))

    def _on_release(self, request: HoldCell.Request, response: HoldCell.Response) -> HoldCell.Response:
        return self._changed(response, partial(self._schedule.release, plain(request.who)))

    def _changed(self, response: HoldCell.Response, change: Any) -> HoldCell.Response:
        try:
            change()
        except RosetteError as error:
            return self._answer(response, False, plain(str(error)))
        self._next_look = 0.0
        answer = self._answer(response, True)
        self.get_logger().info(answer.message)
        return answer

    def _answer(self, response: HoldCell.Response, success: bool, words: str = '') -> HoldCell.Response:
        hold = self._schedule.hold
        response.success, response.message = success, words or (str(hold) if hold else 'nobody holds the cell')
        if hold:
            response.holder, response.why = hold.who, hold.why
            response.since = _stamp(hold.since)
        return response

    # Calibrating

    def _on_calibrate(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Request a calibration now; what the sequencer says is in the log and in /diagnostics."""
        reason = self._hindrance()
        response.success, response.message = not reason, reason or 'a calibration is requested of the sequencer'
        if reason:
            self.get_logger().warning(f'no calibration begins: {reason}')
        else:
            self._request()
        return response

    def wake(self) -> None:
        """Begin what is due; take up what was added; notice that the sequencer is disconnected."""
        now = self.seconds()
        if self._reason_until and now > self._reason_until:
            self._refused('the sequencer refused it, see its log')
        if self._doing == REQUESTING and not self._reason_until and (
                now > self._answer_until or self._sequencer.is_disconnected):
            self._requested = None
            self._refused('the sequencer was requested and did not answer')
        if self._process and (self._sequencer.is_disconnected or self._sequencer.process != self._process):
            self._end('the sequencer has ended or was restarted; resume the run, or wait for the next one')
        if self._work is not None and self._work.done():
            self._added(self._work)
        if now < self._next_look or self._doing:
            return
        self._next_look = now + RETRY
        if self._due is None or _now() < self._due:
            if self._due is not None:
                self._next_look = now + min(RETRY, (self._due - _now()).total_seconds())
            return
        if reason := self._hindrance():
            self._refused(reason)
        else:
            self._request()

    def _hindrance(self) -> str:
        """Return why no calibration can be requested now, '' where one can."""
        if self._schedule.hold is not None:
            return str(self._schedule.hold)
        if self._doing:
            return f'the cell is {self._doing}'
        return '' if self._action.server_is_ready() else 'no sequencer: wanted its action calibrate, got none'

    def _request(self) -> None:
        self._doing, self._answer_until = REQUESTING, self.seconds() + ANSWER
        self._requested = self._action.send_goal_async(Calibrate.Goal())
        self._requested.add_done_callback(self._on_accepted)

    def _on_accepted(self, future: Future) -> None:
        goal: Any = future.result()
        if future is not self._requested:  # given up
            if goal.accepted:
                goal.cancel_goal_async()
            return
        self._goal = goal
        if not self._goal.accepted:
            if self._doing == REQUESTING:  # else the reason is known already
                self._reason_until = self.seconds() + REASON
            return
        self._doing, self._why_not, self._failure = CALIBRATING, '', ''
        self._process = self._sequencer.process
        try:
            self._schedule.attempt(_now())
        except RosetteError as error:
            self._fail(f'after a restart of this node the schedule is not known: {plain(str(error))}')
        self._goal.get_result_async().add_done_callback(partial(self._on_result, self._goal))

    def _on_event(self, event: CalibrationEvent) -> None:
        if (event.kind == CalibrationEvent.REJECTED and event.origin == names.CALIBRATE
                and self._doing == REQUESTING):
            self._refused(plain(event.text, most=2000))

    def _refused(self, reason: str) -> None:
        self._doing, self._reason_until = '', 0.0
        self._next_look = self.seconds() + RETRY
        if reason != self._why_not:
            self._why_not = reason
            self.get_logger().warning(f'a calibration is due and does not begin: {reason}')

    def _on_result(self, goal: Any, future: Future) -> None:
        if goal is not self._goal or not self._process:
            return
        result, self._process = future.result().result, ''
        if not result.success:
            is_cancelled = future.result().status == GoalStatus.STATUS_CANCELED
            self._end(f'run {result.run_id} was {"cancelled" if is_cancelled else "not successful"}: '
                      f'{plain(result.message)}')
            return
        self._doing = f'adding run {result.run_id} to the archive'
        self._work = self._pool.submit(add_and_judge, self._archive, result.log, self._model)

    def _added(self, work: Work[CellTrend]) -> None:
        self._work = None
        try:
            trend = work.result()
        except RosetteError as error:
            self._end(f'the run is not in the archive: {plain(str(error))}; rosette archive add LOG --into '
                      f'{self._archive.folder} adds it')
            return
        self._trend = trend
        self._trends.publish(trend_message(trend, Header(stamp=self.now().to_msg())))
        self._end()
        log = self.get_logger()
        words = f'run {trend.history.runs[-1]} is in the archive; {trend.sentence}; {self._plan}'
        if trend.warnings:
            log.warning(words)
        else:
            log.info(words)

    def _end(self, failure: str = '') -> None:
        """Nothing is under way any more; the next one is due as the schedule says."""
        self._doing, self._process, self._goal = '', '', None
        if failure:
            self._fail(failure)
        self._due, self._next_look = self._schedule.due(_now()), 0.0

    def _fail(self, words: str) -> None:
        self._failure = words
        self.get_logger().error(words)

    def finish(self) -> None:
        """Wait until a run that is being added is on the disk."""
        self._pool.shutdown(wait=True)

    @property
    def _plan(self) -> str:
        return ('calibrates on a service call only' if self._due is None else
                f'next calibration on {self._due:%Y-%m-%d %H:%M:%S} UTC')

    def health(self) -> Health:
        """Say what it does, why it does not, and which limits are passed."""
        hold, trend = self._schedule.hold, self._trend
        values: dict[str, object] = {
            'archive': self._archive.folder, 'next': self._due.isoformat() if self._due else '',
            'held_by': hold.who if hold else '', 'not_started': self._why_not,
            'trend': trend.sentence if trend else '', 'failure': self._failure}
        said = [*(trend.warnings if trend else ()), *filter(None, (self._failure,)),
                *([f'due, and does not begin: {self._why_not}'] if self._why_not else [])]
        level = ERROR if trend and trend.unkept else WARN if said else OK
        return level, '; '.join([*said, self._doing or self._plan, *([str(hold)] if hold else [])]), values


def trend_message(trend: CellTrend, header: Header) -> Trend:
    """Return the message of a trend."""
    history = trend.history
    changes = [TrendChange(
        run_id=history.runs[event.run], not_before=_stamp(history.dates[event.earliest - 1]),
        not_after=_stamp(history.dates[event.latest]), owners=list(event.owners),
        quantities=[step.series.name for step in event.steps],
        size=[step.strength / COVERAGE_FACTOR for step in event.steps]) for event in trend.events]
    forecasts = []
    for curve, limit in history.tolerances.items():
        place, found = CURVES.index(curve), trend.forecasts.get(curve)
        made = TrendForecast(error=curve, tolerance=limit, range=float(history.range[-1, place]),
                             expanded=float(history.U[-1, place]), slope=math.nan, slope_u=math.nan,
                             expected=math.nan, soonest=math.nan, interval=math.nan)
        if found is not None:
            made.slope, made.slope_u = found.slope / DAY, found.slope_u / DAY
            made.expected, made.soonest, made.interval = (
                DAY * one for one in (found.expected, found.soonest, found.interval))
        forecasts.append(made)
    return Trend(header=header, run_id=history.runs[-1], table=history.serial, model_hash=history.model_hash,
                 runs=len(history.runs), text=trend.sentence, level=trend.level, warnings=list(trend.warnings),
                 changes=changes, forecasts=forecasts)


def _now() -> datetime:
    return datetime.now(UTC)


def _stamp(when: datetime) -> Any:
    return time_message(round(when.timestamp() * 1e6) * 1000)


main = partial(run_node, names.TREND_MONITOR, TrendMonitor)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""A CMM behind an I++ DME server: publishes the ball centres and touches of targets, waits for a person after a stop.

Two threads: rclpy's runs all callbacks of the node; an asyncio loop has the connection, and measures one target after
the other. Callbacks hand coroutines to the loop; the loop puts what it has measured into a queue and a task into the
executor, which publishes it. Neither waits for the other, except when the node ends.
"""

import asyncio
import sys
import threading
from collections.abc import Coroutine, Sequence
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

from rosette_msgs.msg import ProbeTarget, RunState
from std_srvs.srv import Trigger

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import CellError, InvalidConfig, RosetteError, one_line
from rosette_ros.dme.ball_probing import DmeCmm, MeasuredBall
from rosette_ros.dme.dme_plan import PlannedBall, Way, refuse_plan, refuse_unsafe_plan
from rosette_ros.dme.dme_session import DmeSession, ToolNotInUse
from rosette_ros.dme.dme_settings import DmeSettings, load_dme_settings
from rosette_ros.dme.rotary_table import TableState
from rosette_ros.dme.stop_mark import StopMark
from rosette_ros.invocation import command
from rosette_ros.io.log_run import SIMULATED_STATUS
from rosette_ros.io.messages import MACHINE_FRAME, Phase
from rosette_ros.nodes import conversions, names
from rosette_ros.nodes.base_node import ERROR, OK, WARN, Health, run_node
from rosette_ros.nodes.cmm_node import CmmNode
from rosette_ros.nodes.interfaces import run_task, waiting_service

WANTED = (
    Wanted('settings', '', 'settings file of the CMM (rosette-dme/1)', read_only=True),)
UNTIL_IT_ENDS = 0.5  # an answer that a stopped machine gives waits so long for the end of the run, s
RECOVERY = 30.0  # the service answers within this time, s
END = 3.0  # beyond the time-outs of the settings, in which the session has ended, s

T = TypeVar('T')


class DmeCmmNode(CmmNode):
    """A CMM through I++ DME.

    A target is measured as the settings say, or answered as failed with the server's number and words. When a run ends,
    when the node that requested the target is disconnected, and when this node ends, what moves is aborted (AbortE). A
    collision, an emergency stop, a lost connection, a crash of this node: the status says so, by which a run fails,
    and nothing moves until a person calls the service `cmm/recover`, which clears the errors or connects anew; a file
    beside the settings keeps that over the end of the node. Nothing moves but for a target: a tool is changed before
    the first ball. Parameters: WANTED."""

    wake_period = 0.1  # what moves is aborted within this time after its requester is known to be disconnected

    def __init__(self) -> None:
        super().__init__(WANTED)
        path = str(self.parameters['settings'])
        (self._settings, self._ways), self._mark = settings_of(path), StopMark(path)
        self._cmm: DmeCmm | None = None
        self._is_prepared = False
        self._trouble = self._mark.read()
        self._wanted: ProbeTarget | None = None
        self._asker = frozenset[bytes]()
        self._one, self._told = asyncio.Lock(), ''
        self._found: SimpleQueue[tuple[ProbeTarget, MeasuredBall | RosetteError]] = SimpleQueue()
        self._failure: BaseException | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name='dme', daemon=True)
        self._thread.start()
        waiting_service(self, Trigger, names.RECOVER, self._on_recover)
        if not self._trouble:
            self._do(self._get_ready())

    def check_plan(self, targets: Sequence[ProbeTarget]) -> None:
        """Refuse a plan by what the settings know; nothing is asked of the server."""
        cmm, plan = self._cmm, []
        for target in targets:
            aim, pole = self.aim_of(target)
            plan.append(PlannedBall(target.balls, target.table_position, target.ball, aim, target.table_angle,
                                    target.approach, pole, target.touches))
        self._ways |= refuse_plan(self._settings, plan, TableState(0.0) if cmm is None else cmm.table, self._ways)

    def on_target(self, target: ProbeTarget) -> None:
        """Have the ball measured, unless it is just being measured."""
        if self._wanted is None or (self._wanted.run_id, self._wanted.seq) != (target.run_id, target.seq):
            self._wanted, self._asker = target, self.requesters.used
            self._do(self._measure(target))

    def on_state(self, state: RunState) -> None:
        """Abort what moves for a run that has ended, as the process says that asked for it."""
        super().on_state(state)
        if self._wanted is not None and self._wanted.run_id == state.run_id and state.phase in (
                Phase.CANCELLED, Phase.FAILED) and self.is_state_of(self._asker):
            self._stop_measuring()

    def _stop_measuring(self) -> None:
        self._wanted = None
        self._do(self._halt())

    async def _on_recover(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear errors, or connect anew, because a person has looked at the machine; answer what came of it."""
        self.get_logger().info('a person has looked at the machine')
        if not self._problem():
            response.success, response.message = True, 'nothing was to be cleared: the machine is ready'
            return response
        self._wanted = None
        ready = self._do(self._get_ready(by_person=True))
        has_ended = await self.ended(ready, RECOVERY)
        problem = ready.result() if has_ended else f'not ready within {RECOVERY:g} s: /diagnostics'
        response.success = not problem
        self.wake()  # the next goal shall not be refused for what is over
        response.message = problem or 'errors are cleared, or the server is connected anew: the machine is ready'
        return response

    def wake(self) -> None:
        """Say what keeps the machine from working, as soon as it does."""
        if self._failure is not None:
            raise self._failure
        self._publish_found()
        if self._wanted is not None and not self._asker & self.requesters.running:
            self.get_logger().warning(
                f'the node that requested ball {self._wanted.ball} is disconnected; its measurement is aborted')
            self._stop_measuring()
        problem, cmm = self._problem(), self._cmm
        self.status.report(problem)
        words = problem or ('; '.join([f'{cmm.session.where}: ready', *cmm.remarks]) if cmm is not None else '')
        if words != self._told:
            self._told = words
            if problem:
                self.get_logger().error(problem)
                if cmm is not None and cmm.session.for_person:
                    self._mark.write(cmm.session.stop)
            elif words:
                self.get_logger().info(words)
        if self._mark.complaint:
            self.get_logger().warning(self._mark.complaint, once=True)

    def _problem(self) -> str:
        """Return what a person has to do something about, '' for nothing, also while the server is connected."""
        cmm = self._cmm
        problem = cmm.session.stop if cmm is not None and cmm.session.for_person else self._trouble
        where = names.where(self.context.get_domain_id(), self.get_namespace())
        return f'{problem}; then: {command("check-cmm", "--recover", *where)}' if problem else ''

    def _publish_found(self) -> None:
        while not self._found.empty():
            target, ball = self._found.get()
            is_wanted = self._wanted is target
            self._wanted = None if is_wanted else self._wanted
            if isinstance(ball, RosetteError):
                problem = self._problem()
                if not is_wanted:
                    self.get_logger().info(f'seq {target.seq}: stopped: nobody waits for ball {target.ball} any more')
                    continue
                self.status.report(problem)  # it ends the run; an answer would only have the sequencer ask again
                self.after(UNTIL_IT_ENDS if problem else 0.0, partial(
                    self.answers.publish, self.refuse(target, ball, self.now().to_msg())))
                continue
            self.measured += 1
            answer = self.answer_to(target)
            conversions.fill_answer(answer, ball, conversions.time_message(round(1e9 * ball.time)), MACHINE_FRAME)
            self.touches.publish(conversions.touches_message(
                answer, ball.points, ball.normals, ball.touch_times - ball.time,
                1e-3 * self._settings.tool.tip_radius_mm))
            self.answers.publish(answer)

    def _do(self, work: Coroutine[Any, Any, T]) -> 'Future[T]':
        """Have the loop do something; what fails there unexpectedly ends the node."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        future.add_done_callback(self._look)
        return future

    def _look(self, future: 'Future[T]') -> None:
        if not future.cancelled() and (error := future.exception()):
            self._failure = error

    async def _get_ready(self, by_person: bool = False) -> str:
        """Connect, or clear the errors, and prepare the machine without a move; return what is wrong, '' for nothing.

        by_person: whether a person has looked at the machine."""
        async with self._one:
            server, timeouts, self._is_prepared = self._settings.server, self._settings.timeouts, False
            try:
                cmm = self._cmm
                if cmm is None or cmm.session.is_lost:
                    self._cmm = None
                    session = await DmeSession.connect(server.host, server.port, timeouts, by_person=by_person)
                    self._cmm = cmm = DmeCmm(session, self._settings)
                else:
                    await cmm.session.clear(by_person)
                try:
                    await self._prepare(cmm, may_move=False)
                except ToolNotInUse as error:
                    cmm.remarks = [one_line(error)]
                self._trouble = ''
                self._mark.clear()
            except RosetteError as error:
                self._trouble = one_line(error)
                self._mark.keep_refusal(error)
                if self._cmm is not None and not self._cmm.session.for_person:
                    await self._cmm.session.end()
                    self._cmm = None
            return self._trouble

    async def _prepare(self, cmm: DmeCmm, may_move: bool) -> None:
        await cmm.prepare(may_move)
        self._is_prepared = True

    async def _measure(self, target: ProbeTarget) -> None:
        async with self._one:
            is_wanted = target is self._wanted
            if not is_wanted:
                return  # nobody waits for it any more
            found: MeasuredBall | RosetteError
            try:
                if (cmm := self._cmm) is None or self._trouble:
                    raise CellError(self._trouble)
                found = await self._measured(cmm, target)
            except RosetteError as error:
                found = error
            if cmm is not None and not self._trouble:
                self._mark.settle(cmm.session)  # after an error that is no RosetteError it stays
            self._found.put((target, found))
            run_task(self, self._publish_found)

    async def _measured(self, cmm: DmeCmm, target: ProbeTarget) -> MeasuredBall:
        aim, pole = self.aim_of(target)
        await cmm.session.resume()
        is_wanted = target is self._wanted
        if not is_wanted:  # it was cancelled, too, before the last AbortE had ended
            raise CellError(f'nobody waits for ball {target.ball} any more')
        self._mark.write(f'the node ended while it measured ball {target.ball} at table position '
                         f'{target.table_position}: the machine may have been moving; a person has to look at the '
                         'machine')
        if not self._is_prepared:
            await self._prepare(cmm, may_move=True)
        return await cmm.measure(target.ball, aim, target.table_angle, target.approach, pole, target.touches)

    async def _halt(self) -> None:
        if self._cmm is not None and self._one.locked() and not self._cmm.session.is_lost:
            try:
                await self._cmm.session.halt()
            except RosetteError as error:
                self._trouble = one_line(error)

    async def _leave(self) -> None:
        await self._halt()
        async with self._one:  # what was measured has come to its end
            if self._cmm is not None:
                await self._cmm.session.end()

    def finish(self) -> None:
        """Abort what moves, end the session, and send the answers that there are."""
        self._wanted = None
        timeouts = self._settings.timeouts
        leaving = self._do(self._leave())
        try:
            leaving.result(timeouts.abort_s + timeouts.ack_s + END)
        except TimeoutError:
            self.get_logger().error('the session with the I++ server did not end in time')
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(END)
        self._publish_found()
        super().finish()

    def health(self) -> Health:
        """Return the state of the machine."""
        problem, target, cmm = self._problem(), self._wanted, self._cmm
        doing = problem or ('connecting' if cmm is None else 'ready' if target is None else
                            f'measuring ball {target.ball} at table position {target.table_position}')
        values: dict[str, object] = {'measured': self.measured, 'failed': self.failed,
                                     'server': f'{self._settings.server.host}:{self._settings.server.port}'}
        if self._settings.simulated:
            values[SIMULATED_STATUS] = 'as the settings say'
        if cmm is not None:
            values |= {'table_angle_deg': f'{cmm.table.angle:.4f}', 'remarks': '; '.join(cmm.remarks),
                       'last_warning': next(reversed(cmm.session.warnings), '')}
        return (ERROR if problem else WARN if self.failed or cmm is None else OK,
                f'{doing}; {self.measured} balls measured, {self.failed} targets refused', values)


def settings_of(path: str) -> tuple[DmeSettings, set[Way]]:
    """Return the settings of a file and the ways around its balls, all safe; raises InvalidConfig, UnsafePath."""
    if not path:
        raise InvalidConfig('settings: expected the path of a settings file (rosette-dme/1), found none; an example is '
                            'config/dme.yaml')
    settings = load_dme_settings(path)
    return settings, refuse_unsafe_plan(settings)


main = partial(run_node, names.CMM, DmeCmmNode)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())

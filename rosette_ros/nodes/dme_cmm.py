# SPDX-License-Identifier: Apache-2.0
"""A CMM behind an I++ DME server: obeys targets, publishes ball centres and touches, waits for a person after a stop.

Two threads: rclpy's runs all callbacks of the node; an asyncio loop has the connection, and measures one target after
the other. Callbacks hand coroutines to the loop; the loop puts what it has measured into a queue and a task into the
executor, which publishes it. Neither waits for the other, except when the node ends.
"""

import asyncio
import sys
import threading
from collections.abc import Coroutine
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any

from rosette_msgs.msg import ProbeTarget, RunState
from std_srvs.srv import Trigger

from rosette_ros import command
from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.errors import CellError, InvalidConfig, RosetteError, one_line
from rosette_ros.dme.ball_probing import DmeCmm, MeasuredBall
from rosette_ros.dme.dme_settings import DmeSettings, load_dme_settings
from rosette_ros.dme.probe_path import refuse_unsafe_plan
from rosette_ros.io.messages import MACHINE_FRAME, Phase
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import ERROR, OK, WARN, Health, run_node
from rosette_ros.nodes.cmm_node import CmmNode

WANTED = (
    Wanted('settings', '', 'settings file of the CMM (rosette-dme/1)', read_only=True),)
UNTIL_IT_ENDS = 0.5  # an answer that a stopped machine gives waits so long for the end of the run, s
END = 3.0  # beyond the time-outs of the settings, in which the session has ended, s


class DmeCmmNode(CmmNode):
    """A CMM through I++ DME.

    A target is measured as the settings say, or answered as failed with the server's number and words. When a run ends,
    and when the node ends, what moves is aborted (AbortE). A collision, an emergency stop, a lost connection: the
    heartbeat says so, by which a run fails, and nothing moves until a person calls the service `cmm/recover`, which
    clears the errors or connects anew. Parameters: WANTED."""

    def __init__(self) -> None:
        super().__init__(WANTED)
        self._settings = settings_of(str(self.parameters['settings']))
        self._cmm: DmeCmm | None = None
        self._trouble = 'connecting'
        self._wanted: ProbeTarget | None = None
        self._one, self._told = asyncio.Lock(), ''
        self._found: SimpleQueue[tuple[ProbeTarget, MeasuredBall | RosetteError]] = SimpleQueue()
        self._failure: BaseException | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name='dme', daemon=True)
        self._thread.start()
        self.on(names.RUN_STATE, RunState, self._on_state, qos.STATE)
        self.create_service(Trigger, names.RECOVER, self._on_recover)
        self._do(self._connect())

    def on_target(self, target: ProbeTarget) -> None:
        """Have the ball measured, unless it is just being measured."""
        if self._wanted is None or (self._wanted.run_id, self._wanted.seq) != (target.run_id, target.seq):
            self._wanted = target
            self._do(self._measure(target))

    def _on_state(self, state: RunState) -> None:
        """Abort what moves for a run that has ended."""
        if self._wanted is not None and self._wanted.run_id == state.run_id and state.phase in (
                Phase.CANCELLED, Phase.FAILED):
            self._wanted = None
            self._do(self._halt())

    def _on_recover(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear errors, or connect anew, because a person has looked at the machine."""
        self.get_logger().info('a person has looked at the machine')
        self._wanted = None
        self._do(self._recover())
        response.success, response.message = True, 'errors are cleared, or the server is connected anew: /diagnostics'
        return response

    def wake(self) -> None:
        """Say what keeps the machine from working, as soon as it does."""
        if self._failure is not None:
            raise self._failure
        self._publish_found()
        problem = self._problem()
        self.heartbeat.report(problem)
        if problem != self._told:
            self._told = problem
            if problem:
                self.get_logger().error(problem)
            elif self._cmm is not None:
                self.get_logger().info('; '.join([f'{self._cmm.session.where}: ready', *self._cmm.remarks]))

    def _problem(self) -> str:
        problem = self._trouble
        if self._cmm is not None:
            problem = self._cmm.session.stop if self._cmm.session.for_person else ''
        return f'{problem}; then: {command("check-cmm", "--recover")}' if problem else ''

    def _publish_found(self) -> None:
        while not self._found.empty():
            target, ball = self._found.get()
            if self._wanted is target:
                self._wanted = None
            if isinstance(ball, RosetteError):
                problem = self._problem()
                self.heartbeat.report(problem)  # it ends the run; an answer would only have the sequencer ask again
                self.after(UNTIL_IT_ENDS if problem else 0.0, partial(
                    self.answers.publish, self.refuse(target, ball, self.now().to_msg())))
                continue
            self.measured += 1
            answer = self.answer_to(target)
            conversions.fill_answer(answer, ball, conversions.time_message(round(1e9 * ball.time)), MACHINE_FRAME)
            self.touches.publish(conversions.touches_message(
                answer, ball.points, ball.normals, ball.touch_times - ball.time,
                1e-3 * self._settings.tool.tip_radius_mm, ball.is_compensated))
            self.answers.publish(answer)

    def _do(self, work: Coroutine[Any, Any, None]) -> 'Future[None]':
        """Have the loop do something; what fails there unexpectedly ends the node."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        future.add_done_callback(self._look)
        return future

    def _look(self, future: 'Future[None]') -> None:
        if not future.cancelled() and (error := future.exception()):
            self._failure = error

    async def _connect(self) -> None:
        try:
            self._cmm = await DmeCmm.start(self._settings)
        except RosetteError as error:
            self._trouble = one_line(error)

    async def _measure(self, target: ProbeTarget) -> None:
        async with self._one:
            is_wanted = target is self._wanted
            if not is_wanted:
                return  # nobody waits for it any more
            found: MeasuredBall | RosetteError
            try:
                if self._cmm is None:
                    raise CellError(self._trouble)
                aim, pole = self.aim_of(target)
                await self._cmm.session.resume()
                found = await self._cmm.measure(target.ball, aim, target.table_angle, target.approach, pole,
                                                target.touches)
            except RosetteError as error:
                found = error
            self._found.put((target, found))
            self.executor.create_task(self._publish_found)

    async def _halt(self) -> None:
        if self._cmm is not None and self._one.locked() and not self._cmm.session.is_lost:
            try:
                await self._cmm.session.halt()
            except RosetteError as error:
                self._trouble = one_line(error)

    async def _recover(self) -> None:
        async with self._one:
            try:
                if self._cmm is not None and not self._cmm.session.is_lost:
                    await self._cmm.session.clear(by_person=True)
                    return
                self._cmm, self._trouble = None, 'connecting'
            except RosetteError as error:
                self._trouble = one_line(error)
                return
            await self._connect()

    async def _leave(self) -> None:
        await self._halt()
        if self._cmm is not None:
            await self._cmm.session.end()

    def finish(self) -> None:
        """Abort what moves, end the session, and send the answers that there are."""
        self._wanted = None
        patience = self._settings.timeouts
        leaving = self._do(self._leave())
        try:
            leaving.result(patience.abort_s + patience.ack_s + END)
        except TimeoutError:
            self.get_logger().error('the session with the I++ server did not end in time')
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(END)
        self._publish_found()
        super().finish()

    def health(self) -> Health:
        """Return the state of the machine."""
        problem, target = self._problem(), self._wanted
        doing = problem or (f'measuring ball {target.ball} at table position {target.table_position}' if target else
                            'ready')
        values: dict[str, object] = {'measured': self.measured, 'failed': self.failed,
                                     'server': f'{self._settings.server.host}:{self._settings.server.port}'}
        if self._cmm is not None:
            values |= {'table_angle_deg': f'{self._cmm.table.angle:.4f}', 'remarks': '; '.join(self._cmm.remarks),
                       'last_warning': next(reversed(self._cmm.session.warnings), '')}
        return (ERROR if problem else WARN if self.failed else OK,
                f'{doing}; {self.measured} balls measured, {self.failed} targets refused', values)


def settings_of(path: str) -> DmeSettings:
    """Return the settings of a file if all paths of its balls are safe; raises InvalidConfig, UnsafePath."""
    if not path:
        raise InvalidConfig('settings: wanted the path of a settings file (rosette-dme/1), got none; an example is '
                            'config/dme.yaml')
    settings = load_dme_settings(path)
    refuse_unsafe_plan(settings, settings.table.balls)
    return settings


main = partial(run_node, names.CMM, DmeCmmNode)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())

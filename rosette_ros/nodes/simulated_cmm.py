# SPDX-License-Identifier: Apache-2.0
"""The simulated CMM and table: receives targets, publishes ball centres and the simulated time."""

import contextlib
import math
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from builtin_interfaces.msg import Time as TimeMessage
from rclpy.time import Time
from rosette_msgs.msg import BallCentre, ProbeTarget, Touches
from rosgraph_msgs.msg import Clock

from rosette_ros.calibration.settings import Wanted
from rosette_ros.core.run.errors import InvalidConfig, InvalidPlan, RosetteError
from rosette_ros.io.log_run import SIMULATED_STATUS
from rosette_ros.io.messages import MACHINE_FRAME, nanoseconds, target_of
from rosette_ros.io.plan_file import LONGEST_WAIT
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.base_node import OK, WARN, Health, run_node
from rosette_ros.nodes.cmm_node import CmmNode
from rosette_ros.simulation import Machine, load_machine
from rosette_ros.simulation.faults import Strike, distort, strikes
from rosette_ros.simulation.machine import BallReading

WANTED = (
    Wanted('machine', '', 'file that describes the simulated machine; empty: the machine.yaml of the package',
           read_only=True),
    Wanted('clock_rate_hz', 4.0, 'how often the simulated time is published while nothing is measured, Hz of wall time',
           0.1, 10.0),
    Wanted('answer_s', 0.0, 'wall time that each answer takes, s; 0: as fast as the computer allows', 0.0, 0.3))


class SimulatedCmm(CmmNode):
    """Measures as fast as the computer allows; its clock shows how long a real cell would take.

    The simulated time starts at the wall time of the node's start and advances only by measuring, and by waiting where
    a target has a later stamp, so that a run does not depend on the speed of the computer. A change in the file of the
    machine applies from the next run on, as when a person switches a correction off between two runs.

    Topics: those of CmmNode and `/clock`. A plan for another plate is refused. Parameters: WANTED."""

    def __init__(self) -> None:
        super().__init__(WANTED)
        self._file = Path(self.parameters['machine'] or default_machine()).expanduser()
        self._machine = Machine(load_machine(self._file))
        self._run_id: str | None = None
        self._switched_on = self.system.now().nanoseconds
        self._struck = 0
        self._last_answer: BallCentre | None = None
        self._set_back = 0.0
        self._newest = 0  # stamp that was published, ns
        self._clock_out = self.create_publisher(Clock, names.CLOCK, qos.CLOCK)
        self._publish_time()
        self.every(1.0 / self.parameters['clock_rate_hz'], self._publish_time)

    def check_plan(self, targets: Sequence[ProbeTarget]) -> None:
        """Refuse a plan where the machine, as its file is when the run begins, has not its balls."""
        config = load_machine(self._file) if self._file.is_file() else self._machine.config
        for target in targets[:1]:
            _refuse_other_plate(target, config.plate.balls, config.radius)

    def on_target(self, target: ProbeTarget) -> None:
        """Measure the ball at once; the answer may be held back."""
        answer = self.answer_to(target)
        struck: Sequence[Strike] = ()
        touches: Touches | None = None
        try:
            if target.run_id != self._run_id:
                self._begin_run(target)
            wait = 1e-9 * (nanoseconds(target.header.stamp) - self._newest)  # a target may be for later than now
            self._machine.stand(wait if wait <= LONGEST_WAIT else 0.0)
            struck = strikes(self._machine.config.faults, self._machine.config.seed, target.seq, target.attempt)
            self._struck += len(struck)
            reading = self._measure(target, struck)
        except RosetteError as error:
            answer = self.refuse(target, error, self._stamp(self._machine.time))
        else:
            self.measured += 1
            conversions.fill_answer(answer, reading, self._stamp(reading.time), MACHINE_FRAME)
            touches = conversions.touches_message(answer, reading.touch_point, reading.touch_normal,
                                                  reading.touch_time - reading.time, self._machine.pattern.tip)
        self._publish_time()
        self.after(self.parameters['answer_s'], lambda: self._answer(answer, struck, touches))

    def _begin_run(self, target: ProbeTarget) -> None:
        """Set the clock and read the machine's file again at the first target of a run.

        The clock never falls behind what was published before, by this process or an earlier one. The machine goes on
        where it stood: its time and its noise continue."""
        late = nanoseconds(target.header.stamp) - nanoseconds(self._stamp(self._machine.time))
        self._switched_on += max(late, 0)
        if self._file.is_file():
            config = load_machine(self._file)
            if config != self._machine.config:
                self._machine = Machine(config, self._machine.state)
        self._run_id = target.run_id
        self._publish_time()

    def _measure(self, target: ProbeTarget, struck: Sequence[Strike]) -> BallReading[int, float]:
        machine = self._machine
        _refuse_other_plate(target, machine.n, machine.radius)
        aim, pole = self.aim_of(target)
        side = pole if pole.any() else None
        offset = target_of(target).table_offset
        if not math.isfinite(offset):
            raise InvalidPlan(f'table_angle: expected a finite angle, found {target.table_angle}')
        short = sum(1e-6 * strike.fault.short_urad for strike in struck if strike.fault.kind == 'table_short')
        if any(strike.fault.kind == 'neighbour' for strike in struck):
            return machine.measure(target.table_position, target.ball % machine.n + 1, target.approach, short=short,
                                   touches=target.touches, pole=side, table_offset=offset)
        return machine.measure(target.table_position, target.ball, target.approach, aim, short, target.touches, side,
                               offset)

    def _answer(self, answer: BallCentre, struck: Sequence[Strike], touches: Touches | None) -> None:
        now = self.seconds()
        if touches is not None:
            self.touches.publish(touches)
        for message, due in distort(answer, struck, self._last_answer, now):
            self.after(0.0 if due is None else due - now, partial(self.answers.publish, message))
        self._last_answer = answer
        for strike in struck:
            if strike.fault.kind == 'clock_back':
                self._set_back += strike.fault.back_s
                self._publish_time()
            elif strike.fault.kind == 'crash':
                self.get_logger().error('the CMM crashes, as its configuration wants it')
                os.kill(os.getpid(), signal.SIGKILL)

    def _stamp(self, time: float) -> TimeMessage:
        return conversions.time_message(self._switched_on + round(1e9 * (time - self._set_back)))

    def _publish_time(self) -> None:
        stamp = self._stamp(self._machine.time)
        self._newest = max(self._newest, nanoseconds(stamp))
        self._clock_out.publish(Clock(clock=stamp))

    def now(self) -> Time:
        """Return the simulated time: this node is the clock."""
        return Time.from_msg(self._stamp(self._machine.time))

    def health(self) -> Health:
        """Return what was measured."""
        sentence = f'{self.measured} balls measured, {self.failed} targets refused'
        sentence += f', {self._struck} faults as configured' if self._struck else ''
        return WARN if self.failed or self._struck else OK, sentence, {
            'measured': self.measured, 'failed': self.failed, SIMULATED_STATUS: f'{self._machine.time:.1f}'}


def _refuse_other_plate(target: ProbeTarget, balls: int, radius: float) -> None:
    if target.balls != balls or not math.isclose(target.radius, radius, rel_tol=1e-9):
        raise InvalidPlan(f'expected a target for {balls} balls on a circle of radius {radius:g} m, found '
                          f'{target.balls} balls, {target.radius:g} m')


def default_machine() -> Path:
    """Return the path of the machine.yaml that comes with the package."""
    roots = [Path(__file__).parents[2]]
    with contextlib.suppress(PackageNotFoundError):
        roots.append(Path(get_package_share_directory('rosette_ros')))
    paths = [root / 'config' / 'machine.yaml' for root in roots]
    for path in filter(Path.is_file, paths):
        return path
    raise InvalidConfig(f'machine: expected {" or ".join(map(str, paths))}, found none; set the parameter "machine"')


main = partial(run_node, names.CMM, SimulatedCmm)
"""Run the node; returns the exit code."""

if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""The simulated CMM and table: obeys targets, answers ball centres, keeps the simulated time."""

import math
import os
import signal
import sys
import time
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.time import Time
from rosette_msgs.msg import BallCentre, ProbeTarget
from rosgraph_msgs.msg import Clock

from rosette_ros.core.errors import CellError, InvalidConfig, InvalidPlan, RosetteError
from rosette_ros.data.assemble import MACHINE_FRAME
from rosette_ros.machine import Machine, load_machine
from rosette_ros.machine.faults import strikes
from rosette_ros.nodes import convert, names, qos
from rosette_ros.nodes.faulty import distort
from rosette_ros.nodes.runner import OK, WARN, CellNode, run_node
from rosette_ros.nodes.sequence import short_frame
from rosette_ros.nodes.settings import Wanted

WANTED = (
    Wanted('machine', '', 'file that describes the simulated machine; empty: the machine.yaml '
           'that is installed with the package', read_only=True),
    Wanted('clock_rate_hz', 4.0, 'how often the simulated time is published while nothing is '
           'measured, Hz of wall time', 0.1, 10.0),
    Wanted('answer_s', 0.0, 'wall time that each answer takes, s; 0: as fast as the computer allows', 0.0, 0.3),
)
FARTHEST = 100.0
"""A centre that is farther from the origin of the machine is taken for a mistake, m."""


class SimulatedCmm(CellNode):
    """Measures as fast as the computer allows; its clock says how long a real cell would take.

    The simulated time starts at the wall time of the node's start and advances only by measuring,
    so that a run does not depend on how fast the computer is. What is changed in the file of the
    machine holds from the next run on, as when a person switches a correction off between two runs.
    """

    def __init__(self):
        """Build the machine and stand up the interfaces; raises RosetteError in words."""
        super().__init__(names.CMM, WANTED)
        self._file = Path(self.parameters['machine'] or default_machine())
        self._machine = Machine(load_machine(self._file))
        self._run_id = None
        self._switched_on = self.system.now().nanoseconds
        self._measured = self._failed = self._struck = 0
        self._late, self._last_answer = [], None
        self._back = 0.0
        self._ticked = -math.inf
        self.on(names.PROBE_TARGET, ProbeTarget, self._on_target, qos.ORDER)
        self._clock_out = self.create_publisher(Clock, names.CLOCK, qos.CLOCK)
        self._answers = self.create_publisher(BallCentre, names.BALL_CENTRE, qos.ANSWER)
        self._tick()

    def _on_target(self, target):
        if target.run_id != self._run_id:
            # Time went on while this node or this run was not there: it never stands before what was told already.
            told = convert.nanoseconds(target.header.stamp)
            self._switched_on += max(told - convert.nanoseconds(self._stamp(self._machine.time)), 0)
        answer = BallCentre(
            run_id=target.run_id, seq=target.seq, table_position=target.table_position,
            ball=target.ball, cmm_position=target.cmm_position)
        faults = ()
        try:
            self._look_again(target.run_id)
            faults = strikes(self._machine.config.faults, self._machine.config.seed, target.seq,
                             target.attempt)
            self._struck += len(faults)
            reading = self._measure(target, faults)
        except RosetteError as error:
            self._failed += 1
            self.get_logger().warning(f'seq {target.seq}: {error}')
            answer.status, answer.text = BallCentre.STATUS_FAILED, str(error)
            answer.header.stamp = self._stamp(self._machine.time)
            answer.header.frame_id = target.header.frame_id
        else:
            self._measured += 1
            convert.fill_answer(answer, reading, self._stamp(reading.time), MACHINE_FRAME)
        self._tick()
        time.sleep(self.parameters['answer_s'])
        self._say(answer, faults)

    def _say(self, answer, faults):
        """Publish an answer as the faults that strike it will have it."""
        for kept, due in distort(answer, faults, self._last_answer, self.seconds()):
            if due is None:
                self._answers.publish(kept)
            else:
                self._late.append((due, kept))
        self._last_answer = answer
        for strike in faults:
            if strike.kind == 'clock_back':
                self._back += strike.fault.back_s
                self._tick()
            elif strike.kind == 'crash':
                self.get_logger().error('the CMM crashes, as its configuration wants it')
                os.kill(os.getpid(), signal.SIGKILL)

    def _look_again(self, run_id):
        """Read the machine's file again at the first target of a run: a setting may be another one.

        The machine goes on where it stood: its time and its noise do not begin anew.
        """
        if run_id == self._run_id:
            return
        if self._file.is_file():
            config = load_machine(self._file)
            if config != self._machine.config:
                self._machine = Machine(config, self._machine.state)
        self._run_id = run_id

    def _measure(self, target, faults):
        machine = self._machine
        if target.balls != machine.n or not math.isclose(target.radius, machine.radius,
                                                         rel_tol=1e-9):
            raise InvalidPlan(
                f'wanted a target for {machine.n} balls on a circle of radius '
                f'{machine.radius:g} m, got {target.balls} balls, {target.radius:g} m')
        if short_frame(target.header.frame_id) != MACHINE_FRAME:
            raise CellError(f'wanted a target in the frame {MACHINE_FRAME!r}, got '
                            f'{target.header.frame_id!r}')
        aim = convert.point_array(target.centre)
        if not all(abs(value) < FARTHEST for value in aim.tolist()):
            raise CellError(f'wanted a target within {FARTHEST:g} m, got the centre {tuple(aim.tolist())}')
        short = sum(1e-6 * strike.fault.short_urad for strike in faults if strike.kind == 'table_short')
        ball = target.ball
        if any(strike.kind == 'neighbour' for strike in faults):
            ball, aim = ball % machine.n + 1, None
        return machine.measure(target.table_position, ball, target.approach, aim, short)

    def _stamp(self, time):
        return convert.time_message(self._switched_on + round(1e9 * (time - self._back)))

    def _tick(self):
        self._ticked = self.seconds()
        self._clock_out.publish(Clock(clock=self._stamp(self._machine.time)))

    @property
    def is_busy(self):
        """Whether targets keep coming."""
        return self.seconds() - self._ticked < 1.0 / self.parameters['clock_rate_hz']

    def wake(self):
        """Publish the time for those who have just come, and answers that were held back."""
        now = self.seconds()
        for due, answer in [entry for entry in self._late if entry[0] <= now]:
            self._late.remove((due, answer))
            self._answers.publish(answer)
        if self.seconds() - self._ticked >= 1.0 / self.parameters['clock_rate_hz']:
            self._tick()

    def now(self):
        """Return the simulated time: this node is the clock."""
        return Time.from_msg(self._stamp(self._machine.time))

    def health(self):
        """Say what was measured."""
        level = WARN if self._failed else OK
        sentence = f'{self._measured} balls measured, {self._failed} targets refused'
        if self._struck:
            level, sentence = WARN, f'{sentence}, {self._struck} faults as configured'
        return level, sentence, {'measured': self._measured, 'failed': self._failed,
                                 'simulated_s': f'{self._machine.time:.1f}'}


def default_machine():
    """Return the path of the machine.yaml that comes with the package."""
    beside = Path(__file__).parents[2] / 'config' / 'machine.yaml'
    try:
        shared = Path(get_package_share_directory('rosette_ros')) / 'config' / 'machine.yaml'
    except PackageNotFoundError:
        shared = beside
    for path in (beside, shared):
        if path.is_file():
            return path
    raise InvalidConfig(f'machine: wanted machine.yaml as {beside} or {shared}, found none; set '
                        'the parameter "machine"')


def main(args=None):
    """Run the simulated CMM; returns the exit code."""
    return run_node(names.CMM, SimulatedCmm, args)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""A CMM tried before a calibration: it is asked for a few balls, its answers are checked one by one and together."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosette_msgs.msg import BallCentre, ProbeTarget, Touches

from rosette_ros.calibration.calibration_plan import CalibrationPlan
from rosette_ros.calibration.settings import LIMITS, PLANNED, changed_settings, limits_of, plan_of
from rosette_ros.calibration.state_machine import complaint
from rosette_ros.cell import client
from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.number_words import micrometres, significant
from rosette_ros.core.run.touches import LEAST_TOUCHES, fit_spheres
from rosette_ros.io.messages import MACHINE_FRAME, Answer, Phase, Target, answer_of
from rosette_ros.io.reading_checks import Check, check_answers, remark_on_temperature
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.nodes import conversions, names, qos
from rosette_ros.nodes.liveliness import NodeMonitor
from rosette_ros.nodes.node_requests import target_subscriptions
from rosette_ros.words.reading_words import remark_words

SEARCH, SETTLING, ECHOES = 5.0, 1.0, 0.5  # for the CMM; for all to discover each other; for a second answer, s
SEQUENCER_SEARCH = client.SEARCH
CLOCK_OFF = 2.0  # a stamp so long before its target or after its answer is of another clock, s
PLAUSIBLE_FORM = 1e-4  # m
SAME_CENTRE = 1e-6  # by which the sphere through them may be off the answer, m
CONNECTED = ('types', 'quality of service')
"""Checks of the graph without which no answer can come."""
HELD = {
    'stamps': 'every answer has a time of its own', 'travel': 'counts on over full turns, forward and backwards',
    'approach': 'the sense of the last move', 'places': 'measured, not repeated from the target',
    'resolution': 'the coordinates have all digits'}
"""What holds where a check of reading_checks finds nothing wrong."""


@dataclass(frozen=True)
class CmmReport:
    """All checks; seconds_per_ball: median, None without an answer; run_seconds: what a calibration would take;
    repeatability: standard deviation of a coordinate, m, None where it was not found."""

    checks: tuple[Check, ...]
    seconds_per_ball: float | None
    run_seconds: float | None
    repeatability: float | None

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that are not passed."""
        return tuple(check.name for check in self.checks if check.passed is False)


class CmmClient(CellClient):
    """Asks a CMM for balls in place of a sequencer; a context manager; arguments as of CellClient."""

    name = names.TRIAL

    def __init__(self, domain_id: int | None = None, namespace: str = names.NAMESPACE) -> None:
        super().__init__(domain_id, namespace)
        self.has_sequencer = False
        self._received: list[tuple[float, int, Answer]] = []
        self._touches: list[Touches] = []
        self._node.create_subscription(Touches, names.TOUCHES, self._touches.append, qos.ANSWER)
        self._node.create_subscription(BallCentre, names.BALL_CENTRE, self._on_answer, qos.ANSWER)

    def settings(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings of the sequencer, the defaults where there is none, changed by those given.

        Waits for the CMM, and for a sequencer as long as one may take to be discovered; `has_sequencer` says which.
        Raises CellError where there is no CMM, or a calibration is running.
        """
        self._await_cmm()
        every = (*PLANNED, *LIMITS)
        values = {wanted.name: wanted.default for wanted in every}
        service = self._node.create_client(GetParameters, f'{names.SEQUENCER}/get_parameters')
        if self._spin_until(service.service_is_ready, SEQUENCER_SEARCH):
            response = self._await(service.call_async(GetParameters.Request(names=list(values))), SEARCH, None)
            found = [*map(parameter_value_to_python, response.values)]
            if len(found) < len(values):
                raise CellError(f'cell {self._where}: the sequencer is of another version; restart the cell')
            values |= {name: value for name, value in zip(values, found, strict=True) if value is not None}
            self.has_sequencer = True
        self._refuse_beside_a_run()
        return values | {wanted.name: wanted.check(given[wanted.name], 'check-cmm') for wanted in every
                         if given.get(wanted.name) is not None}

    def check(self, values: Mapping[str, Any], repeats: int = 5,
              on_progress: Callable[[str], object] | None = None) -> CmmReport:
        """Ask for one ball several times, at some table positions forward and backwards, and for another ball.

        values: as of `settings`. Nothing is asked where no answer can come.
        """
        graph = self._graph_checks()
        if not all(check.passed for check in graph if check.name in CONNECTED):
            return CmmReport(graph, None, None, None)
        targets = self._node.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET)
        self._spin_until(lambda: False, SETTLING)
        self._refuse_beside_a_run()
        plan, limits = plan_of(changed_settings(values, {})), limits_of(values)
        run, waited, complaints = RunAnswers(f'check_{time.time_ns()}'), list[float](), list[str]()
        asked = _plan(plan, repeats)
        for index in range(asked.total):
            target = self._ask(targets, run, asked, index)
            if on_progress:
                on_progress(f'{index + 1} of {asked.total}: {target}')
            began = time.monotonic()
            if not self._spin_until(partial(self._is_answered, target), limits.answer_timeout):
                complaints.append(f'{target}: no answer within {limits.answer_timeout:g} s'
                                  f'{self._strangers(run.run_id)}')
                break
            received, _, answer = next(one for one in self._of(run.run_id) if one[2].seq == target.seq)
            waited.append(received - began)
            run.add_answer(answer)
            doubt = complaint(answer, target, limits, run.in_frames)
            complaints += [f'{target}: {remark_words(doubt)}'] if doubt else []
        self._spin_until(lambda: False, ECHOES)
        checks = (*self._graph_checks(), self._one_answer(run), _answers(complaints, asked.total), *self._together(run))
        each = statistics.median(waited) if waited else None
        return CmmReport(checks, each, each and each * plan.total, RunAssembly(run).repeatability()[0])

    def _ask(self, targets: Publisher, run: RunAnswers, asked: CalibrationPlan, index: int) -> Target:
        """Publish a target as the sequencer would, before its alignment."""
        now = time.time_ns()
        target = asked.placed(asked.target(index), asked.taught, MACHINE_FRAME)._replace(
            run_id=run.run_id, attempt=1, session=1, stamp_ns=now)
        run.add_target(target)
        targets.publish(conversions.target_message(target, conversions.time_message(now)))
        return target

    def _await_cmm(self) -> None:
        self._spin_until(self._is_there, SEARCH)
        if not self._is_there():
            raise CellError(f'cell {self._where}: no CMM: expected one that subscribes to {names.PROBE_TARGET} and '
                            f'publishes {names.BALL_CENTRE}, found none within {SEARCH:g} s; start it, check namespace '
                            'and ROS_DOMAIN_ID')
        self._spin_until(lambda: False, SETTLING)

    def _refuse_beside_a_run(self) -> None:
        if self._progress.is_running:
            raise CellError(f'cell {self._where}: run {self._progress.run_id} is running; wait for its end or cancel '
                            'it')

    def _is_there(self) -> bool:
        return bool(self._node.count_publishers(names.BALL_CENTRE) and target_subscriptions(self._node))

    def _graph_checks(self) -> tuple[Check, ...]:
        """Return what the graph alone shows: types, quality of service, how many there are."""
        topic, listeners = self._node.resolve_topic_name(names.BALL_CENTRE), target_subscriptions(self._node)
        answers = self._node.get_publishers_info_by_topic(topic)
        wrong = [f'{info.topic_type} on {name}, expected {wanted}' for name, wanted, infos in (
            (names.BALL_CENTRE, 'rosette_msgs/msg/BallCentre', answers),
            (names.PROBE_TARGET, 'rosette_msgs/msg/ProbeTarget', listeners)) for info in infos
            if info.topic_type != wanted]
        held = [] if all(info.qos_profile.durability != DurabilityPolicy.TRANSIENT_LOCAL for info in listeners) else [
            f'{names.PROBE_TARGET} is subscribed to transient local: the machine would move to an old target; expected '
            'volatile']
        held += [f'{names.BALL_CENTRE} is published best effort; expected reliable' for info in answers
                 if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT]
        beats = NodeMonitor(self._node, names.CMM).publishers()
        return (Check('types', not wrong, '; '.join(wrong) or 'ProbeTarget and BallCentre'),
                Check('quality of service', not held, '; '.join(held) or 'as wanted'),
                Check('one CMM', len(answers) == len(listeners) == 1,
                      f'{names.BALL_CENTRE} is published by {len(answers)}, {names.PROBE_TARGET} subscribed to by '
                      f'{len(listeners)}'),
                Check('status', True if beats else None, 'found' if beats else
                      'none: a CMM that hangs is noticed when an answer is overdue'))

    def _one_answer(self, run: RunAnswers) -> Check:
        answers = [answer.seq for *_, answer in self._of(run.run_id)]
        twice = len(answers) - len(set(answers))
        return Check('one answer', not twice, f'{twice} more answers than targets' if twice else 'to each target')

    def _strangers(self, run_id: str) -> str:
        """Return in words which answers came that no target asked for."""
        other = sorted({answer.run_id for *_, answer in self._received} - {run_id})
        return f', but answers to run {", ".join(map(repr, other))}: repeat run_id and seq' if other else ''

    def _together(self, run: RunAnswers) -> list[Check]:
        """Return what all answers together show."""
        pairs = run.counting()
        if not pairs:
            return []
        answers, sigma = [answer for _, answer in pairs], RunAssembly(run).repeatability()[0]
        found = check_answers(pairs)
        checks = [Check(name, not (wrong := found[name]), remark_words(wrong) if wrong else held)
                  for name, held in HELD.items() if name in found]
        spread = 'not found' if sigma is None else f'{micrometres(sigma)}, standard deviation of a coordinate'
        alike = found.get('repeatability')
        checks.append(Check('repeatability', None if sigma is None and not alike else not alike,
                            remark_words(alike) if alike else spread))
        frames = sorted({answer.frame for answer in answers})
        checks.append(Check('frame', len(frames) == 1, f'centres in {", ".join(frames)}'))
        if not self._node.count_publishers(names.CLOCK):
            off = [gap for target, answer in pairs if abs(gap := self._clock_gap(target, answer)) > CLOCK_OFF]
            checks.append(Check('clock', not off, f'header.stamp is {off[0]:+.1f} s off the time of this computer; '
                                'synchronise the clocks' if off else 'stamps lie between target and answer'))
        form = [answer.form_error for answer in answers]
        checks.append(Check('form error', all(0 <= one < PLAUSIBLE_FORM for one in form),
                            f'{significant(1e6 * min(form))} to {micrometres(max(form))}'))
        checks.append(self._touch_check(run.run_id, answers))
        warm = np.array([answer.temperature for answer in answers])
        known, doubt = warm[np.isfinite(warm)], remark_on_temperature(warm)
        checks.append(Check('temperature', not doubt if known.size else None, remark_words(doubt) if doubt else
                            f'{known.min():.2f} to {known.max():.2f} °C' if known.size else 'not measured (NaN)'))
        return checks

    def _touch_check(self, run_id: str, answers: Sequence[Answer]) -> Check:
        """Return whether the spheres through the touches, where they are published, are those of the answers."""
        name, points = 'touches', {one.seq: np.array([one.x, one.y, one.z]).T for one in self._touches
                                   if one.run_id == run_id}
        if not points:
            return Check(name, None, f'none on {names.TOUCHES}: spheres cannot be fitted again from the log')
        lacking = [answer.seq for answer in answers if len(points.get(answer.seq, ())) < LEAST_TOUCHES]
        if lacking:
            return Check(name, False, f'less than {LEAST_TOUCHES} for {len(lacking)} of {len(answers)} answers')
        try:
            spheres = [fit_spheres(points[answer.seq][None]) for answer in answers]
        except np.linalg.LinAlgError:
            return Check(name, False, 'they lie on no sphere')
        off = max(float(np.linalg.norm(one.centre[0] - answer.centre)) for one, answer in zip(spheres, answers))
        radius = [1e3 * float(one.radius[0]) for one in spheres]
        each = sorted({len(points[answer.seq]) for answer in answers})
        words = (f'{" or ".join(map(str, each))} a ball, spheres of radius {min(radius):.4f} to {max(radius):.4f} mm, '
                 f'centres {micrometres(off, 2)} from the answers')
        return Check(name, off <= SAME_CENTRE, words if off <= SAME_CENTRE else
                     f'{words}; expected at most {1e6 * SAME_CENTRE:g} µm: are they of the same ball, in metres?')

    def _clock_gap(self, target: Target, answer: Answer) -> float:
        """Return how long a stamp lies before its target or after the receipt of the answer, s, 0 between."""
        received = next(at for _, at, one in self._received if one == answer)
        return 1e-9 * (min(answer.stamp_ns - target.stamp_ns, 0) + max(answer.stamp_ns - received, 0))

    def _of(self, run_id: str) -> list[tuple[float, int, Answer]]:
        return [one for one in self._received if one[2].run_id == run_id]

    def _is_answered(self, target: Target) -> bool:
        return any(answer.seq == target.seq for *_, answer in self._of(target.run_id))

    def _on_answer(self, message: BallCentre) -> None:
        self._received.append((time.monotonic(), time.time_ns(), answer_of(message)))


def _plan(whole: CalibrationPlan, repeats: int) -> CalibrationPlan:
    """Return what is asked: ball 1 repeatedly, over a full turn forward, backwards over it again, then another ball."""
    n = whole.scheme.n
    one, two = 1 + n // 3, 1 + 2 * n // 3
    position = np.array([*[1] * repeats, one, two, 1, one, 1, two, two])
    sense = np.array([1, *[0] * (repeats - 1), 1, 1, 1, 1, -1, -1, 0])
    phase = np.array([*[Phase.REPEATABILITY] * repeats, *[Phase.ALIGNMENT] * 7])
    ball = np.array([*[1] * (repeats + 6), np.unique(whole.scheme.ball)[1]])
    return CalibrationPlan(whole.scheme, whole.radius, whole.taught, phase, position, ball, sense,
                           touches=np.zeros_like(phase), session=np.ones_like(phase), wait=np.zeros(phase.size))


def _answers(complaints: list[str], total: int) -> Check:
    more = f' ({len(complaints)} such answers)' if len(complaints) > 1 else ''
    return Check('answers', not complaints, f'{complaints[0]}{more}' if complaints else
                 f'{total} of {total} as asked: ball, position, angle, place, units')

# SPDX-License-Identifier: Apache-2.0
"""A calibration from its request on: what was asked, what is planned, what an earlier part of the run has measured."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import count, takewhile
from typing import Any

import yaml

from rosette_ros.calibration import settings
from rosette_ros.calibration.calibration_plan import CalibrationPlan, block_of
from rosette_ros.calibration.settings import Value
from rosette_ros.calibration.state_machine import Sequence
from rosette_ros.core.planning.size import refuse_more
from rosette_ros.core.run.errors import CellError, InvalidConfig, plain
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.io.messages import EXTENDED, Phase, Target, answer_of, target_of
from rosette_ros.io.run_answers import RunAnswers

SUCCEEDED = 5
"""Kind of a CalibrationEvent: a run ended in success."""
OF_EVENT = {'order': '', 'seed': 0, 'options': ''}
"""Fields of the goal that a CalibrationEvent has too, and what they are where they are not set."""


MOST_NAMES = 100
"""Names of runs that are kept of a goal."""


@dataclass(frozen=True)
class Request:
    """Who asks for a calibration, by which interface, and the fields of the goal that are set, by name."""

    origin: str
    goal: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def of_goal(origin: str, goal: Any) -> 'Request':
        """Return the Request of a Calibrate goal."""
        return Request(origin, {name: value for name in (*OF_EVENT, *settings.FIELDS)
                                if (value := getattr(goal, name))} | (
            {'joint_with': list(goal.joint_with)} if goal.joint_with else {}))

    def joint_with(self) -> list[str]:
        """Return the names of the runs that are evaluated as one with this one; raises InvalidConfig."""
        run_ids = [plain(name) for name in self.goal.get('joint_with', ())]
        if '' in run_ids or len({*run_ids}) < len(run_ids):
            raise InvalidConfig(f'goal: joint_with: expected names of finished runs, each once, found {run_ids!r:.200}')
        return run_ids

    @property
    def fields(self) -> str:
        """The fields of the goal besides OF_EVENT, a plan and a plate, which stand in the settings, as YAML.

        Of what is longer than any of them can be, only the begin: to write it took the sequencer a minute."""
        own = {name: _begin(value) for name, value in self.goal.items() if name not in (*OF_EVENT, 'plan', 'plate')}
        return yaml.safe_dump(own, sort_keys=False) if own else ''


def _begin(value: Any) -> Any:
    """Return at most so much of a field as settings may have: of a text, and of a list and each of its texts."""
    if isinstance(value, list):
        return [plain(one) for one in value[:MOST_NAMES]]
    return value[:settings.MAX_OPTIONS] if isinstance(value, str) else value


@dataclass(eq=False)
class Job:
    """The running calibration: its sequence, its goal handle, its log."""

    sequence: Sequence
    request: Request
    order: str
    planned: str = ''  # what it was planned with, YAML
    joint_with: Collection[str] = ()  # runs that are evaluated as one with it
    resumes: str = ''  # name of the log that it continues
    goal: Any = None  # None: requested by the service
    log: str = ''
    since: float = 0.0  # steady time at which it was accepted, s
    is_waiting: bool = False  # for the nodes to be connected
    located_ns: int = 0  # when its phase RUN began in an earlier part, ns, 0 if it did not
    processes: dict[str, str] = field(default_factory=dict)  # those of the nodes that serve it, by node
    remarks: list[str] = field(default_factory=list)  # warnings
    ignored: int = 0  # answers that were not used, up to its last question
    opening: bool = True  # its log
    recording: bool = False
    frames: list[Any] = field(default_factory=list)  # TransformStamped messages of the table frame
    motions: Any = None  # the ErrorMotions message as published
    joint: Any = None  # the EvaluateJointly.Response, None where none was asked for (yet)

    @property
    def run_id(self) -> str:
        """The name of the run."""
        return self.sequence.run_id

    @property
    def settings(self) -> str:
        """What it was planned with, and what was added to its plan, YAML."""
        return self.planned + settings.format_added(self.sequence.plan)

    @property
    def is_over(self) -> bool:
        """Whether nothing is measured any more; the log may still be open."""
        return self.sequence.phase.is_end

    def end_goal(self) -> None:
        """Tell the client of the action, if any, how the run ended; the result follows at the end of the log."""
        phase = self.sequence.phase
        if self.goal is None:
            return
        if phase is Phase.DONE:
            self.goal.succeed()
        elif phase is Phase.CANCELLED and self.goal.is_cancel_requested:
            self.goal.canceled()
        else:
            self.goal.abort()

    @property
    def joint_evaluation(self) -> Any:
        """The JointEvaluation message, None where there is none."""
        return self.joint.evaluation if self.joint else None

    @property
    def text(self) -> str:
        """How it ended, in words, with what the evaluation with other runs says."""
        text = self.sequence.text
        if self.joint is None:
            return text
        return f'{text}; jointly with {", ".join(self.joint_with)}: {plain(self.joint.message, most=2000)}'

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        sequence = self.sequence
        if self.is_over:
            return 'its log is being closed'
        return f'{sequence.phase.name.lower().replace("_", " ")}, {sequence.done} of {sequence.plan.total} balls'


def make_job(request: Request, configured: Mapping[str, Value], taken: Collection[str], recalled: Any = None,
             known: RunAnswers | None = None) -> Job:
    """Return the Job of a request.

    configured: the settings of the sequencer, name to value; taken: run_ids that are used; recalled: the
    Recall.Response of the run that is resumed, None for a new run; known: what the sequencer has of the last run, all
    of which the disk may not have. Raises RosetteError with the reason why not."""
    joint_with = request.joint_with()
    changes = settings.goal_changes(request.goal)
    changes.pop(settings.RESUME.name, None)
    if recalled is not None:
        job = _resumed_job(request, recalled, changes, {**configured, **changes}, known)
        return replace(job, joint_with=joint_with)
    values = settings.with_identity(settings.changed_settings(configured, changes))
    plan = settings.plan_of(values)
    run_id = settings.run_name(datetime.now(UTC), plan.scheme.order, taken)
    until = settings.until_of(values)
    if until is None and 'most_readings' in request.goal:
        raise InvalidConfig('goal: most_readings: expected until_probability or until_uncertainty beside it, found '
                            'neither')
    if until:
        refuse_more(plan.scheme.n, 'until')
    return Job(Sequence(run_id, plan, settings.limits_of(values), until=until), request, plan.scheme.order,
               settings.format_settings(values), joint_with)


def _resumed_job(request: Request, recalled: Any, changes: Mapping[str, Value], values: Mapping[str, Value],
                 known: RunAnswers | None) -> Job:
    if not recalled.success:
        raise CellError(recalled.message)
    run_id = plain(recalled.run_id)
    recorded = [event.settings for event in recalled.events if event.settings]
    planned = settings.parse_settings(recorded[-1], f'resume: run {run_id}') if recorded else dict(values)
    refuse_other_plan(changes, planned, run_id)
    values = settings.with_identity({**values, **planned})
    plan = settings.plan_of(values)
    if settings.until_of(values):
        plan = plan.followed_by(_asked_beyond(plan, map(target_of, recalled.targets), run_id))
    earlier = earlier_answers(recalled, plan)
    if known is not None and known.run_id == run_id:
        targets, answers = known.lacking_in(earlier)
        for target in targets:
            earlier.add_target(target)
        for answer in answers:
            earlier.add_answer(answer)
    if any(event.kind == SUCCEEDED for event in recalled.events):
        raise CellError(f'resume: run {run_id} lacks nothing: it ended in success and its log is closed')
    sequence = Sequence(run_id, plan, settings.limits_of(values), earlier, until=settings.until_of(values))
    sequence.open = next((plain(event.text) for event in reversed(recalled.events) if event.kind == EXTENDED), '')
    return Job(sequence, request, plan.scheme.order, settings.format_settings(values), resumes=recalled.log,
               located_ns=earlier.run_begin())


def _asked_beyond(plan: CalibrationPlan, targets: Iterable[Target], run_id: str) -> Scheme:
    """Return the readings of a block of which a log has targets, and lacks the event that names it."""
    beyond = {one.seq: one for one in targets
              if one.run_id == run_id and one.phase == Phase.RUN and one.seq > plan.run_end}
    asked = [beyond[seq] for seq in takewhile(beyond.__contains__, count(plan.run_end + 1))]
    columns = {name: [getattr(one, name) for one in asked] for name in ('table_position', 'ball')}
    sense, approach = int(plan.approach[plan.run_end - 1]), []
    for one in asked:
        sense = one.approach or sense
        approach.append(sense)
    return block_of(plan.scheme.n, {**columns, 'approach': approach, 'wait': [0.0] * len(asked)})


def refuse_other_plan(changes: Mapping[str, Value], planned: Mapping[str, Value], run_id: str) -> None:
    """Refuse a goal that changes, name to value, what decided the plan of the run that it resumes."""
    for name in ('plan', 'plate.file'):
        if changes.get(name):
            changes = {**changes, name: settings.changed_settings(planned, changes)[name]}
    for name in (wanted.name for wanted in settings.PLANNED if wanted not in settings.TABLE):
        if name in changes and changes[name] != planned[name]:
            was, got = ('the one', 'another') if name in ('plan', 'plate.file') else (
                repr(planned[name]), repr(changes[name]))
            raise CellError(f'resume: run {run_id}: {name}: expected {was} as the run began, found {got}; leave it out')


def earlier_answers(recalled: Any, plan: CalibrationPlan) -> RunAnswers:
    """Return what a Recall.Response holds of its run; raises CellError where that is not what was planned."""
    earlier = RunAnswers(plain(recalled.run_id))
    for target in map(target_of, recalled.targets):
        if target.run_id == earlier.run_id:
            planned = plan.target(target.seq - 1) if 1 <= target.seq <= plan.total else None
            same = ('balls', 'radius', 'phase', 'table_position', 'ball')
            if planned is None or any(getattr(target, name) != getattr(planned, name) for name in same):
                raise CellError(
                    f'resume: run {earlier.run_id}: target {target.seq}: expected '
                    f'{planned or f"one of {plan.total} targets"} as planned, the log has table position '
                    f'{target.table_position}, ball {target.ball} of {target.balls}, phase {target.phase}; the run was '
                    'planned with other settings')
            earlier.add_target(target)
    for answer in map(answer_of, recalled.answers):
        if answer.run_id == earlier.run_id:
            earlier.add_answer(answer)
    return earlier

# SPDX-License-Identifier: Apache-2.0
"""What a log holds of its runs, and the Run that follows from it."""

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.run.errors import InvalidData, kind_of, plain
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.records import CURVES, ErrorMotions, Run
from rosette_ros.core.run.remarks import Remark, RemarkKind, remark
from rosette_ros.io import messages as msg
from rosette_ros.io.bag_metadata import TopicSummary
from rosette_ros.io.identity_file import Identity, parse_identity
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import NO_RUN, RunAssembly
from rosette_ros.io.safe_yaml import parse_mapping
from rosette_ros.io.table_heading import FIRST_DATE

BALL_CENTRE = 'rosette_msgs/msg/BallCentre'
PROBE_TARGET = 'rosette_msgs/msg/ProbeTarget'
RUN_STATE = 'rosette_msgs/msg/RunState'
ERROR_MOTIONS = 'rosette_msgs/msg/ErrorMotions'
CALIBRATION_EVENT = 'rosette_msgs/msg/CalibrationEvent'
DIAGNOSIS = 'rosette_msgs/msg/Diagnosis'
TF_MESSAGE, TF_STATIC = 'tf2_msgs/msg/TFMessage', 'tf_static'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'

REPEATABILITY_KEY, DOF_KEY = 'rosette.repeatability_m', 'rosette.repeatability_dof'
AXES_KEY = 'rosette.repeatability_axes_m'
"""Entries of custom_data where the repeatability is known but was not measured in the log."""
RESUMES_KEY = 'rosette.resumes'  # entry of custom_data, name of the log that a run goes on from
NOTES_KEY = 'rosette.notes'  # the same, how a table was read and what is doubtful in it, a line each
SIMULATED_KEY = 'rosette.simulated'  # entry of custom_data, `yes` where the run was simulated
CMM_NODE, SIMULATED_STATUS = 'cmm', 'simulated_s'
"""Name of the node of a CMM, and the entry of its status on /diagnostics that only a simulated one has."""

IDENTITY_KEY, UNTIL_KEY = 'identity', 'until.probability'  # entries of the settings of a CalibrationEvent
MOST_SETTINGS = 16 << 20  # longest settings in a log, characters


class PublishedMotions(NamedTuple):
    """Error motions as the evaluator published them.

    motions: the result; which: of the curves it is, '' in older logs, whose result is as modelled; modelled: those as
    modelled; is_diagnosed: whether it was looked for what is missing; rms: of the residual as modelled, m."""

    run_id: str
    motions: ErrorMotions
    which: str
    modelled: ErrorMotions
    is_diagnosed: bool
    model_name: str
    completeness: float
    rms: float

    @property
    def judged(self) -> ErrorMotions | None:
        """The result where it is one of curves among which was chosen: it was looked for what is missing."""
        return self.motions if self.which and self.is_diagnosed else None

    @staticmethod
    def of(message: Any) -> 'PublishedMotions':
        """Return those of an ErrorMotions message."""
        def curves(of: Any) -> ErrorMotions:
            return ErrorMotions.from_curves(message.angle, [getattr(of, curve) for curve in CURVES],
                                            [getattr(of, f'u_{curve}') for curve in CURVES], rotation)

        rotation, which = msg.rotation_of_motions(message), plain(getattr(message, 'which', ''))
        motions = curves(message)
        return PublishedMotions(
            plain(message.run_id), motions, which, curves(message.modelled) if which else motions,
            bool(getattr(message, 'diagnosed', False)), plain(message.model_name, 4000), float(message.completeness),
            float(message.residual_rms))


RECORDS: dict[str, Callable[[Any], msg.Target | msg.Answer | msg.CalibrationProgress]] = {
    PROBE_TARGET: msg.target_of, BALL_CENTRE: msg.answer_of, RUN_STATE: msg.progress_of}
"""By type of a message that has to be readable, the function that makes the record of it."""
NEEDED = frozenset((*RECORDS, ERROR_MOTIONS, DIAGNOSIS, CALIBRATION_EVENT, TF_MESSAGE, DIAGNOSTICS))
"""Types of the messages that a LogRun takes."""

_KINDS = {str: 'a text', float: 'a number', int: 'a whole number of 32 bits'}


def check_version(type_name: str, schema_text: str, message: SimpleNamespace) -> None:
    """Refuse a message that lacks fields of its record or has other kinds of values in them.

    The schema decides this for all of its messages. Raises InvalidData."""
    fields = ', '.join(vars(type(message))['__slots__'])
    wide = re.findall(r'^[ \t]*u?int64[ \t]+(\w+)', schema_text, re.MULTILINE)
    advice = 'it was written with another version of the message'
    try:
        stamp = message.header.stamp
        if {type(stamp.sec), type(stamp.nanosec)} != {int} or {'sec', 'nanosec'} & {*wide}:
            raise InvalidData(f'header.stamp: expected whole numbers of 32 bits, the log has others; {advice}')
        record = RECORDS[type_name](message)
    except AttributeError as error:
        raise InvalidData(f'expected the field {error.name}, the log has {fields}; {advice}') from error
    for name, wanted in type(record).__annotations__.items():
        value = getattr(record, name)
        for one, kind in zip(value, (float,) * 3) if isinstance(value, tuple) else ((value, wanted),):
            if type(one) not in ((int, float) if kind is float else (kind,)) or (kind is int and name in wide):
                raise InvalidData(f'{name}: expected {_KINDS[kind]}, the log has {kind_of(one)}; {advice}')


@dataclass(eq=False)
class LogRun:
    """What a log holds.

    runs: what was asked and answered, by run_id, in order of appearance; frames: in order of receipt; states: the last
    of each run; events: CalibrationEvents, decoded; is_cmm_simulated: whether the status of the CMM says so; verdicts:
    the last of the evaluator by run_id and name of the model; asked: after how many readings it was asked whether a run
    is settled, by run_id, and until which probability it is not, 0 for any; first_ns: log time of the first reading of
    each run, alignment and repeatability before it left out; start_ns, end_ns: first and last log time; truncated:
    whether the log ends in the middle; problems: what is wrong with it, in words."""

    path: Path
    files: tuple[Path, ...]
    runs: dict[str, RunAnswers] = field(default_factory=dict)
    frames: list[msg.TableFrame] = field(default_factory=list)
    error_motions: list[PublishedMotions] = field(default_factory=list)
    states: list[msg.CalibrationProgress] = field(default_factory=list)
    events: list[SimpleNamespace] = field(default_factory=list)
    is_cmm_simulated: bool = False
    verdicts: dict[tuple[str, str], VerdictText | None] = field(default_factory=dict)
    asked: dict[str, tuple[float, list[int]]] = field(default_factory=dict)
    first_ns: dict[str, int] = field(default_factory=dict)
    topics: tuple[TopicSummary, ...] = ()
    messages: int = 0
    start_ns: int = 0
    end_ns: int = 0
    truncated: bool = False
    problems: tuple[str, ...] = ()
    custom_data: dict[str, str] = field(default_factory=dict)

    def add(self, type_name: str, message: SimpleNamespace, log_time: int) -> None:
        """Take a decoded message of one of the types in NEEDED, and when it was recorded, ns since the epoch."""
        if type_name == PROBE_TARGET:
            target = msg.target_of(message)
            self._run(target.run_id).add_target(target)
        elif type_name == BALL_CENTRE:
            self._add_answer(msg.answer_of(message), log_time)
        elif type_name == RUN_STATE:
            state = msg.progress_of(message)
            self.states = [*(one for one in self.states if one.run_id != state.run_id), state]
        elif type_name == ERROR_MOTIONS:
            self.error_motions.append(PublishedMotions.of(message))
        elif type_name == CALIBRATION_EVENT:
            self.events.append(message)
            if message.kind == msg.EXTENDED:
                self._add_asked(message)
        elif type_name == DIAGNOSIS:
            self.verdicts[plain(message.run_id), plain(message.model_name, 4000)] = msg.verdict_of(message)
        elif type_name == DIAGNOSTICS:
            self.is_cmm_simulated |= any(
                one.name.rpartition('/')[2] == CMM_NODE and any(value.key == SIMULATED_STATUS for value in one.values)
                for one in message.status)
        else:
            self.frames += [frame for one in message.transforms if (frame := msg.table_frame_of(one))]

    def _add_answer(self, answer: msg.Answer, log_time: int) -> None:
        run = self._run(answer.run_id)
        run.add_answer(answer)
        target = run.last_target(answer.seq)
        if target is not None and target.phase == msg.Phase.RUN and answer.is_usable_for(target):
            self.first_ns.setdefault(answer.run_id, log_time)

    def _add_asked(self, event: SimpleNamespace) -> None:
        """Take that it was asked whether a run is settled."""
        if event.run_id in self.runs:
            until = self._settings_of(event).get(UNTIL_KEY)
            sizes = self.asked.setdefault(event.run_id, (until if isinstance(until, float) else 0.0, []))[1]
            size = self.runs[event.run_id].counts().get(msg.Phase.RUN, (0, 0))[1]
            sizes += [size] * (size not in (0, *sizes))

    @staticmethod
    def _settings_of(event: SimpleNamespace) -> dict[str, Any]:
        """Return what a run was planned with, nothing where that cannot be read: it counts when a run is resumed."""
        with suppress(InvalidData):
            return dict(parse_mapping(event.settings, 'settings', MOST_SETTINGS, '', InvalidData))
        return {}

    def _run(self, run_id: str) -> RunAnswers:
        if run_id not in self.runs:
            self.runs[run_id] = RunAnswers(run_id, self.frames)
        return self.runs[run_id]

    @property
    def targets(self) -> list[msg.Target]:
        """All targets, run by run, in order of receipt."""
        return [target for run in self.runs.values() for target in run.targets]

    @property
    def answers(self) -> list[msg.Answer]:
        """All answers, run by run, in order of receipt."""
        return [answer for run in self.runs.values() for answer in run.answers]

    @property
    def damage(self) -> tuple[Remark, ...]:
        """The first of its problems and how many more there are, nothing where it is whole."""
        return (remark(RemarkKind.LOG_DAMAGED, problem=self.problems[0], others=len(self.problems) - 1),) if (
            self.problems) else ()

    @property
    def simulated(self) -> bool:
        """Whether its recorder or its CMM says so; anybody may publish a /clock."""
        return self.is_cmm_simulated or self.custom_data.get(SIMULATED_KEY) == 'yes'

    @property
    def unasked(self) -> tuple[str, ...]:
        """Answers with a run_id that no target has, in words."""
        return tuple(f'{len(run.answers) + run.dropped} answers repeat the run_id {name!r}, which no target has'
                     for name, run in self.runs.items() if not run.targets)

    @property
    def run_ids(self) -> tuple[str, ...]:
        """The runs with targets of phase RUN, in order of appearance."""
        return tuple(name for name, run in self.runs.items() if any(one.phase == msg.Phase.RUN for one in run.targets))

    def run(self, run_id: str | None = None) -> RunAnswers:
        """Return the run to take among those that have begun: `run_id`, or the only one there is.

        Raises InvalidData where there is none, another, or more than one without a choice."""
        present = self.run_ids
        if not present:
            raise InvalidData(f'{self.path}: {NO_RUN}' if self.targets else f'{self.path}: expected probe targets '
                              f'({PROBE_TARGET}), found none beside {len(self.answers)} ball centres; record both')
        if run_id is None and len(present) > 1:
            raise InvalidData(f'{self.path}: expected one run, found {len(present)}: {", ".join(present)}; choose one '
                              'by '
                              'its run_id')
        if run_id not in (None, *present):
            raise InvalidData(f'{self.path}: expected run {run_id!r}, found {", ".join(present)}')
        return self.runs[present[0] if run_id is None else run_id]

    def identity(self, run_id: str) -> Identity:
        """Return the Identity that the sequencer was given for a run, an empty one where there is none."""
        found = ''
        for event in self.events:
            if event.run_id == run_id and f'{IDENTITY_KEY}:' in event.settings:
                found = self._settings_of(event).get(IDENTITY_KEY) or found
        return parse_identity(str(found).encode(), f'{self.path}: identity') if found else Identity()

    def latest_error_motions(self, run_id: str | None = None) -> PublishedMotions | None:
        """Return the PublishedMotions that came last (of one run), or None."""
        return next((one for one in reversed(self.error_motions) if run_id in (None, one.run_id)), None)

    def frame_of(self, run_id: str) -> Frame | None:
        """Return the table frame in the machine frame that holds for a run; see RunAnswers.frame.

        None where its centres were given in the table frame."""
        run = self.runs[run_id]
        return None if run.is_in_table_frame else RunAssembly(run, str(self.path)).frame()

    def begun_ns(self, run_id: str) -> int:
        """Return when measuring a run began by the clock of its recorder, ns since the epoch: its first reading, the
        begin of the log where there is none yet."""
        return self.first_ns.get(run_id, self.start_ns)

    def to_run(self, run_id: str | None = None) -> Run:
        """Return the Run of the log; run_id chooses where there are several.

        Raises InvalidData where there is no ball centre, or no one run; see RunAnswers.to_run."""
        source = str(self.path)
        if not any(run.answers for run in self.runs.values()):
            topics = ', '.join(topic.name for topic in self.topics) or 'none'
            raise InvalidData(f'{source}: expected ball centres ({BALL_CENTRE}), found none in {self.messages} '
                              'messages '
                              f'(topics: {topics}){"".join(f"; {problem}" for problem in self.problems[:1])}')
        stated = self._stated_repeatability()
        run = RunAssembly(self.run(run_id), source, stated[0] if stated else None).run()
        begun = 1e-9 * self.begun_ns(run.run_id)
        run = run.replace(remarks=(*self.damage, *run.remarks), simulated=self.simulated,
                          begun=begun if begun > FIRST_DATE else None)
        if run.repeatability is not None or stated is None:
            return run
        sigma, dof, axes = stated
        return run.replace(repeatability=sigma, repeatability_dof=dof, repeatability_axes=axes)

    def _stated_repeatability(self) -> tuple[float, float | None, tuple[float, float, float] | None] | None:
        """Return the repeatability that is known but was not measured in the log, m, its degrees of freedom, and that
        of x, y, z."""
        if REPEATABILITY_KEY not in self.custom_data:
            return None
        try:
            sigma = float(self.custom_data[REPEATABILITY_KEY])
            dof = float(self.custom_data[DOF_KEY]) if DOF_KEY in self.custom_data else None
            x, y, z = map(float, self.custom_data.get(AXES_KEY, '0 0 0').split())
        except ValueError as error:
            raise InvalidData(f'{self.path}: custom_data: {REPEATABILITY_KEY}: expected a number, found '
                              f'{self.custom_data[REPEATABILITY_KEY]!r}') from error
        return sigma, dof, (x, y, z) if x else None

# SPDX-License-Identifier: Apache-2.0
"""A calibration from its request on: what was asked, what is planned, what came of it."""

from dataclasses import dataclass, field
from datetime import UTC, datetime

from rosette_msgs.msg import ErrorMotions

from rosette_ros.core.errors import CellError
from rosette_ros.nodes.resume import check_wishes, earlier_in, latest_stamp, run_begin
from rosette_ros.nodes.sequence import Sequence
from rosette_ros.nodes.settings import (
    RESUME,
    format_settings,
    limits_of,
    parse_settings,
    programme_of,
    run_name,
    wanted_changes,
)


@dataclass(frozen=True)
class Request:
    """Who asks for a calibration: the door, and the goal as it was given."""

    origin: str
    order: str = ''
    seed: int = 0
    options: str = ''


@dataclass(eq=False)
class Job:
    """The calibration that is on: its sequence, its goal (None: the service's), its log.

    settings: what it was planned with, YAML; resumes: name of the log that it goes on from, '' for none;
    since: steady time at which it was taken on, s; is_waiting: for the nodes to be connected; stamp_ns: latest
    ROS time of the run so far, ns; located_ns: when its run began in an earlier part, ns, 0 if it did not;
    lives: the processes of the nodes that serve it, by node; opening, recording: whether its
    log is being opened, is open; motions: as published.
    """

    sequence: Sequence
    request: Request
    order: str
    settings: str = ''
    resumes: str = ''
    goal: object = None
    log: str = ''
    since: float = 0.0
    is_waiting: bool = False
    stamp_ns: int = 0
    located_ns: int = 0
    lives: dict = field(default_factory=dict)
    opening: bool = True
    recording: bool = False
    motions: ErrorMotions = field(default_factory=ErrorMotions)

    @property
    def run_id(self):
        """The name of the run."""
        return self.sequence.run_id

    @property
    def is_over(self):
        """Whether nothing is measured any more; the log may still be open."""
        return self.sequence.phase.is_end

    def go_on_from(self, recalled):
        """Go on from what the recorder has recalled, a Recall.Response, in a new session."""
        before = self.sequence
        self.sequence = Sequence(self.run_id, before.programme, before.limits,
                                 earlier_in(recalled, before.programme, before.session))
        self.resumes, self.located_ns = recalled.log, run_begin(recalled)


def make_job(request, configured, taken, recalled=None):
    """Return the Job of a request.

    configured: the settings of the sequencer, name to value; taken: run_ids that are used; recalled: the
    Recall.Response of the run that is gone on with, None for a new run. Raises RosetteError with the reason why not.
    """
    changes = wanted_changes(request.order, request.seed, request.options)
    changes.pop(RESUME.name, None)
    values = {**configured, **changes}
    if recalled is not None:
        return _resumed_job(request, recalled, changes, values)
    run_id = run_name(datetime.now(UTC), values['order'], taken)
    sequence = Sequence(run_id, programme_of(values), limits_of(values))
    return Job(sequence, request, values['order'], format_settings(values))


def _resumed_job(request, recalled, changes, values):
    """Return the Job that measures what an earlier part of a run lacks."""
    if not recalled.success:
        raise CellError(recalled.message)
    run_id = recalled.run_id
    told = [event.settings for event in recalled.events if event.settings]
    settings = parse_settings(told[-1], f'resume: run {run_id}') if told else values
    check_wishes(changes, settings, run_id)
    values = {**values, **settings}
    programme = programme_of(values)
    earlier = earlier_in(recalled, programme)
    if len(earlier.answers) == programme.total and recalled.error_motions:
        raise CellError(f'resume: run {run_id} lacks nothing: all {programme.total} targets are answered and '
                        'its error motions are published')
    sequence = Sequence(run_id, programme, limits_of(values), earlier)
    return Job(sequence, request, values['order'], format_settings(values), recalled.log,
               stamp_ns=latest_stamp(recalled), located_ns=run_begin(recalled))

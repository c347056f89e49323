# SPDX-License-Identifier: Apache-2.0
"""A run as a verb opens it, several runs as one, and what follows from them."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from rich.console import Console

from rosette_ros.api.archived_runs import places_asked_for
from rosette_ros.api.evaluating import JointEvaluation, evaluated_jointly
from rosette_ros.api.measurement import JudgedRun, Measurement, read
from rosette_ros.archive.run_question import Question
from rosette_ros.cli.arguments import UsageError
from rosette_ros.cli.console import doing, head, print_verdict, warn
from rosette_ros.cli.questions import add_question, question_of
from rosette_ros.io.open_run import has_plate
from rosette_ros.words.verdict_words import verdict_text


class Opened(JudgedRun):
    """RUN with --run-id, --columns and --identity, --model, --inputs, --environment and --experience, and what
    follows from them; a verb without such an option gives none.

    path: of another run than RUN, or of the first where there are several."""

    def __init__(self, options: Namespace, path: str | None = None) -> None:
        given = vars(options)
        measured = read(given['run_path'] if path is None else path, given.get('columns'), given.get('run_id'),
                        given.get('identity'))
        super().__init__(measured, given.get('model'), given.get('inputs'), given.get('environment'), doing,
                         given.get('experience'), given.get('any_cell', False))

    def begin(self, out: Console) -> None:
        """Print what was measured, and the verdict or, where there is none, what is wrong with the readings."""
        out.print(head(self.run))
        if self.verdict:
            print_verdict(out, verdict_text(self.verdict))
        else:
            warn(self.run)


def add_archived(parser: ArgumentParser) -> None:
    """Add --archive, and what the archive is asked for."""
    group = parser.add_argument_group('runs of an archive, with RUN or in its place')
    group.add_argument('--archive', metavar='ARCHIVE', help='take the runs of an archive that are asked for: all that '
                       'these options leave, as of archive query; their logs are read where they were found')
    add_question(group)


def take_archived(options: Namespace) -> None:
    """Take the runs of the archive to those of the options; raises UsageError where there is none of either."""
    asked = question_of(options)
    if options.archive is None and asked != Question({}):
        raise UsageError('expected --archive ARCHIVE with what an archive is asked for, found none')
    if options.archive is None and not options.run_path:
        raise UsageError('expected RUN or --archive ARCHIVE, found neither')
    given = vars(options).get('run_id')
    found = places_asked_for(options.archive, asked) if options.archive else []
    options.run_ids = [*[given] * len(options.run_path), *(run_id or None for _, run_id in found)]
    options.run_path = [*options.run_path, *(path for path, _ in found)]
    if len(options.run_path) == 1:
        options.run_id = options.run_ids[0]


def every_run(options: Namespace) -> list[Measurement]:
    """Return the runs of the options, those of the archive among them."""
    columns = vars(options).get('columns')
    return [read(path, columns, run_id) for path, run_id in zip(options.run_path, options.run_ids, strict=True)]


def add_joint(parser: ArgumentParser) -> None:
    """Add --joint and --share."""
    parser.add_argument('--joint', action='store_true', help='evaluate several runs as one; what they share is taken '
                        'from the runs, tested, and told')
    parser.add_argument('--share', metavar='FILE', help='what the runs share, where a person knows better (YAML, '
                        'rosette-sharing/1); implies --joint')


def is_joint(options: Namespace) -> bool:
    """Return whether the runs are evaluated as one, as plates of any pitch always are; raises UsageError."""
    is_wanted = options.joint or options.share or any(map(has_plate, options.run_path))
    if not is_wanted and len(options.run_path) > 1:
        raise UsageError(f'expected one RUN, found {len(options.run_path)}; --joint evaluates several as one')
    if is_wanted and (options.model or (options.run_id and len(options.run_path) > 1)):
        raise UsageError('--joint: expected no --model and, for several runs, no --run-id, found '
                         f'{"--model" if options.model else "--run-id"}; the base model is fitted to whole logs')
    if is_wanted and vars(options).get('experience'):
        raise UsageError('--joint: expected no --experience, found one; it is of single runs')
    if is_wanted and getattr(options, 'refit_spheres', False):
        plates = [path for path in options.run_path if has_plate(path)]
        raise UsageError('--refit-spheres: expected the log of a run, which has its touches, found the table '
                         f'{plates[0]} '
                         'with ball centres only; leave the option out' if plates and len(options.run_path) == 1 else
                         '--refit-spheres: expected one run, found several as one; leave --joint out')
    return bool(is_wanted)


def joint(options: Namespace, where: Sequence[float] = ()) -> JointEvaluation:
    """Return the joint evaluation of the runs of the options; where: as of `evaluated_jointly`."""
    return evaluated_jointly(every_run(options), options.inputs, options.environment, options.share, options.identity,
                             where)

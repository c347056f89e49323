# SPDX-License-Identifier: Apache-2.0
"""A run as a verb opens it, several runs as one, and what follows from them."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from functools import cached_property

from rich.console import Console

from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, find, in_environment, stated_budget
from rosette_ros.cli.arguments import UsageError
from rosette_ros.cli.console import doing, head, print_verdict, warn
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.joint.joint_evaluation import JointResult, evaluate_jointly
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.error_summary import refuted
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.io.budget_file import budget_inputs, environment_of, read_stated
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import has_plate, open_identified, open_readings
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.words.verdict_words import verdict_text


class Opened:
    """RUN with --run-id, --columns and --identity, --model, --inputs and --environment, and what follows from them; a
    verb without such an option gives none.

    path: of another run than RUN, or of the first where there are several."""

    def __init__(self, options: Namespace, path: str | None = None) -> None:
        given = vars(options)
        self.path: str = given['run_path'] if path is None else path
        self.run, self.identity, _ = open_identified(self.path, given.get('run_id'), given.get('identity'),
                                                         read_columns(given.get('columns')))
        self._model_file: str | None = given.get('model')
        self._stated: tuple[str | None, str | None] = given.get('inputs'), given.get('environment')

    @cached_property
    def model(self) -> Model:
        """That of the file, the base model without one."""
        return read_model(self._model_file)

    @cached_property
    def inputs(self) -> BudgetInputs | None:
        """What is stated for the uncertainty budget, None where nothing is."""
        stated = read_stated(*self._stated)
        return budget_inputs(stated, self._stated[0] or 'budget inputs') if stated else None

    @cached_property
    def fit(self) -> Fit:
        """The least squares."""
        with doing('evaluating'):
            return analyse(self.run, self.model)

    @cached_property
    def finding(self) -> Diagnosis | None:
        """What is missing, None where the plate has too many balls to judge it unasked."""
        if self.run.n > MOST_BALLS_JUDGED:
            return None
        fit = self.fit
        with doing('looking for what is missing'):
            return find(fit.run, fit.model)

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None as for `finding`."""
        return in_environment(
            self.finding.verdict, self.finding.final, self.inputs.environment if self.inputs else None
        ) if self.finding else None

    def budget_of(self, fit: Fit) -> Budget | None:
        """Return the budget of a fit, None where nothing is stated."""
        if not self.inputs:
            return None
        return stated_budget(fit, self.inputs, self.finding, refuted(self.verdict))

    @cached_property
    def motions(self) -> ErrorMotions:
        """The six curves, with U and, in an environment, the mean over explanations that are stated."""
        made = self.budget_of(self.fit)
        return made.error_motions if made else self.fit.error_motions

    def begin(self, out: Console) -> None:
        """Print what was measured, and the verdict or, where there is none, what is wrong with the readings."""
        out.print(head(self.run))
        if self.verdict:
            print_verdict(out, verdict_text(self.verdict))
        else:
            warn(self.run)


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
        raise UsageError(f'wanted one RUN, got {len(options.run_path)}; --joint evaluates several as one')
    if is_wanted and (options.model or (options.run_id and len(options.run_path) > 1)):
        raise UsageError('--joint: wanted no --model and, for several runs, no --run-id, got '
                         f'{"--model" if options.model else "--run-id"}; the base model is fitted to whole logs')
    if is_wanted and getattr(options, 'refit_spheres', False):
        plates = [path for path in options.run_path if has_plate(path)]
        raise UsageError(f'--refit-spheres: wanted the log of a run, which has its touches, got the table {plates[0]} '
                         'with ball centres only; leave the option out' if plates and len(options.run_path) == 1 else
                         '--refit-spheres: wanted one run, got several as one; leave --joint out')
    return bool(is_wanted)


def joint_result(options: Namespace, runs: Sequence[Readings] = ()) -> JointResult:
    """Return the runs of the options evaluated as one, in the environment that is stated; runs: where they are read."""
    stated = read_stated(options.inputs, options.environment)
    columns = read_columns(vars(options).get('columns'))
    return evaluate_jointly(runs or [open_readings(path, options.run_id, columns) for path in options.run_path],
                            read_sharing(options.share, len(options.run_path)),
                            environment_of(stated, options.inputs or 'budget inputs'))

# SPDX-License-Identifier: Apache-2.0
"""Arguments of the verbs that take several runs as one."""

import argparse
from collections.abc import Sequence

from rosette_ros.cli.arguments import UsageError
from rosette_ros.core.joint.joint_evaluation import JointResult, evaluate_jointly
from rosette_ros.core.joint.readings import Readings
from rosette_ros.io.budget_file import environment_of, read_stated
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.open_run import has_plate, open_readings
from rosette_ros.io.sharing_file import read_sharing


def add_joint(parser: argparse.ArgumentParser) -> None:
    """Add --joint and --share."""
    parser.add_argument('--joint', action='store_true', help='evaluate several runs as one; what they share is taken '
                        'from the runs, tested, and told')
    parser.add_argument('--share', metavar='FILE', help='what the runs share, where a person knows better (YAML, '
                        'rosette-sharing/1); implies --joint')


def is_joint(options: argparse.Namespace) -> bool:
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


def joint_result(options: argparse.Namespace, runs: Sequence[Readings] = ()) -> JointResult:
    """Return the runs of the options evaluated as one, in the environment that is stated; runs: where they are read."""
    stated = read_stated(options.inputs, options.environment)
    columns = read_columns(vars(options).get('columns'))
    return evaluate_jointly(runs or [open_readings(path, options.run_id, columns) for path in options.run_path],
                            read_sharing(options.share, len(options.run_path)),
                            environment_of(stated, options.inputs or 'budget inputs'))

# SPDX-License-Identifier: Apache-2.0
"""rosette check-cmm: tries a CMM before a calibration and says what its node does wrong."""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from rosette_ros.cell.cmm_check import CmmClient, CmmReport
from rosette_ros.cli.arguments import add_shared, positive, whole
from rosette_ros.cli.console import console, print_checks, print_json
from rosette_ros.core.errors import CellError
from rosette_ros.presentation.formatting import duration, signs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = ('The machine moves: ball 1 several times, at three table positions over a full turn forward and '
                     'backwards, then ball 2.\nPlate and table are those of the sequencer, if one is running.')
    parser.add_argument('--balls', metavar='N', type=whole(3, 1000), help='balls on the plate')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), help='radius of the circle of ball centres')
    parser.add_argument('--origin-mm', metavar=('X', 'Y', 'Z'), type=float, nargs=3,
                        help='where the centre of the plate roughly is, machine coordinates')
    parser.add_argument('--axis', metavar=('X', 'Y', 'Z'), type=float, nargs=3,
                        help='direction of the table axis, machine coordinates')
    parser.add_argument('--azimuth-deg', metavar='A', type=float,
                        help='where ball 1 roughly is at table angle 0, counted about the axis (docs/real-cmm.md)')
    parser.add_argument('--repeats', metavar='K', type=whole(2, 1000), default=5,
                        help='readings of the repeatability (default 5)')
    parser.add_argument('--timeout', metavar='S', type=positive('s'), help='wait for an answer no longer')
    parser.add_argument('--recover', action='store_true', help='tell a CMM that waits for a person (after a collision, '
                        'an emergency stop, a lost connection) that one has looked at it; nothing else')
    add_shared(parser, '--json', '--namespace', '--domain')


def run(options: argparse.Namespace) -> None:
    """Print what was found; raises CellError where a check is not passed."""
    if options.recover:
        with CmmClient(options.domain, options.namespace) as client:
            console().print(client.recover())
        return
    given = {
        'plate.balls': options.balls, 'plate.radius_m': options.radius_mm and 1e-3 * options.radius_mm,
        'table.origin_m': options.origin_mm and [1e-3 * value for value in options.origin_mm],
        'table.axis': options.axis, 'table.azimuth_deg': options.azimuth_deg,
        'limits.answer_timeout_s': options.timeout}
    with CmmClient(options.domain, options.namespace) as client, console(sys.stderr).status('waiting') as status:
        settings = client.settings(given)
        if not client.has_sequencer:  # said before anything moves
            status.console.print(f'No sequencer was found. What was not given is by default: {_place(settings)}.')
        report = client.check(settings, options.repeats, status.update)
    if options.json:
        print_json({'schema': 'rosette-cmm-check/1', 'passed': not report.failed,
                    'checks': [asdict(check) for check in report.checks], 'seconds_per_ball': report.seconds_per_ball,
                    'run_seconds': report.run_seconds, 'repeatability_m': report.repeatability})
    else:
        show(report, f'{_place(settings)}; what was not given is '
                     f'{"as the sequencer is configured" if client.has_sequencer else "by default"}.')
    if report.failed:
        raise CellError(f'check-cmm: {len(report.failed)} of {len(report.checks)} checks are not passed: '
                        f'{", ".join(report.failed)} (docs/real-cmm.md)')


def _place(settings: Mapping[str, Any]) -> str:
    """Return plate and table in words."""
    origin = ' '.join(f'{1e3 * value:g}' for value in settings['table.origin_m'])
    return (f'{settings["plate.balls"]} balls, R = {1e3 * settings["plate.radius_m"]:g} mm, centre of the plate at '
            f'{signs(origin)} mm')


def show(report: CmmReport, plate: str) -> None:
    """Print a report for a person; plate: which one was asked for, in words."""
    time = '' if report.seconds_per_ball is None or report.run_seconds is None else (
        f'A ball takes {duration(report.seconds_per_ball)}, a calibration about {duration(report.run_seconds)}.')
    print_checks('cmm_check', 'What the CMM answers', report.checks, f'{plate} {time}'.strip())

# SPDX-License-Identifier: Apache-2.0
"""rosette calibrate: requests a calibration of a running cell and ends with its result."""

import argparse
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

from rosette_ros.calibration.settings import FIELDS, LIMITS, OPTIONS, PLATE, RUN
from rosette_ros.calibration.state_machine import PAUSE
from rosette_ros.cell.client import CalibrationOutcome, CellClient
from rosette_ros.cli.arguments import UsageError, add_places, add_shared, add_table_offset, positive, whole
from rosette_ros.cli.console import console, print_parts, print_verdict
from rosette_ros.core.errors import CellError
from rosette_ros.core.scheme import ORDERS
from rosette_ros.io.messages import PHASE_WORDS, CalibrationProgress
from rosette_ros.io.plan_file import format_plan, read_plan
from rosette_ros.io.plate_file import format_plate, read_plate
from rosette_ros.presentation.tables import curves

KEPT = 'what was measured is in'
AS_CONFIGURED = ('balls', 'turning', 'repeats', 'drift_check', 'attempts', 'skips', 'touches')
"""Fields of the goal that are options of the same name: type, range and meaning are those of the setting."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--order', default='',
                        help=f'one of {", ".join(ORDERS)} (default: as the sequencer is configured)')
    parser.add_argument('--seed', type=whole(0, 2**53), default=0, help='draws the order random')
    parser.add_argument('--radius-mm', type=positive('mm'), help='nominal radius of the circle of ball centres')
    known = {wanted.name: wanted for wanted in (*PLATE, *RUN, *LIMITS)}
    for field in AS_CONFIGURED:
        wanted = known[FIELDS[field]]
        kind: dict[str, Any] = ({'choices': wanted.choices} if wanted.choices else
                                {'action': argparse.BooleanOptionalAction} if isinstance(wanted.default, bool) else
                                {'type': whole(int(wanted.low), int(wanted.high))})
        parser.add_argument(f'--{field.replace("_", "-")}', help=wanted.text, **kind)
    add_places(parser)
    add_table_offset(parser)
    parser.add_argument('--plan', metavar='FILE', help='measure a plan file (rosette plan --output FILE) instead of '
                        'an order')
    add_shared(parser, '--plate')
    parser.add_argument('--options', metavar='YAML', default='',
                        help='further options of the goal, such as "limits.answer_timeout_s: 30"; '
                             f'known: {", ".join(one.name for one in OPTIONS)}')
    parser.add_argument('--resume', metavar='RUN', help='continue a run that was interrupted: its log, by name or path')
    parser.add_argument('--joint-with', metavar='RUN', nargs='+', help='evaluate the run as one with these finished '
                        'ones, by name; the cell keeps the last four, this one included')
    add_shared(parser, '--namespace', '--domain')


def run(options: argparse.Namespace) -> None:
    """Run the calibration to its end; Ctrl-C cancels it. Raises CellError where it is not evaluated with others."""
    if options.resume is not None and not options.resume.strip():
        raise UsageError('--resume: wanted the log of a run, by name or path, got nothing; without --resume a new '
                         'run begins')
    resume = options.resume or ''
    if resume and Path(resume).is_dir():  # on this computer: by its whole path
        resume = str(Path(resume).resolve())
    plan = format_plan(read_plan(options.plan)) if options.plan else ''
    with CellClient(options.domain, options.namespace) as client:
        outcome = calibrate(
            client, order=options.order, seed=options.seed, options=options.options, resume=resume, plan=plan,
            plate=format_plate(read_plate(options.plate)) if options.plate else '',
            radius=options.radius_mm and 1e-3 * options.radius_mm,
            table_offset=options.table_offset_deg and math.radians(options.table_offset_deg),
            joint_with=options.joint_with and [Path(run).absolute().name for run in options.joint_with],
            **{field: getattr(options, field) for field in (*AS_CONFIGURED, 'cmm_positions', 'balls_in_use')})
    out = console()
    out.print(f'[bold]{escape(outcome.run_id)}[/]')
    print_parts(out, [curves(outcome.error_motions) if outcome.error_motions else None])
    lacks_joint = options.joint_with and outcome.success and not outcome.is_joint
    if not lacks_joint:
        out.print(f'\n{escape(outcome.message)}', soft_wrap=True)
    if outcome.verdict:
        print_verdict(out, outcome.verdict)
    if outcome.log:
        out.print(f'\nLog: {escape(str(outcome.log))}', soft_wrap=True)
    if lacks_joint:
        raise CellError(f'calibrate: --joint-with: the runs were not evaluated as one: {outcome.message}')


def calibrate(client: CellClient, **goal: Any) -> CalibrationOutcome:
    """Run a calibration with progress on stderr and return its successful outcome; goal: of CellClient.calibrate.

    Raises CellError where the cell refuses, fails or disconnects, KeyboardInterrupt where it was cancelled.
    """
    with ProgressDisplay() as display:
        try:
            outcome = client.calibrate(on_progress=display.show, on_warning=display.warn, **goal)
        except TimeoutError as error:
            raise CellError(f'{error}; see the output of the sequencer') from error
    text = outcome.message.removesuffix(f'; {KEPT} the log').removesuffix('; nothing was measured')
    text += (f'; {KEPT} {outcome.log}; continue with: {client.resume_command(outcome.log)}'
             if outcome.log and client.measured else '; nothing was measured')
    if outcome.cancelled:
        raise KeyboardInterrupt(text)
    if PAUSE in outcome.message:
        return replace(outcome, message=text)
    if not outcome.success:
        raise CellError(f'calibration failed: {text}')
    return outcome


class ProgressDisplay(Progress):
    """Shows the progress of a calibration on stderr: a bar on a terminal, and a line per phase, which stays."""

    def __init__(self) -> None:
        out = console(sys.stderr)
        super().__init__(SpinnerColumn(), BarColumn(bar_width=16), MofNCompleteColumn(),
                         TextColumn('{task.fields[rate]}'), TextColumn('{task.description}', markup=False), console=out,
                         transient=True, disable=not out.is_terminal)
        self._bar = self.add_task('waiting for the cell', total=None, rate='')
        self._phase: int | None = None
        self._began, self._from, self._done = 0.0, 0, 0

    def stop(self) -> None:
        """End the display."""
        self._end_phase()
        super().stop()

    def show(self, progress: CalibrationProgress) -> None:
        """Show the progress."""
        self._done = max(self._done, progress.done)
        phase = progress.phase if progress.is_running else None
        if phase != self._phase:
            self._end_phase()
            self._phase, self._began, self._from = phase, time.monotonic(), self._done
        balls, spent = self._spent()
        self.update(self._bar, completed=self._done, total=progress.total,
                    description='' if phase is None else progress.text,
                    rate=f'{balls / spent:.0f} balls/s' if balls > 1 and spent > 0.2 else '')

    def warn(self, words: str) -> None:
        """Show what a node of the cell warns of."""
        self.console.print(f'  [yellow]{escape(words)}[/]', soft_wrap=True)

    def _spent(self) -> tuple[int, float]:
        """Return the balls measured in this phase and its wall time so far, s."""
        return self._done - self._from, time.monotonic() - self._began

    def _end_phase(self) -> None:
        if self._phase is not None:
            balls, spent = self._spent()
            what = f'{balls:4d} balls' if balls else ' ' * 10
            self.console.print(f'  {PHASE_WORDS[self._phase]:<22}{what}  {spent:5.1f} s')
        self._phase = None

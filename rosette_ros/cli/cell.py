# SPDX-License-Identifier: Apache-2.0
"""A whole cell on this computer, a calibration in a running one, the trial of a CMM before it."""

import argparse
import contextlib
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

from rosette_ros.api.measurement import refuse_other_cell
from rosette_ros.calibration.settings import EXPERIENCE, FIELDS, IDENTITY, LIMITS, OPTIONS, PLATE, RUN
from rosette_ros.cell.client import CalibrationOutcome, CellClient, HangDetector
from rosette_ros.cell.cmm_check import CmmClient
from rosette_ros.cell.supervisor import CHECK_PERIOD, MODULES, MOST_PARAMETERS, Cell
from rosette_ros.cli.arguments import (
    IN_LOG,
    SHARED,
    UsageError,
    add_places,
    add_shared,
    add_table_offset,
    made_folder,
    number,
    positive,
    until,
    whole,
)
from rosette_ros.cli.console import console, print_checks, print_json, print_parts, print_verdict
from rosette_ros.core.run.errors import CellError, InvalidConfig
from rosette_ros.core.run.scheme import ORDERS
from rosette_ros.dme.dme_settings import sequencer_parameters
from rosette_ros.invocation import command
from rosette_ros.io.experience_file import read_experience
from rosette_ros.io.identity_file import read_identity
from rosette_ros.io.messages import PHASE_WORDS, CalibrationProgress
from rosette_ros.io.plan_file import format_plan, read_plan
from rosette_ros.io.plate_file import format_plate, read_plate
from rosette_ros.io.safe_yaml import read_yaml
from rosette_ros.nodes import names
from rosette_ros.nodes.dme_cmm import settings_of
from rosette_ros.nodes.parameters import sections
from rosette_ros.presentation.formatting import duration, signs
from rosette_ros.presentation.tables import curves
from rosette_ros.simulation import MachineConfig, load_machine
from rosette_ros.words.calibration_words import CONTINUE

CMMS = ('simulated', 'dme')
DME = CMMS[1]
ROUNDING = 1e-9  # m


def cell_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--no-simulation', action='store_true',
                        help='without the simulated CMM: a real one answers, in wall time')
    parser.add_argument('--cmm', choices=CMMS, default=CMMS[0],
                        help='simulated (default), or one with an I++ DME server, in wall time')
    parser.add_argument('--settings', metavar='FILE', help='settings file of the CMM with an I++ DME server')
    parser.add_argument('--machine', metavar='FILE', help='describes the simulated machine '
                        '(default: the machine.yaml of the package)')
    parser.add_argument('--params', metavar='FILE', help='parameters of the nodes, such as cell.yaml')
    add_shared(parser, '--identity', help=IN_LOG)
    add_shared(parser, '--experience', help='what earlier runs of the cell have taught (YAML, rosette-experience/1): '
               'the prior of each diagnosis, and of calibrate --until')
    add_shared(parser, '--any-cell')
    add_shared(parser, '--output', default=None, help='folder of the logs, one folder per run (default: log_dir of the '
               'recorder in --params, or rosette-runs)')
    add_shared(parser, '--namespace', '--domain')


def run_cell(options: argparse.Namespace) -> None:
    """Start the cell, restart failed nodes until Ctrl-C, end it; raise CellError where one fails again and again."""
    if (options.cmm == DME) != bool(options.settings):
        raise UsageError('cell: expected --cmm dme and --settings FILE together, found one of them')
    is_real = options.no_simulation or options.cmm == DME
    for path in filter(None, (options.machine, options.params, options.settings)):
        if not Path(path).is_file():
            raise InvalidConfig(f'{path}: expected a YAML file, found none; check the path')
    if is_real and options.machine:
        raise InvalidConfig('cell: --machine describes a simulated CMM; remove --no-simulation or --cmm dme')
    if options.no_simulation and options.cmm == DME:
        raise UsageError('cell: --cmm dme starts a CMM; remove --no-simulation')
    if options.params and not is_real:
        refuse_other_plate(options.machine, options.params)
    cmm = settings_of(options.settings)[0] if options.settings else None
    out = console()
    nodes = [name for name in MODULES if not (options.no_simulation and name == names.CMM)]
    cell = Cell(options.domain, options.namespace, machine=options.machine, params_file=options.params, nodes=nodes,
                log_dir=made_folder(options.output or log_folder(options.params)), params={
                    names.SEQUENCER: identity_parameter(options.identity) | (sequencer_parameters(cmm) if cmm else {}),
                    names.RECORDER: {'simulated': True} if cmm and cmm.simulated else {},
                    names.EVALUATOR: experience_parameter(options.experience, options.identity, options.any_cell)},
                simulated_time=not is_real, dme=options.settings)
    refuse_second_cell(out, cell)
    with started(out, cell):
        keep_running(out, cell)


def given_parameters(path: str, node: str) -> Iterator[dict[str, Any]]:
    """Yield the parameters of a node in each section of a parameter file; raises InvalidConfig where it is no YAML."""
    for name, given in sections(read_yaml(path, 'a parameter file', MOST_PARAMETERS, InvalidConfig)):
        if name.rpartition('/')[2] in (node, '*', '**') and isinstance(given, dict):
            yield given


def log_folder(params: str | None) -> str:
    """Return the folder of the logs that a parameter file states, or the usual one."""
    stated = [one['log_dir'] for one in (given_parameters(params, names.RECORDER) if params else ()) if
              isinstance(one.get('log_dir'), str)]
    return os.path.expanduser(stated[-1]) if stated else str(SHARED['--output']['default'])


def refuse_other_plate(machine: str | None, params: str) -> None:
    """Raise InvalidConfig where the simulated machine has not the places of the plate file in parameters."""
    for parameters in given_parameters(params, names.SEQUENCER):
        given = parameters.get('plate')
        if isinstance(given, dict) and given.get('file'):
            plate, config = read_plate(given['file']), load_machine(machine) if machine else MachineConfig()
            n = given.get('balls', config.plate.balls)
            if n != config.plate.balls or abs(plate.circle - config.radius) > ROUNDING:
                raise InvalidConfig(
                    f'{machine or "the simulated machine"}: plate: expected balls: {n} and circle_radius_mm: '
                    f'{1e3 * plate.circle:.6g}, the places of {given["file"]} in {params}, found '
                    f'{config.plate.balls} and {config.plate.circle_radius_mm:g}')


def identity_parameter(path: str | None) -> dict[str, str]:
    """Return the parameter of the sequencer for an identity file; raises InvalidData where it is none."""
    if path is None:
        return {}
    read_identity(path)
    return {IDENTITY.name: str(Path(path).absolute())}


def experience_parameter(path: str | None, identity: str | None, any_cell: bool) -> dict[str, str]:
    """Return the parameter of the evaluator for a file of experience; raises InvalidData where it is none, or one of
    another table or CMM than the identity file states, unless any_cell."""
    if path is None:
        return {}
    known = read_experience(path)
    if identity and not any_cell:
        refuse_other_cell(known, read_identity(identity), f'{identity}: expected the cell')
    return {EXPERIENCE.name: str(Path(path).absolute())}


def keep_running(out: Console, cell: Cell) -> None:
    """Say how a cell is used; restart failed nodes and show what is new until Ctrl-C."""
    domain = int(os.environ.get('ROS_DOMAIN_ID') or 0) if cell.domain_id is None else cell.domain_id
    where = names.where(domain, cell.namespace)
    out.print(f'\n[bold]The cell is running[/]: {", ".join(cell.processes)} in domain {domain}, namespace '
              f'/{escape(cell.namespace)}; logs are written to {escape(str(cell.log_dir))}', soft_wrap=True)
    if names.CMM not in cell.processes:
        out.print('It waits for a CMM that answers probe_target with ball_centre (docs/real-cmm.md).')
    out.print(f'In another terminal:\n  {escape(command("calibrate", *where))}\nCtrl-C ends the cell.', soft_wrap=True)
    try:
        for words in cell.news():
            if not words.startswith(f'{names.SEQUENCER}: '):  # that it is complete is said above
                out.print(escape(words), soft_wrap=True)
        with contextlib.nullcontext() if has_no_enclave() else HangDetector(cell) as detector:
            while True:
                for words in cell.restart_failed(detector.hanging() if detector else ()).values():
                    print(f'{datetime.now():%H:%M:%S} {words}; restarted', file=sys.stderr, flush=True)
                for words in cell.news():
                    out.print(f'{datetime.now():%H:%M:%S} {escape(words)}', soft_wrap=True)
                time.sleep(CHECK_PERIOD)
    except KeyboardInterrupt:
        print('Ending the cell.', file=sys.stderr)


def has_no_enclave() -> bool:
    """Return whether SROS2 is in use: then this process sees nothing of the graph, as it has no enclave."""
    return os.environ.get('ROS_SECURITY_ENABLE', '').lower() == 'true'


def refuse_second_cell(out: Console, cell: Cell) -> None:
    """Raise CellError where a cell runs in the domain and namespace of one that shall be started.

    With SROS2 it cannot be seen: the sequencers refuse calibrations while there are two.
    """
    if has_no_enclave():
        return
    with out.status('searching for another cell'), CellClient(cell.domain_id, cell.namespace) as client:
        found = [name for name in client.running() if name in cell.nodes]  # a CMM of somebody else may be there already
    if found:
        where = 'this ROS domain' if cell.domain_id is None else f'domain {cell.domain_id}'
        raise CellError(f'cell: expected no cell in {where} and namespace /{cell.namespace}, found {", ".join(found)}; '
                        'end that one, or give this one its own --domain or --namespace')


@contextlib.contextmanager
def started(out: Console, cell: Cell) -> Iterator[Cell]:
    """Start a cell, end it afterwards."""
    with contextlib.ExitStack() as stack:
        with out.status('starting the nodes'):
            stack.enter_context(cell)
        yield cell


AS_CONFIGURED = ('balls', 'turning', 'repeats', 'drift_check', 'attempts', 'skips', 'touches')
"""Fields of the goal that are options of the same name: type, range and meaning are those of the setting."""


def calibrate_arguments(parser: argparse.ArgumentParser) -> None:
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
    parser.add_argument('--until', metavar='P', type=until, help='after the plan, add readings that part the '
                        'explanations until what the model lacks is settled with this probability, such as 0.95')
    parser.add_argument('--until-uncertainty-um', metavar='U', type=positive('um'), help='likewise until the largest '
                        'expanded uncertainty (k = 2) of the curves is no larger, µm, rotations at the balls')
    parser.add_argument('--at-most', metavar='N', type=whole(1, 1_000_000), help='add no more than N readings so '
                        '(default: as many as the plan has)')
    parser.add_argument('--options', metavar='YAML', default='',
                        help='further options of the goal, such as "limits.answer_timeout_s: 30"; '
                             f'known: {", ".join(one.name for one in OPTIONS)}')
    parser.add_argument('--resume', metavar='RUN', help='continue a run that was interrupted: its log, by name or path')
    parser.add_argument('--joint-with', metavar='RUN', nargs='+', help='evaluate the run as one with these finished '
                        'ones, by name; the cell keeps the last four, this one included')
    add_shared(parser, '--angle-unit', '--namespace', '--domain')


def run_calibrate(options: argparse.Namespace) -> None:
    """Run the calibration to its end; Ctrl-C cancels it. Raises CellError where it is not evaluated with others."""
    if options.resume is not None and not options.resume.strip():
        raise UsageError('--resume: expected the log of a run, by name or path, found nothing; without --resume a new '
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
            until_probability=options.until, most_readings=options.at_most,
            until_uncertainty=options.until_uncertainty_um and 1e-6 * options.until_uncertainty_um,
            joint_with=options.joint_with and [Path(run).absolute().name for run in options.joint_with],
            **{field: getattr(options, field) for field in (*AS_CONFIGURED, 'cmm_positions', 'balls_in_use')})
    out = console()
    out.print(f'[bold]{escape(outcome.run_id)}[/]')
    print_parts(out, [curves(outcome.error_motions, outcome.which) if outcome.error_motions else None])
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
    text = outcome.message.replace(f'{CONTINUE}rosette ', f'{CONTINUE}{command()} ')
    if outcome.cancelled:
        raise KeyboardInterrupt(text)
    if outcome.paused:
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


def check_cmm_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = ('The machine moves: ball 1 several times, at three table positions over a full turn forward and '
                     'backwards, then ball 2.\nPlate and table are those of the sequencer, if one is running.')
    parser.add_argument('--balls', metavar='N', type=whole(3, 1000), help='balls on the plate')
    parser.add_argument('--radius-mm', metavar='R', type=positive('mm'), help='radius of the circle of ball centres')
    parser.add_argument('--origin-mm', metavar=('X', 'Y', 'Z'), type=number('mm'), nargs=3,
                        help='where the centre of the plate roughly is, machine coordinates')
    parser.add_argument('--axis', metavar=('X', 'Y', 'Z'), type=number('a direction'), nargs=3,
                        help='direction of the table axis, machine coordinates')
    parser.add_argument('--azimuth-deg', metavar='A', type=number('deg', 360),
                        help='where ball 1 roughly is at table angle 0, counted about the axis (docs/real-cmm.md)')
    parser.add_argument('--repeats', metavar='K', type=whole(2, 1000), default=5,
                        help='readings of the repeatability (default 5)')
    parser.add_argument('--timeout', metavar='S', type=positive('s'), help='wait for an answer no longer')
    parser.add_argument('--recover', action='store_true', help='tell a CMM that waits for a person (after a collision, '
                        'an emergency stop, a lost connection) that one has looked at it; nothing else')
    add_shared(parser, '--json', '--namespace', '--domain')


def run_check_cmm(options: argparse.Namespace) -> None:
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
        time = '' if report.seconds_per_ball is None or report.run_seconds is None else (
            f' A ball takes {duration(report.seconds_per_ball)}, a calibration about {duration(report.run_seconds)}.')
        print_checks('cmm_check', 'What the CMM answers', report.checks, f'{_place(settings)}; what was not given is '
                     f'{"as the sequencer is configured" if client.has_sequencer else "by default"}.{time}')
    if report.failed:
        raise CellError(f'check-cmm: {len(report.failed)} of {len(report.checks)} checks are not passed: '
                        f'{", ".join(report.failed)} (docs/real-cmm.md)')


def _place(settings: Mapping[str, Any]) -> str:
    """Return plate and table in words."""
    origin = ' '.join(f'{1e3 * value:g}' for value in settings['table.origin_m'])
    return (f'{settings["plate.balls"]} balls, R = {1e3 * settings["plate.radius_m"]:g} mm, centre of the plate at '
            f'{signs(origin)} mm')


IMPLEMENTED = {
    'cell': (cell_arguments, run_cell), 'calibrate': (calibrate_arguments, run_calibrate),
    'check-cmm': (check_cmm_arguments, run_check_cmm)}

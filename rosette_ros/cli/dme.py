# SPDX-License-Identifier: Apache-2.0
"""A CMM with an I++ DME server: what it can do, the path around a ball, all moves above it; a server for tests."""

import argparse
import asyncio
import contextlib
import re
import signal
import sys
import time
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from typing import Any, TypeVar

import numpy as np
import yaml

from rosette_ros.cli.arguments import ENDS, UsageError, add_shared, picture_file, positive, whole
from rosette_ros.cli.console import console, print_checks, print_json, print_parts
from rosette_ros.core.run.errors import CellError, InvalidPlan, RosetteError
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.dme.ball_probing import DmeCmm
from rosette_ros.dme.dme_plan import refuse_unsafe_plan
from rosette_ros.dme.dme_server import HOST, TOOLS, ServeSettings, serving
from rosette_ros.dme.dme_session import Data, DmeSession, DmeStopped, ToolNotInUse, address_words
from rosette_ros.dme.dme_settings import DmeSettings, TimeoutSettings, client_settings, load_dme_settings
from rosette_ros.dme.probe_path import ball_path, length, lifted, obstacles, refuse_unsafe
from rosette_ros.dme.stop_mark import StopMark
from rosette_ros.dme.wire import PORT, Call, call, named, shown
from rosette_ros.invocation import command
from rosette_ros.io.reading_checks import Check
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.presentation.formatting import duration
from rosette_ros.presentation.plots import plot_style
from rosette_ros.presentation.plots.touch_plots import probe_path
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.simulation import MachineConfig, load_machine
from rosette_ros.words.effect_words import fixed

SPEEDS = tuple(f'Tool.{group}.{name}' for group in ('GoToPar', 'PtMeasPar') for name in ('Speed', 'Accel'))
NAMES = {'': '', '.Min': 'least ', '.Max': 'most '}
LENGTHS = tuple(f'Tool.PtMeasPar.{name}' for name in ('Approach', 'Search', 'Retract'))

Result = TypeVar('Result')


def check_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what it takes."""
    parser.epilog = 'Nothing moves. With a settings file the paths of all its balls are checked too.'
    parser.add_argument('server', metavar='HOST[:PORT]', nargs='?', help=f'where the server listens (port {PORT})')
    parser.add_argument('--settings', metavar='FILE', help='settings file of the CMM (rosette-dme/1), which names it')
    add_shared(parser, '--trace', '--json')


def check(options: argparse.Namespace) -> None:
    """Print what the server tells; raises CellError where the machine is not ready."""
    if bool(options.server) == bool(options.settings):
        raise UsageError('dme check: expected HOST[:PORT] or --settings FILE, one of the two')
    settings = load_dme_settings(options.settings) if options.settings else None
    host, port = (settings.server.host, settings.server.port) if settings else _address(options.server)
    server = address_words(host, port)
    trace = (lambda line: print(line, file=sys.stderr)) if options.trace else None
    found = _run(_looked(host, port, settings, trace))
    failed = [one.name for one in found if one.passed is False]
    if options.json:
        print_json({'schema': 'rosette-dme-check/1', 'server': server, 'passed': not failed,
                    'checks': [asdict(one) for one in found]})
    else:
        print_checks('dme_check', f'What {server} says', found)
    if failed:
        raise CellError(f'dme check: not passed: {", ".join(failed)} (docs/real-cmm.md)')


def _address(text: str) -> tuple[str, int]:
    found = re.fullmatch(r'(?:\[([^][]*:[^][]*)\]|([^][:]+))(?::([0-9]{1,5}))?', text)
    port = int(found[3] or PORT) if found else 0
    if found is None or not 0 < port < 65536:
        hint = '; an IPv6 address stands in brackets, as [::1]:1294' if text.count(':') > 1 else ''
        raise UsageError(f'dme check: expected HOST or HOST:PORT, found {text!r}{hint}')
    return found[1] or found[2], port


async def _look_at(session: DmeSession) -> list[Check]:
    """Return what a server tells about itself, nothing moves; raises CellError where it takes no more commands."""
    out = list[Check]()

    async def asked(name: str, *calls: Call, wanted: bool | None = None) -> Data:
        data: Data = []
        for one in calls:
            data += await session.optional(one) or []
        out.append(Check(name, wanted and bool(data), '; '.join(map(shown, data)) or 'not supported'))
        return data

    await asked('version', Call('GetDMEVersion'))
    await asked('machine', Call('GetMachineClass'))
    homed = await session.optional(Call('IsHomed'))
    is_homed = None if not homed else named(homed[0], 'IsHomed') == (1.0,)
    out.append(Check('homed', is_homed,
                     {None: 'not supported', True: 'yes', False: 'no: home it at the machine'}[is_homed]))
    await asked('tools', Call('EnumTools'))
    await asked('tool in use', call('GetProp', Call('Tool.Name')))
    await asked('tip', call('GetProp', Call('Tool.AvrRadius')))
    await asked('position / mm', call('Get', *map(Call, 'XYZ')), wanted=True)
    await asked('table / deg', call('Get', Call('R')), wanted=True)
    for name in (*SPEEDS, *LENGTHS):
        found = {end: await session.property_of(f'{name}{end}') for end in NAMES}
        known = [f'{NAMES[end]}{value:g}' for end, value in found.items() if value is not None]
        out.append(Check(name, None, ', '.join(known) or 'not supported'))
    await asked('temperatures / °C', Call('ReadAllTemperatures'))
    return out


async def _looked(host: str, port: int, settings: DmeSettings | None,
                  trace: Callable[[str], None] | None) -> list[Check]:
    session = await DmeSession.connect(host, port, settings.timeouts if settings else TimeoutSettings(), trace)
    try:
        return [*await _look_at(session), *(await _prepared(DmeCmm(session, settings), settings) if settings else ())]
    finally:
        await session.end()


async def _prepared(cmm: DmeCmm, settings: DmeSettings) -> list[Check]:
    """Return whether the machine takes the settings, and whether all paths are safe."""
    out = []
    try:
        await cmm.prepare(may_move=False)
        out.append(Check('settings', True, '; '.join(cmm.remarks) or 'taken as they are'))
    except ToolNotInUse as error:
        out.append(Check('settings', None, str(error)))
    except CellError as error:
        out.append(Check('settings', False, str(error)))
    try:
        count = len(refuse_unsafe_plan(settings))
        out.append(Check('paths', True, f'those at {count} places are safe'))
    except InvalidPlan as error:
        out.append(Check('paths', False, str(error)))
    return out


def path_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what it takes."""
    parser.add_argument('settings', metavar='FILE', help='settings file of the CMM (rosette-dme/1)')
    parser.add_argument('--ball', metavar='J', type=whole(1, 720), default=1, help='which ball (default 1)')
    parser.add_argument('--position', metavar='I', type=whole(1, 720), default=1, help='table position (default 1)')
    parser.add_argument('--figure', metavar='FILE', type=picture_file,
                        help='write a picture of it (.png, .svg or .pdf)')
    add_shared(parser, '--force')
    parser.add_argument('--steps', action='store_true', help='list every step (default: a summary)')
    parser.add_argument('--csv', action='store_true', help='print every step as CSV')


def path(options: argparse.Namespace) -> None:
    """Print the way around a ball, in short or step by step; raises UnsafePath where one of the plan is not safe."""
    settings = load_dme_settings(options.settings)
    table = settings.table
    angle = 2 * np.pi * (options.position - 1) / table.balls
    balls = table.frame.to_outer(table.balls_at(angle))
    for name, number, most in (('ball', options.ball, len(balls)), ('position', options.position, table.balls)):
        if number > most:
            raise UsageError(f'dme path: --{name}: expected 1 .. {most}, found {number}')
    centre = balls[options.ball - 1]
    steps = ball_path(settings, centre, table.frame.rotation[:, 2])
    steps = lifted(settings, steps) if settings.dry_run else steps
    tip = 1e-3 * settings.tool.tip_radius_mm
    points = 1e3 * np.concatenate([step.ways(tip, 0.0)[-1:] for step in steps])
    is_touch = np.array([step.normal is not None for step in steps])
    shown = Table('dme_path', f'The way around ball {options.ball} at table position {options.position}', (
        column('step', '', range(1, len(steps) + 1), str), words('why', 'step', [step.why for step in steps]),
        *(column(f'{axis}_mm', axis, points[:, place], lambda value: fixed(value, 3), 'mm')
          for place, axis in enumerate('xyz'))), levels=tuple('strong' if one else '' for one in is_touch),
        note='Tip centres in machine coordinates.')
    if options.csv:
        sys.stdout.write(shown.csv())
    else:
        within = ', '.join(f'{axis} {fixed(low, 1)} to {fixed(high, 1)}' for axis, low, high in zip(
            'xyz', points.min(axis=0).tolist(), points.max(axis=0).tolist()))
        console().print(
            f'Ball {options.ball} at table position {options.position}: {is_touch.sum()} touches, {len(steps)} steps'
            f'{"" if options.steps else " (--steps lists them)"}, {1e3 * length(steps, tip):.0f} mm; tip centres in '
            f'machine coordinates: {within} mm.', soft_wrap=True)
        print_parts(console(), [shown] if options.steps else [])
    if options.figure:
        turned = rotate_z(-np.arctan2(*table.frame.to_inner(centre)[[1, 0]]), table.frame.to_inner(balls))
        inner = rotate_z(-np.arctan2(*table.frame.to_inner(centre)[[1, 0]]), table.frame.to_inner(1e-3 * points))
        off = np.delete(turned - turned[options.ball - 1], options.ball - 1, axis=0)
        plot_style.save(probe_path(1e3 * (inner - turned[options.ball - 1]), is_touch, settings.ball.radius_mm,
                                   (settings.ball.shaft_radius_mm, settings.ball.shaft_length_mm), 1e3 * off),
                        options.figure, options.force)
    refuse_unsafe(settings, steps, obstacles(settings, balls, options.ball - 1))
    count = len(refuse_unsafe_plan(settings))
    if not options.csv:
        console().print(f'The ways at all {count} places are safe.')


def dry_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what it takes."""
    parser.epilog = ('The machine moves: slowly, path.clearance_mm higher than it would, without a touch. Stand at the '
                     'emergency stop.')
    parser.add_argument('settings', metavar='FILE', help='settings file of the CMM (rosette-dme/1)')
    parser.add_argument('--balls', metavar='N', type=whole(1, 720), help='the first N balls only')
    add_shared(parser, '--trace')


def dry_run(options: argparse.Namespace) -> None:
    """Go around all balls, above them; what a person has to look at is kept beside the settings file."""
    mark, settings = StopMark(options.settings), load_dme_settings(options.settings)
    settings = settings.model_copy(update={'dry_run': True})
    if why := mark.read():
        raise CellError(f'dme dry-run: {why}{_then(mark)}')
    places = len(refuse_unsafe_plan(settings))
    out = console()
    out.print(f'The ways at {places} places are safe. Ctrl-C aborts the move.')
    trace = (lambda line: print(line, file=sys.stderr)) if options.trace else None

    try:
        _run(_gone_around(settings, mark, options.balls, trace))
    except DmeStopped as error:
        if not mark.read():  # nothing has moved
            raise
        raise CellError(f'dme dry-run: {error}{_then(mark)}') from error


async def _gone_around(settings: DmeSettings, mark: StopMark, count: int | None,
                       trace: Callable[[str], None] | None) -> None:
    """Go around the first balls above them; the mark stays where a person has to look at the machine."""
    out, there = console(), settings.server
    try:
        session = await DmeSession.connect(there.host, there.port, settings.timeouts, trace)
    except DmeStopped as error:
        mark.keep_refusal(error)
        raise
    mark.write('the dry run ended in the middle of a move: the machine may have been moving; a person has to look at '
               'the machine')
    if mark.complaint:
        out.print(f'Warning: {mark.complaint}.')
    cmm = DmeCmm(session, settings)
    try:
        try:
            await cmm.prepare()
            for number, centre in enumerate(settings.table.frame.to_outer(settings.table.balls_at(0.0))[:count], 1):
                began = time.monotonic()
                await cmm.go_around(number, centre, 0.0)
                out.print(f'ball {number}: {duration(time.monotonic() - began)}')
        except asyncio.CancelledError:
            await session.halt()
            raise
    except (RosetteError, asyncio.CancelledError):
        mark.settle(session)
        raise
    else:
        mark.settle(session)
    finally:
        await session.end()


def _then(mark: StopMark) -> str:
    return f'; then: {command("check-cmm", "--recover")} beside the cell, or remove {mark.path}'


def _run(work: Coroutine[Any, Any, Result]) -> Result:
    """Run work and return what it does; SIGTERM and SIGHUP cancel it as Ctrl-C does.

    They cancel it alone, not what reads the connection: else the answer to AbortE would not be read.
    Exits with 128 + the number of the signal, as main does."""
    ended = list[int]()

    async def cancellable() -> Result:
        task, loop = asyncio.ensure_future(work), asyncio.get_running_loop()

        def end(number: int) -> None:
            if not ended:  # a second one would cancel the abortion
                ended.append(number)
                task.cancel()
        for number in found:
            with contextlib.suppress(NotImplementedError):  # a loop that knows Ctrl-C only
                loop.add_signal_handler(number, end, number)
        return await task

    found = {number: before for number in ENDS if (before := signal.getsignal(number)) not in (signal.SIG_IGN, None)}
    try:
        return asyncio.run(cancellable())
    except asyncio.CancelledError:
        sys.exit(128 + ended[0])
    finally:
        for number, before in found.items():
            signal.signal(number, before)


def serve_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('--port', type=whole(0, 65535), default=PORT, help=f'TCP port (default {PORT}; 0: a free one)')
    parser.add_argument('--machine', metavar='FILE', help='describes the simulated machine (default: as machine.yaml)')
    parser.add_argument('--dialect', choices=('1.4', '2.x'), default='1.4', help='version of I++ DME (default 1.4)')
    parser.add_argument('--speed', metavar='real|fast|N', type=_speed, default=1.0,
                        help='real time (default), as fast as the computer allows, or N times real time')
    parser.add_argument('--sign', type=int, choices=(1, -1), default=1,
                        help='sense of R: 1 counter-clockwise about the axis (default), -1 clockwise')
    parser.add_argument('--cumulative', action='store_true', help='R counts over turns instead of 0 to 360')
    parser.add_argument('--compensated', action='store_true',
                        help='report points of the surface instead of centres of the tip')
    parser.add_argument('--settings', metavar='FILE', dest='output', help='write the settings file of a client '
                        '(rosette dme check --settings FILE, rosette cell --cmm dme) that fits this server')
    add_shared(parser, '--force')
    parser.add_argument('--trace', action='store_true', help='print every line, < received, > sent')


def serve(options: argparse.Namespace) -> None:
    """Serve until Ctrl-C; raises CellError for a port that is in use."""
    config = load_machine(options.machine) if options.machine else MachineConfig()
    settings = ServeSettings(dialect=options.dialect, speed=options.speed, sign=options.sign,
                             cumulative=options.cumulative, compensated=options.compensated)
    if options.output:
        refuse_output(options.output, options.force)
    out = console()
    say = (lambda line: print(line, flush=True)) if options.trace else (lambda line: None)
    with serving(config, settings, options.port, say) as (port, server):
        if options.output:
            made = client_settings(config, port, settings.sign, settings.cumulative)
            write_text(options.output, yaml.safe_dump(made, sort_keys=False), options.force)
        place, plate = 1e3 * server.commands.cmm.machine.rough_frame.origin, config.plate
        out.print(f'I++ DME {settings.dialect} on {HOST}:{port}: the simulated machine; {plate.balls} balls of '
                  f'radius {plate.ball_radius_mm:g} mm on a\ncircle of radius {plate.circle_radius_mm:g} mm about '
                  f'({", ".join(f"{value:g}" for value in place)}) mm; tool "{TOOLS[0]}", tip radius '
                  f'{config.probing.tip_radius_mm:g} mm.')
        out.print('Ctrl-C ends it.')
        sys.stdout.flush()
        while True:  # a signal that comes just before a wait is seen after it
            time.sleep(0.5)


def _speed(text: str) -> float | None:
    """Read a speed: None is as fast as possible."""
    return {'real': 1.0, 'fast': None}[text] if text in ('real', 'fast') else positive('times real time')(text)


IMPLEMENTED = {'dme': {
    'check': ('connect to an I++ server and say what it can do; nothing moves', check_arguments, check),
    'path': ('the path around a ball, in short, as table and as picture; are all paths safe', path_arguments, path),
    'dry-run': ('all moves slowly above the balls, no touch', dry_run_arguments, dry_run),
    'serve': ('an I++ server with the simulated machine behind it, to try clients', serve_arguments, serve)}}

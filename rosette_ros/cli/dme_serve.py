# SPDX-License-Identifier: Apache-2.0
"""rosette dme serve: the simulated machine behind an I++ DME server, to try clients without a machine."""

import argparse
import sys
import time

import yaml

from rosette_ros.cli.arguments import add_shared, positive, whole
from rosette_ros.cli.console import console
from rosette_ros.dme.dme_server import HOST, TOOLS, ServeSettings, serving
from rosette_ros.dme.dme_settings import client_settings
from rosette_ros.dme.wire import PORT
from rosette_ros.io.text_file import refuse_output, write_text
from rosette_ros.simulation import MachineConfig, load_machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(options: argparse.Namespace) -> None:
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

# SPDX-License-Identifier: Apache-2.0
"""rosette studio: a page in the browser: verdict, curves, maps, what is missing, a running cell."""

import argparse
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

from rosette_ros.cli.arguments import ENDS, add_shared, whole
from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.io.log_reader import runs_in
from rosette_ros.io.open_run import is_log
from rosette_ros.studio.page import StudioOptions, is_loopback, serve

TOKEN_VARIABLE = 'ROSETTE_STUDIO_TOKEN'
SHORTEST_TOKEN = 12
RUNS = Path('rosette-runs')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the verb takes."""
    parser.add_argument('runs', metavar='RUN', nargs='*',
                        help='log directory, .mcap file or ball-centre table (CSV) to open')
    parser.add_argument('--port', type=whole(0, 65535), default=0, metavar='P',
                        help='port to listen on (default: any free one; the address is printed)')
    parser.add_argument('--host', default='127.0.0.1', metavar='H', help='address to listen on (default '
                        '127.0.0.1: this computer alone); any other one needs a token')
    parser.add_argument('--token', metavar='T', help='token that the page asks for at sign-in, at '
                        f'least {SHORTEST_TOKEN} characters (default: {TOKEN_VARIABLE} of the environment)')
    parser.add_argument('--archive', metavar='ARCHIVE', default='', help='show the runs of this archive first')
    add_shared(parser, '--angle-unit', '--namespace', '--domain')
    parser.add_argument('--no-browser', action='store_true', help='print the address and open no browser')


def run(options: argparse.Namespace) -> None:
    """Serve the page until Ctrl-C."""
    for path in options.runs:
        is_log(path)  # raises at once where the path does not exist
    for end in ENDS:
        if end != signal.SIGTERM and signal.getsignal(end) is not signal.SIG_IGN:  # uvicorn knows the other one only
            signal.signal(end, lambda *_: signal.raise_signal(signal.SIGTERM))
    serve(studio_options(options, os.environ), lambda address: print(f'rosette studio: {address}', flush=True))


def studio_options(options: argparse.Namespace, environment: Mapping[str, str]) -> StudioOptions:
    """Return the options; raises InvalidConfig for an address that others can reach without a token."""
    token = options.token if options.token is not None else environment.get(TOKEN_VARIABLE) or None
    if token is not None and (len(token) < SHORTEST_TOKEN or not token.isascii() or not token.isprintable()):
        raise InvalidConfig(f'--token: expected at least {SHORTEST_TOKEN} printable ASCII characters, found '
                            f'{len(token)} characters')
    if token is None and not is_loopback(options.host):
        raise InvalidConfig(f'--host {options.host}: others can reach this address; expected a token with it '
                            f'(--token T or {TOKEN_VARIABLE}), found none')
    return StudioOptions(tuple(options.runs), suggestions(options.runs), options.host, options.port, token,
                         options.domain, not options.no_browser, options.namespace, options.archive)


def suggestions(given: Sequence[str]) -> tuple[str, ...]:
    """Return the paths that the page offers: those given, then what lies in ./rosette-runs, newest first."""
    return tuple(dict.fromkeys(map(str, [*given, *(runs_in(RUNS) if RUNS.is_dir() else ())])))


IMPLEMENTED = {'studio': (add_arguments, run)}

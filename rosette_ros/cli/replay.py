# SPDX-License-Identifier: Apache-2.0
"""rosette replay: a log goes back onto the graph, and what an evaluator says of it comes back."""

import sys
from dataclasses import dataclass

import numpy as np
from rich.markup import escape
from rich.progress import Progress

from rosette_ros.analysis import analyse
from rosette_ros.cli.arguments import positive
from rosette_ros.cli.domain import add_domain
from rosette_ros.cli.player import Player
from rosette_ros.cli.screen import console
from rosette_ros.cli.summary import curve_table
from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.core.records import ErrorMotions
from rosette_ros.data.log_files import iter_log
from rosette_ros.data.log_reader import read_log
from rosette_ros.nodes import names
from rosette_ros.nodes.cell import Cell
from rosette_ros.nodes.convert import error_motions_record

SEARCH_TIMEOUT, START_TIMEOUT, RESULT_TIMEOUT = 5.0, 20.0, 60.0


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('log', metavar='RUN', help='log directory or .mcap file')
    parser.add_argument('--rate', metavar='X', type=positive('times the recorded pace'),
                        help='how many times as fast as recorded (default: as fast as it goes)')
    add_domain(parser)


def run(options):
    """Replay and compare."""
    log = read_log(options.log)
    expected = expected_motions(log)
    out = console()
    with Player(log.topics, options.domain) as player:
        if player.await_evaluator(SEARCH_TIMEOUT):
            found = replay(player, options, log, expected)
        else:
            player.refuse_live_cell()
            out.print('No evaluator on the graph: one is started for this replay.')
            with Cell(options.domain, player.namespace, nodes=(names.EVALUATOR,),
                      remappings=player.remappings) as cell:
                if not player.await_evaluator(START_TIMEOUT):
                    raise CellError('replay: the evaluator has started but does not hear us; '
                                    'another middleware, or a firewall on the loopback?')
                found = replay(player, options, log, expected)
                cell.check()
    differ = [show(out, run_id, error_motions_record(found[run_id]), wanted)
              for run_id, wanted in expected.items()]
    if any(differ):
        raise InvalidData(f'{options.log}: the error motions that came back are not those that '
                          'were expected; another version of the software, or another model?')


@dataclass(frozen=True, eq=False)
class Expected:
    """What should come back for one run: curves, where they come from, and whether u counts.

    The repeatability of an imported table is in its log, but not on the graph.
    """

    motions: ErrorMotions
    source: str
    with_u: bool


def expected_motions(log):
    """Return by run_id what is Expected of every run with a result.

    As published in the log; where nothing was published (an imported table), as evaluated now.
    Raises InvalidData where there is no run to evaluate.
    """
    expected = {run_id: Expected(published.motions, 'in the log', True) for run_id in log.run_ids
                if (published := log.latest_error_motions(run_id)) is not None}
    if not expected and not log.states:
        run = log.to_run()
        if not run.is_complete:
            raise InvalidData(f'{log.path}: wanted all {run.n**2} ball centres, for which an '
                              f'evaluator waits, got {run.size}; try rosette evaluate')
        report = analyse(run)
        expected = {report.run.run_id: Expected(report.error_motions, 'of rosette evaluate',
                                                report.run.repeatability is None)}
    if not expected:
        ended = '; '.join(f'run {state.run_id}: {state.text}' for state in log.states)
        raise InvalidData(f'{log.path}: wanted a run that was evaluated, got none ({ended}); try '
                          'rosette evaluate on what was measured')
    return expected


def replay(player, options, log, expected):
    """Publish the log and return the ErrorMotions messages that came back, by run_id."""
    player.refuse_live_cell()
    screen = console(sys.stderr)
    with Progress(*Progress.get_default_columns(), console=screen, transient=True,
                  disable=not screen.is_terminal) as bar:
        messages = bar.track(iter_log(options.log), total=log.messages, description='replay')
        player.play(messages, options.rate)
    found = player.await_motions(expected, RESULT_TIMEOUT)
    missing = [run_id for run_id in expected if run_id not in found]
    if missing:
        raise CellError(f'replay: wanted the error motions of run {missing[0]} within '
                        f'{RESULT_TIMEOUT:g} s, got none; see the output of the evaluator')
    return found


def show(out, run_id, got, expected):
    """Print the curves that came back; return whether they differ from what was expected."""
    out.print(f'[bold]{escape(run_id)}[/]')
    out.print(curve_table(got))
    what = difference(got, expected)
    if what:
        out.print(f'\n[red]{what} those {expected.source}[/]')
    else:
        parts = 'curves and uncertainties' if expected.with_u else 'curves'
        out.print(f'\n[green]{parts} equal to those {expected.source}, bit for bit[/]')
    return bool(what)


def difference(got, expected):
    """Return in words how the ErrorMotions that came back differ, empty: not by a bit."""
    wanted = expected.motions
    if got.values.shape != wanted.values.shape or not np.array_equal(got.angle, wanted.angle):
        return 'other table angles than'
    if not np.array_equal(got.values, wanted.values):
        size = 1e6 * np.abs(got.values - wanted.values)
        return f'up to {size[:, :3].max():.2g} µm and {size[:, 3:].max():.2g} µrad off'
    if expected.with_u and not np.array_equal(got.u, wanted.u):
        return 'other uncertainties than'
    return ''

# SPDX-License-Identifier: Apache-2.0
"""rosette compare: where a model and a measurement differ, and by how much of the noise."""

from argparse import ArgumentParser, Namespace

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from rosette_ros.analysis import compare, diagnose, judge, ladder
from rosette_ros.cli.arguments import add_shared, picture_file
from rosette_ros.cli.console import console, head, print_json, print_parts, print_verdict, say
from rosette_ros.core.diagnosis.comparison import Comparison
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_run
from rosette_ros.io.text_file import refuse_output
from rosette_ros.presentation import tables
from rosette_ros.presentation.formatting import micrometres, uncertainty_words
from rosette_ros.presentation.json_output import comparison_json
from rosette_ros.presentation.plots import noise_plots
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.words.result_words import comparison_words
from rosette_ros.words.verdict_words import verdict_text

WIDEST_MAP = 40
"""Most balls for which the map of the readings fits on a screen."""
LOW, HIGH = 2.0, 3.0
"""Residual of a reading in σ from which it is shown as a digit, and in red."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--model')
    parser.add_argument('--ladder', action='store_true',
                        help='the error of nested models: from the base model on, effect by effect')
    parser.add_argument('--noise-picture', metavar='FILE', type=picture_file,
                        help='write the picture of the noise that the report has: quantiles, scatter by axis, ball, '
                        'CMM position and time, correlation of neighbours (.png, .svg or .pdf)')
    add_shared(parser, '--force', '--json')


def run(options: Namespace) -> None:
    """Print the comparison."""
    if options.noise_picture:
        refuse_output(options.noise_picture, options.force)
    measured, model = open_run(options.run_path), read_model(options.model)
    comparison, verdict = compare(measured, model), judge(measured, model)
    steps = ladder(measured, model) if options.ladder else ()
    if options.noise_picture:
        save(noise_plots.noise(diagnose(measured, model).final), options.noise_picture, options.force)
    if options.json:
        print_json(comparison_json(comparison, verdict, steps))
        return
    out = console()
    out.print(head(measured))
    show(out, comparison, verdict)
    print_parts(out, [tables.nested_models(steps)])
    if options.noise_picture:
        out.print(f'\nPicture of the noise: {escape(str(options.noise_picture))}')


def show(out: Console, comparison: Comparison, verdict: Verdict) -> None:
    """Print a comparison and the verdict."""
    sigma, source = tables.noise_of(comparison.fit)
    print_verdict(out, verdict_text(verdict))
    say(out, f'{comparison_words(comparison)} Residuals are given in σ = {micrometres(sigma)}, {source}; '
        f'uncertainties of the curves are {uncertainty_words(comparison.fit)}.')
    print_parts(out, [tables.axes(comparison), tables.places(comparison), reading_map(comparison, sigma),
                      tables.worst_readings(comparison), tables.waves(comparison)])


def reading_map(comparison: Comparison, sigma: float) -> Text | None:
    """Return the map of all readings, rows table positions, columns balls; None where it is too wide."""
    run = comparison.fit.run
    if run.n > WIDEST_MAP:
        return None
    grid = np.full((run.n, run.n), np.nan)
    np.fmax.at(grid, (run.table_position - 1, run.ball - 1), comparison.sizes / sigma)
    text = Text('Residual of every reading in σ', style='bold')
    text.append(f' (· below {LOW:g}, digits up to 9; blank: not measured)\n', style='default')
    text.append(f'table\\ball {" ".join(str(ball % 10) for ball in range(1, run.n + 1))}', style='dim')
    for position, line in enumerate(grid, 1):
        text.append(f'\n{position:>10} ', style='dim')
        for size in line:
            text.append(*_mark(size))
    return text


def _mark(size: float) -> tuple[str, str]:
    if np.isnan(size):
        return '  ', 'default'
    return ('· ', 'dim') if size < LOW else (f'{min(int(size), 9)} ', 'red' if size >= HIGH else 'yellow')

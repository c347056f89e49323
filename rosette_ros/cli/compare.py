# SPDX-License-Identifier: Apache-2.0
"""rosette compare: a model against a measurement, where it fails and by how much of sigma."""

import numpy as np
from rich.markup import escape
from rich.text import Text

from rosette_ros.analysis import compare, ladder
from rosette_ros.cli.arguments import add_formats, add_run
from rosette_ros.cli.human import sentence, spark
from rosette_ros.cli.screen import console, print_json, table
from rosette_ros.cli.summary import head
from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.model import Model
from rosette_ros.data.model_file import read_model
from rosette_ros.data.open_run import open_run
from rosette_ros.diagnosis_json import comparison_json
from rosette_ros.words import chance, fixed, micro, percent, times

WIDEST_MAP = 40
"""Most balls for which the map of the readings fits on a screen."""
WORST, LINES = 5, 4
UNLIKELY = 0.01
QUIET, LOUD = 2.0, 3.0
"""Size of a reading in sigma from which it is shown with its digit, and in red."""


def add_arguments(parser):
    """Declare what the verb takes."""
    add_run(parser)
    add_model(parser)
    parser.add_argument('--ladder', action='store_true',
                        help='the error of every model from the base model on, effect by effect')
    add_formats(parser)


def add_model(parser):
    """Add the argument --model."""
    parser.add_argument('--model', metavar='FILE', help='model file (YAML); without it the base '
                        'model: table motions, plate deviations, CMM deviations')


def model_of(options):
    """Return the Model that the options name."""
    return read_model(options.model) if options.model else Model()


def run(options):
    """Print the comparison."""
    measured, model = open_run(options.run_path), model_of(options)
    comparison = compare(measured, model)
    rungs = ladder(measured, model) if options.ladder else ()
    if options.json:
        print_json(comparison_json(comparison, rungs))
        return
    out = console()
    out.print(head(measured))
    show(out, comparison)
    if rungs:
        out.print()
        out.print(ladder_table(rungs))


def show(out, comparison):
    """Print a Comparison for a person."""
    colour = 'red' if comparison.failing else 'green'
    sigma, source = noise_of(comparison.fit)
    out.print(f'[{colour}]{sentence(comparison.summary)}[/]')
    out.print(f'σ = {micro(sigma)} µm is {source}.\n')
    for part in (axis_table(comparison, sigma), place_table(comparison, sigma),
                 reading_map(comparison, sigma), worst_table(comparison),
                 harmonic_table(comparison)):
        if part is not None:
            out.print(part)
            out.print()
    out.print('Something is missing: [bold]rosette diagnose[/] says which effect it is.'
              if comparison.failing else 'Nothing is missing that this comparison can show.')


def noise_of(fit):
    """Return what residuals are measured by, m, and its name: the repeatability where known."""
    if fit.run.repeatability is not None:
        return fit.run.repeatability, 'the repeatability'
    return fit.rms, 'the rms of all residuals, as no repeatability is known'


def axis_table(comparison, sigma):
    """Return the table of residuals by axis."""
    made = table('', 'x', 'y', 'z', title='Residual by axis')
    made.add_row('rms / µm', *(micro(float(value)) for value in comparison.axis_rms))
    made.add_row('in σ', *(fixed(float(value) / sigma, 2) for value in comparison.axis_rms))
    return made


def place_table(comparison, sigma):
    """Return the table of groupings: a bar for every group, the worst one, the chance of noise."""
    sizes = [np.sqrt(np.mean(grouping.rms**2, axis=1)) / sigma for grouping in
             comparison.groupings]
    top = max(float(size.max()) for size in sizes)
    made = table(title=f'Where the residual is; a full bar is {times(top)}')
    for name, side in (('by', 'left'), ('first to last group', 'left'), ('worst', 'right'),
                       ('its rms', 'right'), ('chance of noise', 'right')):
        made.add_column(name, justify=side, no_wrap=True)
    for grouping, size in zip(comparison.groupings, sizes, strict=True):
        style = 'red' if grouping.p < UNLIKELY else None
        made.add_row(grouping.label, _bars(size, top), grouping.keys[grouping.worst],
                     times(float(size.max())), chance(grouping.p), style=style)
    made.add_row('neighbours in sequence', f'correlation {comparison.neighbour_correlation:+.2f}',
                 '', '', chance(comparison.neighbour_p),
                 style='red' if comparison.neighbour_p < UNLIKELY else None)
    return made


def _bars(size, top):
    """Return the bars of many groups, several groups in one bar where they are too many."""
    if size.size > WIDEST_MAP:
        size = np.array([part.max() for part in np.array_split(size, WIDEST_MAP)])
    return spark(size, top)


def reading_map(comparison, sigma):
    """Return the map of all readings, rows table positions, columns balls; None where too wide."""
    run = comparison.fit.run
    if run.n > WIDEST_MAP:
        return None
    grid = np.full((run.n, run.n), np.nan)
    np.fmax.at(grid, (run.table_position - 1, run.ball - 1), comparison.sizes / sigma)
    text = Text('Every reading: its residual in σ', style='bold')
    text.append(f' (· below {QUIET:g}, digits up to 9; blank: not measured)\n', style='default')
    text.append('table\\ball ', style='dim')
    text.append(' '.join(str(ball % 10) for ball in range(1, run.n + 1)) + '\n', style='dim')
    for position, line in enumerate(grid, 1):
        text.append(f'{position:>10} ', style='dim')
        for size in line:
            text.append(*_mark(size))
        text.append('\n')
    text.rstrip()
    return text


def _mark(size):
    """Return (text, style) of one reading."""
    if np.isnan(size):
        return '  ', 'default'
    if size < QUIET:
        return '· ', 'dim'
    return f'{min(int(size), 9)} ', 'red' if size >= LOUD else 'yellow'


def worst_table(comparison):
    """Return the table of the readings that fit worst."""
    made = table('reading', 'table pos.', 'ball', 'CMM pos.', 'x', 'y', 'z', 'in rms',
                 'chance of noise', title='Readings that fit worst, residual in µm')
    for one in comparison.worst[:WORST]:
        made.add_row(str(one.number), str(one.table_position), str(one.ball),
                     str(one.cmm_position), *(micro(value) for value in one.residual),
                     fixed(one.size, 1), chance(one.p),
                     style='red' if one.p < UNLIKELY else None)
    return made


def harmonic_table(comparison):
    """Return the table of the strongest waves; None on an incomplete run: it has no spectrum."""
    if not comparison.harmonics:
        return None
    made = table('axis', 'waves per turn of table', 'of CMM position', 'amplitude / µm',
                 'share of the residual', title='Strongest waves in the residual')
    for line in comparison.harmonics[:LINES]:
        made.add_row(line.axis, str(line.table_waves), str(line.cmm_waves),
                     micro(line.amplitude), percent(line.share))
    return made


def ladder_table(rungs):
    """Return the ladder: model after model, error after error."""
    made = table(title='The ladder: the error after every effect that was added')
    for name, side in (('model', 'left'), ('residual\nµm', 'right'), ('reduced\nχ²', 'right'),
                       ('readings left\nout, µm', 'right'), ('change', 'right')):
        made.add_column(name, justify=side, no_wrap=name != 'model')
    before = None
    for rung in rungs:
        fit = rung.report.fit
        chi = fit.reduced_chi_square
        step = '' if before is None else f'{100 * (rung.held_out / before - 1):+.0f} %'
        model = f'+ {rung.added}' if rung.added else base_words(fit.model)
        made.add_row(escape(model), micro(fit.rms), '–' if chi is None else f'{chi:.3g}',
                     micro(rung.held_out), step)
        before = rung.held_out
    return made


def base_words(model):
    """Return what the base of a model is."""
    return 'base model' if model.base == BASE_TERMS else ' + '.join(model.base) or 'nothing'

# SPDX-License-Identifier: Apache-2.0
"""rosette budget: what contributes how much to the uncertainty of the six curves, confirmed by Monte Carlo."""

import importlib
import sys
from argparse import ArgumentParser, Namespace

from rich.console import Console
from rich.markup import escape
from rich.progress import MofNCompleteColumn, Progress

from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, judge
from rosette_ros.cli.arguments import UsageError, add_shared, picture_file, whole
from rosette_ros.cli.console import console, head, print_json, print_parts, print_verdict, warn
from rosette_ros.core.budget_inputs import BudgetInputs
from rosette_ros.core.budget_monte_carlo import MonteCarlo, monte_carlo
from rosette_ros.core.error_summary import doubt_of
from rosette_ros.core.planning.visibility import visibility
from rosette_ros.core.uncertainty_budget import Budget, budget, touch_scatter
from rosette_ros.io.budget_file import read_budget
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_run
from rosette_ros.io.text_file import refuse_output
from rosette_ros.io.touch_log import refit_if_touched
from rosette_ros.presentation.budget_results import agreement_words, budget_json, budget_tables, together_words
from rosette_ros.words.verdict_words import verdict_text

FEWEST_TRIALS, MOST_TRIALS = 100, 1_000_000


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--run-id', '--model', '--inputs')
    parser.add_argument('--hidden-effects', action='store_true', help='add bounds of effects that are not in the model '
                        'and that this order of measurement hides')
    parser.add_argument('--monte-carlo', metavar='N', type=whole(FEWEST_TRIALS, MOST_TRIALS),
                        help='repeat the run N times with drawn contributions and compare (GUM S1, S2); '
                        'fewer than 1000 decide nothing, 10000 are usual')
    parser.add_argument('--seed', type=whole(0, 2**63 - 1), help='of the Monte Carlo (default 0)')
    parser.add_argument('-o', '--output', metavar='FILE', type=picture_file,
                        help='draw the bars (.png, .svg or .pdf)')
    add_shared(parser, '--force', '--json')


def run(options: Namespace) -> None:
    """Print the budget."""
    if options.seed is not None and not options.monte_carlo:
        raise UsageError('budget: --seed goes with --monte-carlo only; leave it out')
    if options.output:
        refuse_output(options.output, options.force)
    inputs = read_budget(options.inputs) if options.inputs else BudgetInputs()
    measured = open_run(options.run_path, options.run_id)
    refit = refit_if_touched(options.run_path, options.run_id)
    fit = analyse(measured, read_model(options.model))
    hidden = visibility(measured, fit.sigma, fit.model.base) if options.hidden_effects else None
    verdict = judge(fit.run, fit.model) if measured.n <= MOST_BALLS_JUDGED else None
    made = budget(fit, inputs, touch_scatter(refit), hidden, doubt_of(verdict))
    found = _repeated(made, options.monte_carlo, options.seed or 0) if options.monte_carlo else None
    if options.output:
        plots, style = (importlib.import_module(f'rosette_ros.presentation.plots.{name}')
                        for name in ('budget_plots', 'plot_style'))
        style.save(plots.budget_bars(made, found), options.output, options.force)
    if options.json:
        print_json(budget_json(made, found))
        return
    out = console()
    out.print(head(measured))
    if verdict:
        print_verdict(out, verdict_text(verdict))
    else:
        warn(measured)
    show(out, made, found)
    if hidden is None:
        out.print('Bounds of effects that this order hides: --hidden-effects')
    if options.output:
        out.print(f'\nPicture: {escape(str(options.output))}', soft_wrap=True)


def show(out: Console, made: Budget, found: MonteCarlo | None = None) -> None:
    """Print a budget, what Monte Carlo says, and what is not considered."""
    print_parts(out, budget_tables(made, found))
    if found:
        colour = {True: 'green', False: 'red', None: 'yellow'}[found.agrees]
        out.print(f'[{colour}]{escape(agreement_words(found))}[/]')
        out.print(escape(together_words(found)))
    out.print('\n[bold]Not considered[/]')
    for sentence in made.open:
        out.print(escape(f'- {sentence}'))


def _repeated(made: Budget, trials: int, seed: int) -> MonteCarlo:
    """Return the Monte Carlo of a budget, with a progress bar on a terminal."""
    screen = console(sys.stderr)
    with Progress(*Progress.get_default_columns(), MofNCompleteColumn(), console=screen, transient=True,
                  disable=not screen.is_terminal) as bar:
        task = bar.add_task('Monte Carlo', total=trials)
        return monte_carlo(made, trials, seed, lambda done: bar.advance(task, done))

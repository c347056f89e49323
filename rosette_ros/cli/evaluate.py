# SPDX-License-Identifier: Apache-2.0
"""rosette evaluate: the six error motions of a run, plate and CMM deviations, uncertainties, the verdict."""

import sys
from argparse import ArgumentParser, Namespace

from rich.markup import escape

from rosette_ros import command
from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, judge
from rosette_ros.cli.arguments import add_formats, add_shared
from rosette_ros.cli.console import console, fit_rows, head, pairs, print_json, print_parts, print_verdict, warn
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.json_output import evaluation_json
from rosette_ros.presentation.tables import curves, deviations, fitted_effects


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--run-id', '--model')
    add_formats(parser, csv='print the six curves as a table with standard uncertainties')


def run(options: Namespace) -> None:
    """Print the evaluation."""
    fit = analyse(open_run(options.run_path, options.run_id), read_model(options.model))
    verdict = judge(fit.run, fit.model) if fit.run.n <= MOST_BALLS_JUDGED and not options.csv else None
    if verdict is None:
        warn(fit.run)
    if options.csv:
        sys.stdout.write(curves(fit.error_motions).csv())
        return
    if options.json:
        print_json(evaluation_json(fit, verdict))
    else:
        show(fit, verdict)


def show(fit: Fit, verdict: Verdict | None) -> None:
    """Print the evaluation; verdict: None where the plate has too many balls to judge it unasked."""
    out = console()
    out.print(head(fit.run))
    if verdict:
        print_verdict(out, verdict)
        if verdict.model_fails:
            out.print(f'What is missing, and how sure that is:\n  {escape(command("diagnose", fit.run.source))}',
                      soft_wrap=True)
    else:
        out.print(f'Plates of more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN')
    print_parts(out, [
        curves(fit.error_motions), deviations(fit), fitted_effects(fit.effects, 'Effects in the model'),
        pairs(fit_rows(fit))])

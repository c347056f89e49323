# SPDX-License-Identifier: Apache-2.0
"""rosette evaluate: the six error motions of a run, or of several as one, deviations, uncertainties, the verdict."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from rich.markup import escape

from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, evaluate_jointly, find
from rosette_ros.cli.arguments import add_formats, add_shared
from rosette_ros.cli.console import console, fit_rows, head, pairs, print_json, print_parts, print_verdict, warn
from rosette_ros.cli.joint_arguments import add_joint, is_joint
from rosette_ros.cli.verdict_card import print_card
from rosette_ros.core.diagnosis.diagnosis import Finding
from rosette_ros.core.error_summary import AxisError, doubt_of, fit_lines
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import joint_identity, open_identified, open_readings
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.presentation import joint_results as results
from rosette_ros.presentation.error_results import errors
from rosette_ros.presentation.formatting import FOUND, NOW
from rosette_ros.presentation.json_output import evaluation_json
from rosette_ros.presentation.tables import curves, deviations, fitted_effects
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table, spheres_json
from rosette_ros.words.result_words import conclusion_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='+')
    add_shared(parser, '--run-id', '--model')
    add_joint(parser)
    add_shared(parser, '--identity', '--refit-spheres')
    add_formats(parser, csv='print the six curves as a table with standard uncertainties')


def run(options: Namespace) -> None:
    """Print the evaluation."""
    if is_joint(options):
        run_jointly(options)
        return
    measured, identity, _ = open_identified(options.run_path[0], options.run_id, options.identity)
    measured, refit = (open_refitted(options.run_path[0], options.run_id) if options.refit_spheres else
                       (measured, None))
    tolerances = identity.limits(measured.rotation)
    fit = analyse(measured, read_model(options.model))
    found = find(fit.run, fit.model) if fit.run.n <= MOST_BALLS_JUDGED and not options.csv else None
    verdict = found.verdict if found else None
    if verdict is None:
        warn(fit.run)
    if options.csv:
        sys.stdout.write(curves(fit.error_motions).csv())
        return
    lines = fit_lines(fit, tolerances, doubt_of(verdict))
    if options.json:
        spheres = {'spheres': spheres_json(refit)} if refit else {}
        print_json({**evaluation_json(fit, verdict, lines, found.with_cause if found else None),
                    **spheres})
    else:
        show(options, fit, found, lines)
        if refit:
            print_parts(console(), [sphere_table(refit), pairs(sphere_rows(refit))])


def show(options: Namespace, fit: Fit, found: Finding | None, lines: Sequence[AxisError]) -> None:
    """Print the evaluation; found: None where the plate has too many balls to judge it unasked; lines: of errors."""
    out = console()
    out.print(head(fit.run))
    if found:
        print_card(out, found.verdict, options.run_path[0], options.model)
    else:
        out.print(f'Plates of more than {MOST_BALLS_JUDGED} balls are judged on request: rosette diagnose RUN')
    final = found.with_cause if found else None
    print_parts(out, [
        errors(lines, found=fit_lines(final) if final else ()), curves(fit.error_motions, NOW if final else ''),
        *([curves(final.error_motions, FOUND)] if final else []), deviations(fit),
        fitted_effects(fit.effects, 'Effects in the model'), pairs(fit_rows(fit))])


def run_jointly(options: Namespace) -> None:
    """Print the joint evaluation of all runs."""
    declared = read_sharing(options.share, len(options.run_path))
    result = evaluate_jointly([open_readings(path, options.run_id) for path in options.run_path], declared)
    identity = joint_identity(options.run_path, options.run_id, options.identity)[0]
    tolerances = identity.limits(result.solution.model.runs[0].rotation)
    if options.json:
        print_json(results.joint_json(result, tolerances))
    elif options.csv:
        sys.stdout.write(results.joint_csv(result))
    else:
        out = console()
        for one in result.solution.model.runs:
            out.print(escape('\n'.join((results.joint_head(one), *one.notes))))
        for note in result.notes:
            out.print(escape(note), soft_wrap=True)
        print_verdict(out, conclusion_text(conclude(result)))
        print_parts(out, [*results.joint_errors(result, tolerances), results.sharing_table(result),
                          *results.joint_curves(result),
                          pairs((name, escape(words)) for name, words in results.joint_rows(result))])

# SPDX-License-Identifier: Apache-2.0
"""rosette explain: what explains a run, every hypothesis with its probability."""

from argparse import ArgumentParser, Namespace

from rich.markup import escape

from rosette_ros.analysis import explain
from rosette_ros.cli.arguments import add_shared
from rosette_ros.cli.console import console, head, print_json, print_parts
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation import explanation_results


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', '--model', '--json')


def run(options: Namespace) -> None:
    """Print what explains the run."""
    found = explain(open_run(options.run_path), read_model(options.model))
    if options.json:
        print_json(explanation_results.explanation_json(found))
        return
    out = console()
    out.print(head(found.fit.run))
    for sentence in explanation_results.sentences(found):
        out.print(escape(sentence))
    print_parts(out, [explanation_results.explanations(found)])

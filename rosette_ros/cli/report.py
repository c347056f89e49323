# SPDX-License-Identifier: Apache-2.0
"""rosette report: the page of a run, of several runs as one, or of runs that must agree as in the paper."""

import re
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import STEPS, analyse, curves_over, summarise
from rosette_ros.cli.arguments import add_shared, keep_inputs, made_folder
from rosette_ros.cli.console import console, doing, head, print_verdict
from rosette_ros.cli.opened import add_joint, is_joint, joint_result
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.budget_file import budget_inputs, read_stated
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import joint_identity
from rosette_ros.io.text_file import bare_name, refuse_output, write_text
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.presentation.plots.plot_style import save_all
from rosette_ros.presentation.plots.result_plots import Series
from rosette_ros.presentation.report import verification
from rosette_ros.presentation.report.joint_page import joint_html, joint_pictures, joint_tables, open_with_files
from rosette_ros.presentation.report.provenance import digest, open_source
from rosette_ros.presentation.report.run_page import (
    every_table,
    pictures_of,
    report_html,
    result_of,
    touches_of,
)
from rosette_ros.presentation.report.verification import Verification, read_maker, verify
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.result_words import ConclusionText, conclusion_text
from rosette_ros.words.verdict_words import verdict_text

LONGEST_NAME = 50
"""Characters in the name of a table's file: 255 bytes are the limit of file systems."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='*')
    add_shared(parser, '--run-id', '--model', '--identity')
    parser.add_argument('-o', '--output', metavar='FILE',
                        help='the page (HTML) to write; by default named after RUN, in this folder')
    parser.add_argument('--overlay', metavar='RUN', nargs='+', default=[],
                        help='other runs whose curves are drawn over those of RUN, under the same model')
    parser.add_argument('--compare', metavar='RUN', nargs='+', default=[],
                        help="the paper's verification: four runs (i) all corrected, (ii) plate turned by 90°, "
                        '(iii) CMM correction off, (iv) that and the table axial correction off; two more: table '
                        'angular correction off, and on again')
    add_joint(parser)
    add_shared(parser, '--refit-spheres', '--inputs', '--environment', '--angle-unit')
    parser.add_argument('--maker', metavar='FILE', help="with --compare: the maker's correction tables, CSV "
                        'with the columns table_angle_deg,ctz_um,crz_urad')
    parser.add_argument('--figures', metavar='DIR', help='write every figure as a file of its own, too')
    parser.add_argument('--tables', metavar='DIR', help='write every table as CSV, too')
    parser.add_argument('--annex', action='store_true', help='add the annex: all values and further figures')
    add_shared(parser, '--format', '--force')


def run(options: Namespace) -> None:
    """Write the report."""
    if options.maker and not options.compare:
        raise InvalidData('report: --maker goes with --compare only; leave it out')
    if options.format and not options.figures:
        raise InvalidData('report: --format goes with --figures only; leave it out')
    if bool(options.run_path) == bool(options.compare):
        raise InvalidData('report: expected either RUN or --compare RUN RUN RUN RUN (see rosette report --help)')
    for name in ('inputs', 'environment', 'run_id', 'overlay', 'joint', 'share', 'identity', 'refit_spheres'):
        if options.compare and getattr(options, name):
            raise InvalidData(f'report: --{name.replace("_", "-")} does not go with --compare; leave it out')
    if options.compare:
        compare_runs(options)
    elif is_joint(options):
        report_jointly(options)
    else:
        report_run(options, options.run_path[0])


def report_jointly(options: Namespace) -> None:
    """Write the report of several runs as one."""
    if options.overlay:
        raise InvalidData('report: --overlay does not go with --joint; leave it out')
    path = output_of(options, 'joint')
    opened = [open_with_files(one, options.run_id) for one in options.run_path]
    with doing('evaluating'):
        result = joint_result(options, [run for run, _ in opened])
    identity, contradictions = joint_identity(options.run_path, options.run_id, options.identity)
    files = [one for _, files in opened for one in files]
    files += map(digest, filter(None, (options.share, options.identity, options.inputs)))
    pictures = joint_pictures(result)
    write_text(path, joint_html(result, files, options.command_line, pictures, identity, contradictions,
                                options.annex), options.force)
    write_parts(options, pictures, joint_tables(result, identity))
    print_result(console(), conclusion_text(conclude(result)), path)


def report_run(options: Namespace, place: str) -> None:
    """Write the report of one run."""
    path = output_of(options, bare_name(place))
    model = read_model(options.model)
    stated = read_stated(options.inputs, options.environment)
    inputs = budget_inputs(stated, options.inputs or 'budget inputs') if stated else None
    measured, source = open_source(place, options.run_id, options.identity)
    if options.refit_spheres:
        measured = open_refitted(place, options.run_id)[0]
    overlays = []
    for over in options.overlay:
        other, other_source = open_source(over)
        overlays.append(Series(other.run_id or str(over), curves_over(measured, other, model)))
        source = replace(source, files=(*source.files, *other_source.files))
    further = tuple(map(digest, filter(None, (options.model, options.identity, options.inputs))))
    source = replace(source, files=(*source.files, *further))
    out, is_whole = console(), bool(options.annex or options.figures or options.tables)
    with doing('', len(STEPS) + is_whole) as step:
        summary = summarise(measured, model, step, has_ladder=is_whole)
        summary = replace(summary, environment=inputs.environment if inputs else None)
        step('draw')
        refit = touches_of(source)[0]
        result = result_of(summary, refit, inputs)
        pictures = pictures_of(summary, overlays, result, is_whole, source)
        write_text(path, report_html(summary, source, options.command_line, overlays, pictures, inputs, options.annex),
                   options.force)
        write_parts(options, pictures, every_table(summary, source.identity, result))
    out.print(head(measured))
    print_result(out, verdict_text(summary.verdict), path)


def compare_runs(options: Namespace) -> None:
    """Write the report on runs that must agree."""
    path = output_of(options, 'verification')
    verified = verification_of(options.compare, options.maker, read_model(options.model))
    pictures = verification.verification_pictures(verified, bool(options.annex or options.figures))
    page = verification.verification_html(verified, options.command_line, pictures, options.annex)
    write_text(path, page, options.force)
    write_parts(options, pictures, verification.verification_tables(verified))
    print_result(console(), verified.verdict, path)


def verification_of(paths: Iterable[Path | str], maker: Path | str | None = None,
                    model: Model | None = None) -> Verification:
    """Return the Verification of runs by their paths; maker: path of the maker's table."""
    opened = [open_source(path) for path in paths]
    table = read_maker(maker) if maker else None
    with doing('evaluating'):
        return verify([(analyse(measured, model), source) for measured, source in opened], table)


def output_of(options: Namespace, name: str) -> Path:
    """Return the page's path; raises InvalidData where it cannot be written, before any work is done."""
    path = Path(options.output or f'{name}.html')
    refuse_output(path, options.force)
    return path


def write_parts(options: Namespace, pictures: Mapping[str, Figure], tables: Iterable[Table]) -> None:
    """Write every figure and every table into the folders that the options name."""
    if options.figures:
        save_all(pictures, made_folder(options.figures, 'to write to', ''), options.format or 'svg', options.force)
    for name, table in file_names(tables).items() if options.tables else ():
        path = made_folder(options.tables, 'to write to', '') / f'{name}.csv'
        keep_inputs(options, path)
        write_text(path, table.csv(), options.force)


def file_names(tables: Iterable[Table]) -> dict[str, Table]:
    """Return tables by names of files, each one once: a name in a table may be any text of a sharing file."""
    named: dict[str, Table] = {}
    for table in tables:
        name = plain = re.sub(r'[^\w.-]', '_', table.name)[:LONGEST_NAME]
        number = 1
        while name in named:
            number += 1
            name = f'{plain}_{number}'
        named[name] = table
    return named


def print_result(out: Console, verdict: VerdictText | ConclusionText, path: Path | str) -> None:
    """Print the verdict and where the page is."""
    print_verdict(out, verdict)
    out.print(f'[bold]Report[/]  {escape(str(path))}', soft_wrap=True)


IMPLEMENTED = {'report': (add_arguments, run)}

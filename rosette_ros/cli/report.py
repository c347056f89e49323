# SPDX-License-Identifier: Apache-2.0
"""rosette report: the page of a run, of several runs as one, or of runs that must agree as in the paper."""

import re
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from rosette_ros.analysis import STEPS
from rosette_ros.api.documents import ReportPage, joint_page, run_page, verification_page
from rosette_ros.api.measurement import read
from rosette_ros.cli.arguments import add_shared, keep_inputs, made_folder
from rosette_ros.cli.console import console, doing, head, print_verdict
from rosette_ros.cli.opened import Opened, add_archived, add_joint, every_run, is_joint, take_archived
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.text_file import bare_name, refuse_output, write_text
from rosette_ros.presentation.plots.plot_style import save_all
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.result_words import ConclusionText

LONGEST_NAME = 50
"""Characters in the name of a table's file: 255 bytes are the limit of file systems."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='*')
    add_archived(parser)
    add_shared(parser, '--run-id', '--columns', '--model', '--identity')
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
    if bool(options.run_path or options.archive) == bool(options.compare):
        raise InvalidData('report: expected either RUN or --compare RUN RUN RUN RUN (see rosette report --help)')
    for name in ('inputs', 'environment', 'run_id', 'overlay', 'joint', 'share', 'identity', 'refit_spheres'):
        if options.compare and getattr(options, name):
            raise InvalidData(f'report: --{name.replace("_", "-")} does not go with --compare; leave it out')
    if options.compare:
        compare_runs(options)
        return
    take_archived(options)
    if is_joint(options):
        report_jointly(options)
    else:
        report_run(options, options.run_path[0])


def report_jointly(options: Namespace) -> None:
    """Write the report of several runs as one."""
    if options.overlay:
        raise InvalidData('report: --overlay does not go with --joint; leave it out')
    path = output_of(options, 'joint')
    page = joint_page(every_run(options), options.inputs, options.environment, options.share, options.identity,
                      options.annex, options.command_line, doing)
    write(options, page, path)


def report_run(options: Namespace, place: str) -> None:
    """Write the report of one run."""
    path = output_of(options, bare_name(place))
    is_whole = bool(options.annex or options.figures or options.tables)
    measured = Opened(options, place).measured
    with doing('', len(STEPS) + is_whole) as step:
        page = run_page(measured, options.model, options.inputs, options.environment, options.identity,
                        [read(one, options.columns) for one in options.overlay],
                        options.refit_spheres, options.annex, is_whole, options.command_line, step)
    write(options, page, path)


def compare_runs(options: Namespace) -> None:
    """Write the report on runs that must agree."""
    path = output_of(options, 'verification')
    write(options, verification_page(options.compare, options.maker, options.model, options.annex,
                                     bool(options.figures), options.command_line, doing,
                                     read_columns(options.columns)), path)


def output_of(options: Namespace, name: str) -> Path:
    """Return the page's path; raises InvalidData where it cannot be written, before any work is done."""
    path = Path(options.output or f'{name}.html')
    refuse_output(path, options.force)
    return path


def write(options: Namespace, page: ReportPage, path: Path) -> None:
    """Write the page and, into the folders that the options name, every figure and table; say what it says."""
    write_text(path, page.html, options.force)
    if options.figures:
        save_all(page.pictures, made_folder(options.figures, 'to write to', ''), options.format or 'svg',
                 options.force)
    for name, table in file_names(page.tables).items() if options.tables else ():
        file = made_folder(options.tables, 'to write to', '') / f'{name}.csv'
        keep_inputs(options, file)
        write_text(file, table.csv(), options.force)
    out = console()
    if page.run is not None:
        out.print(head(page.run))
    print_result(out, page.verdict, path)


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

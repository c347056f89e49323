# SPDX-License-Identifier: Apache-2.0
"""rosette report: a run told on one page, or several runs beside one another as in the paper."""

import shlex
from dataclasses import replace
from pathlib import Path

from rich.markup import escape

from rosette_ros.analysis import analyse
from rosette_ros.cli.arguments import add_run_id
from rosette_ros.cli.compare import add_model, model_of
from rosette_ros.cli.screen import console
from rosette_ros.cli.summary import head
from rosette_ros.core.errors import InvalidData
from rosette_ros.pictures.style import save
from rosette_ros.report.page import refuse_existing, report_html, write_text
from rosette_ros.report.parts import Overlay, pictures_of
from rosette_ros.report.sources import digest, open_source
from rosette_ros.report.tables import tables_of
from rosette_ros.report.verification import read_maker, verify
from rosette_ros.report.verification_page import (
    verification_html,
    verification_pictures,
    verification_tables,
)
from rosette_ros.story import BAD, GOOD, tell

FORMATS = ('svg', 'png')
COLOURS = {GOOD: 'green', BAD: 'red'}


def add_arguments(parser):
    """Declare what the verb takes."""
    parser.add_argument('run_path', metavar='RUN', nargs='?',
                        help='log directory, .mcap file or ball-centre table (CSV)')
    add_run_id(parser)
    add_model(parser)
    parser.add_argument('-o', '--output', metavar='FILE',
                        help='the page (HTML) to write; by default named after RUN, in this folder')
    parser.add_argument('--overlay', metavar='RUN', nargs='+', default=[],
                        help='other runs whose curves are drawn over those of RUN, under the same model')
    parser.add_argument('--compare', metavar='RUN', nargs='+', default=[],
                        help="the paper's verification: four runs (i) all corrected, (ii) plate turned by 90°, "
                        '(iii) CMM correction off, (iv) that and the table axial correction off; two more: table '
                        'angular correction off, and on again')
    parser.add_argument('--maker', metavar='FILE', help="with --compare: the maker's correction tables, CSV "
                        'with the columns table_angle_deg,ctz_um,crz_urad')
    parser.add_argument('--figures', metavar='DIR', help='write every figure as a file of its own, too')
    parser.add_argument('--format', choices=FORMATS, default='svg', help='of these files (default svg)')
    parser.add_argument('--tables', metavar='DIR', help='write every table as CSV, too')
    parser.add_argument('--force', action='store_true', help='overwrite what is there')


def run(options):
    """Write the report."""
    if options.maker and not options.compare:
        raise InvalidData('report: --maker goes with --compare only; leave it out')
    if bool(options.run_path) == bool(options.compare):
        raise InvalidData('report: wanted either RUN or --compare RUN RUN RUN RUN (see rosette report --help)')
    if options.compare:
        compare_runs(options)
    else:
        report_run(options)


def report_run(options):
    """Write the report of one run."""
    path = output_of(options, Path(options.run_path).absolute().stem)
    model = model_of(options)
    run, source = open_source(options.run_path, options.run_id)
    overlays = []
    for place in options.overlay:
        other, other_source = open_source(place)
        overlays.append(Overlay(other.run_id or str(place), analyse(other, model)))
        source = replace(source, files=(*source.files, *other_source.files))
    if options.model:
        source = replace(source, files=(*source.files, digest(options.model)))
    out = console()
    with out.status('evaluating') as status:
        story = tell(run, model, lambda step: status.update(f'{step} …'))
        status.update('drawing …')
        pictures = pictures_of(story, overlays)
        text = report_html(story, source, command_of(options), overlays, pictures)
        write_text(path, text, options.force)
        if options.figures:
            write_figures(pictures, options)
        if options.tables:
            write_tables(tables_of(story), options)
    out.print(head(run))
    say(out, story.verdict, path)


def compare_runs(options):
    """Write the report on runs that must agree."""
    path = output_of(options, 'verification')
    for name, given in (('--run-id', options.run_id), ('--overlay', options.overlay)):
        if given:
            raise InvalidData(f'report: {name} does not go with --compare; leave it out')
    verification = verification_of(options.compare, options.maker, model_of(options))
    pictures = verification_pictures(verification)
    write_text(path, verification_html(verification, command_of(options), pictures), options.force)
    if options.figures:
        write_figures(pictures, options)
    if options.tables:
        write_tables(verification_tables(verification), options)
    say(console(), verification.verdict, path)


def verification_of(paths, maker=None, model=None):
    """Return the Verification of runs by their paths; maker: path of the maker's table, or None."""
    opened = [open_source(path) for path in paths]
    table = read_maker(maker) if maker else None
    return verify([(analyse(run, model), source) for run, source in opened], table)


def output_of(options, name):
    """Return the page's path; raises InvalidData where it stands already, before any work is done."""
    path = Path(options.output or f'{name}.html')
    refuse_existing(path, options.force)
    if not path.parent.is_dir():
        raise InvalidData(f'{path}: wanted a name in a folder that is there, got none; make {path.parent} first')
    return path


def command_of(options):
    """Return the command line that makes the same report again."""
    words = ['rosette', 'report', *([str(options.run_path)] if options.run_path else [])]
    for name in ('run_id', 'model', 'output', 'overlay', 'compare', 'maker'):
        value = getattr(options, name)
        if value:
            words += [f'--{name.replace("_", "-")}', *(value if isinstance(value, list) else [value])]
    return shlex.join(map(str, words))


def write_figures(pictures, options):
    """Write every Picture into a folder."""
    folder = folder_of(options.figures)
    for name, picture in pictures.items():
        path = folder / f'{name}.{options.format}'
        refuse_existing(path, options.force)
        save(picture.figure, path)


def write_tables(tables, options):
    """Write every Table into a folder."""
    folder = folder_of(options.tables)
    for table in tables:
        write_text(folder / f'{table.name}.csv', table.csv(), options.force)


def folder_of(path):
    """Make a folder and return it."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidData(f'{path}: wanted a folder to write to, got: {error.strerror}') from error
    return Path(path)


def say(out, verdict, path):
    """Print the verdict and where the page is."""
    colour = COLOURS.get(verdict.level, 'yellow')
    out.print(f'[{colour}]{escape(verdict.sentence)}[/]')
    out.print(escape(verdict.action))
    out.print(f'[bold]Report[/]  {escape(str(path))}', soft_wrap=True)

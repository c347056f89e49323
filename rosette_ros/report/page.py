# SPDX-License-Identifier: Apache-2.0
"""The page of one run: a Story into one HTML file that needs nothing else."""

from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.model_file import format_model
from rosette_ros.pictures.svg import inline_svg
from rosette_ros.report.parts import MARKS, conditions, findings, glance, pictures_of, spans
from rosette_ros.report.sources import software
from rosette_ros.report.tables import tables_of

PAGES = Environment(loader=PackageLoader('rosette_ros.report'), autoescape=True, trim_blocks=True,
                    lstrip_blocks=True, undefined=StrictUndefined)
SECTIONS = (('verdict', 'Verdict'), ('curves', 'Error motions'), ('deviations', 'Plate and CMM'),
            ('residuals', 'Residuals'), ('ladder', 'Ladder'), ('candidates', 'Candidates'),
            ('visibility', 'Visibility'), ('conditions', 'Conditions'))
"""Name and title of every section, in order."""


def report_html(story, source=None, command='', overlays=(), pictures=None):
    """Return the report of a Story as one HTML text; the same story gives the same text.

    source: Source of the run, or None; command: the command line that made it; overlays: Overlay each;
    pictures: of `pictures_of`, where they have been drawn already.
    """
    pictures = pictures or pictures_of(story, overlays)
    return PAGES.get_template('report.html.j2').render(
        sections=SECTIONS, story=story, run=story.run, source=source, command=command,
        mark=MARKS[story.verdict.level], verdict=story.verdict, bars=glance(story),
        spans=spans(story.final.error_motions), findings=findings(story),
        pictures={name: drawn(picture) for name, picture in pictures.items()},
        tables={table.name: table for table in tables_of(story)}, conditions=conditions(story, source),
        model=format_model(story.final.model), software=software(), overlays=overlays,
        gauge=story.report.gauge, summary=micro_sign(story.comparison.summary),
        diagnosis=micro_sign(story.diagnosis.verdict), unavailable=story.diagnosis.unavailable,
        advice=micro_sign(story.advice.text) if story.advice else '')


def write_report(path, story, source=None, command='', overlays=(), force=False):
    """Write the report of a Story as one HTML file; arguments as of `report_html`.

    Raises InvalidData where a file of that name stands already and `force` is not set.
    """
    refuse_existing(path, force)
    write_text(path, report_html(story, source, command, overlays), force)


def drawn(picture):
    """Return a Picture as (SVG, caption) for a page; texts in the SVG are escaped already."""
    return inline_svg(picture.figure, picture.name, picture.caption), picture.caption


def micro_sign(text):
    """Return a sentence of the core with the signs for micro and for a change."""
    return text.replace(' um', ' µm').replace(' -> ', ' → ')


def write_text(path, text, force=False):
    """Write a text file; raises InvalidData where one stands already and `force` is not set."""
    path = Path(path)
    refuse_existing(path, force)
    try:
        with path.open('w' if force else 'x', encoding='utf-8', newline='') as stream:
            stream.write(text)
    except OSError as error:
        raise InvalidData(f'{path}: cannot be written: {error.strerror}') from error


def refuse_existing(path, force=False):
    """Raise InvalidData where a file stands already and `force` is not set."""
    if Path(path).exists() and not force:
        raise InvalidData(f'{path}: exists already; take another name or use --force')

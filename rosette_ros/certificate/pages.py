# SPDX-License-Identifier: Apache-2.0
"""A certificate for people: pages of PDF with the XML attached."""

import io
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from html import escape, unescape
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from pypdf import PdfReader, PdfWriter, Transformation
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.lib.utils import ImageReader
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import (
    Flowable,
    KeepTogether,
    PageBreak,
    Paragraph,
    SimpleDocTemplate,
    Spacer,
    Table,
    TableStyle,
)

from rosette_ros.certificate.statements import COMPENSATED, DOI, METHOD, PAPER, Certificate, CurveSet, Measured
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.io.identity_file import DEVICES, PICTURES
from rosette_ros.io.text_file import read_limited
from rosette_ros.presentation import error_results
from rosette_ros.presentation.budget_results import contributions
from rosette_ros.presentation.formatting import curve_units, glued
from rosette_ros.presentation.identity_words import NOT_STATED, SIMULATED, contact, signer
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.tables import curves as values_of
from rosette_ros.presentation.tables import effects
from rosette_ros.words.budget_words import not_considered

PLAIN, BOLD = 'DejaVu Sans', 'DejaVu Sans Bold'
SIZE, HEAD, TITLE = 8.0, 9.5, 15.0
SIDE, TOP, FOOT, PADDING = 16 * mm, 17 * mm, 15 * mm, 6
"""Margins, and what reportlab leaves free within them, points."""
ROOM = 45 * mm, 16 * mm
"""Width and height of the logo and of the accreditation mark on the first page."""
FEW, SECTIONS, MOST_BYTES = 0.22, 3, 4 << 20
"""A page that is filled to less of its height has only a few lines; so many of the last sections may begin one, so
that it does not; the size of a picture."""
WIDTH = A4[0] - 2 * SIDE
INK, SOFT, LINE, RED = (colors.HexColor(one) for one in ('#000000', '#555555', '#bbbbbb', '#a33c00'))
COLOURS = {Conformity.CONFORMS: '#00694b', Conformity.FAILS: '#a33c00', Conformity.UNDECIDED: '#8a5a00'}
SHOWN = ('error', 'range_in_unit', 'U_range_in_unit', 'once_per_turn_in_unit', 'residual_in_unit',
         'asynchronous_in_unit', 'U_asynchronous_in_unit', 'tolerance_in_unit', 'conformity')
NEGLIGIBLE = 0.05
"""A contribution below this share of u in each curve is named beneath the table of the budget, not a row of it."""
WIDTHS = (1.0, 0.92, 0.85)
"""Shares of the width that the curves are tried with, until a page and one a set of curves do."""
OF_RUN = ('Readings', 'Sequence', 'Table axis', 'First and last reading', 'Duration', 'Pauses', 'Temperature',
          'Repeatability')
"""What is told of a run that is the only one; of several, each has a line of OF_ONE_OF_SEVERAL."""
OF_ONE_OF_SEVERAL = ('Readings', 'Sequence', 'First and last reading', 'Temperature')


class FigurePlace(Flowable):  # type: ignore[misc]  # reportlab has no types
    """Room for a figure; where it came to lie: page from 0, x, y, points."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self.width, self.height = width, height
        self.page, self.x, self.y = 0, 0.0, 0.0

    def draw(self) -> None:
        """Remember the place."""
        self.page = self.canv.getPageNumber() - 1
        self.x, self.y = self.canv.absolutePosition((WIDTH - self.width) / 2, 0)


class Pages(SimpleDocTemplate):  # type: ignore[misc]
    """Pages of which is known how far each is filled: used, points by page."""

    used: dict[int, float]

    def afterFlowable(self, flowable: Flowable) -> None:
        """Take note of it; reportlab calls this."""
        if self.frame is not None:  # between two pages
            self.used[self.page] = self.frame._y2 - self.frame._y


def to_pdf(certificate: Certificate, data: bytes, name: str, folder: Path = Path()) -> bytes:
    """Return the pages as PDF; data, name: of the XML, which is attached; folder: of the pictures that the identity
    names. Raises InvalidData where one of these cannot be read."""
    _fonts()
    head = HeadPictures.of(certificate, folder)
    figures = [six_curves([Series(one.words, one.motions)], '' if len(certificate.sets) == 1 else one.words)
               for one in certificate.sets]
    tried = {share: len(_built(certificate, head, figures, share).used) for share in WIDTHS}
    share = min(tried, key=tried.__getitem__)
    pages = tried[share]
    behind = min(range(-1, SECTIONS), key=lambda place: _built(certificate, head, figures, share, behind=place).cost)
    built = _built(certificate, head, figures, share, pages, behind)
    data_of_pages, places = built.data, built.places
    writer = PdfWriter(clone_from=io.BytesIO(data_of_pages))
    for figure, place in zip(figures, places, strict=True):
        drawn = PdfReader(io.BytesIO(_drawn(figure))).pages[0]
        scale = place.width / float(drawn.mediabox.width)
        writer.pages[place.page].merge_transformed_page(
            drawn, Transformation().scale(scale).translate(place.x, place.y))
    writer.add_attachment(name, data)
    out = io.BytesIO()
    writer.write(out)
    return out.getvalue()


@dataclass(frozen=True)
class Built:
    """Pages without figures, where these belong, and how far each page is filled, points."""

    data: bytes
    places: list[FigurePlace]
    used: tuple[float, ...]

    @property
    def cost(self) -> tuple[int, int]:
        """How many pages it is, and how many of them have only a few lines."""
        return len(self.used), sum(one < FEW * A4[1] for one in self.used)


@dataclass(frozen=True)
class HeadPictures:
    """Pictures of the head of the pages, None where none is stated: its room stays free."""

    logo: ImageReader | None = None
    mark: ImageReader | None = None

    @classmethod
    def of(cls, certificate: Certificate, folder: Path) -> 'HeadPictures':
        """Return what an identity names; raises InvalidData where it is no picture."""
        return cls(*(_picture(folder / words) if (words := certificate.identity[entry]) else None
                     for entry in PICTURES))


def _picture(path: Path) -> ImageReader:
    try:
        made = ImageReader(io.BytesIO(read_limited(path, 'a picture', MOST_BYTES)))
        made.getRGBData()
    except InvalidData:
        raise
    except Exception as error:  # whatever a library of pictures raises
        raise InvalidData(f'{path}: expected a picture (PNG, JPEG), found something else') from error
    return made


def _built(certificate: Certificate, head: HeadPictures, figures: Sequence[Figure], share: float, pages: int = 0,
           behind: int = -1) -> Built:
    """Return the pages; share: of the width that figures take; pages: their number, if known; behind: which of the
    last sections begins a page, -1 for none."""
    width = share * WIDTH
    places = [FigurePlace(width, width * figure.get_figheight() / figure.get_figwidth()) for figure in figures]
    stream = io.BytesIO()
    made = Pages(stream, pagesize=A4, leftMargin=SIDE - PADDING, rightMargin=SIDE - PADDING,
                 topMargin=TOP, bottomMargin=FOOT, title=f'Certificate {_number(certificate)}',
                 author=certificate.identity['laboratory.name'], invariant=1)
    made.used = {}
    frame = partial(_frame, certificate=certificate, head=head, pages=pages)
    made.build(_flowables(certificate, places, behind), onFirstPage=frame, onLaterPages=frame)
    return Built(stream.getvalue(), places, tuple(made.used.values()))


@cache
def _fonts() -> None:
    for name, weight in ((PLAIN, 'normal'), (BOLD, 'bold')):
        pdfmetrics.registerFont(TTFont(name, findfont(FontProperties(family='DejaVu Sans', weight=weight))))
    pdfmetrics.registerFontFamily(PLAIN, normal=PLAIN, bold=BOLD, italic=PLAIN, boldItalic=BOLD)


def _drawn(figure: Figure) -> bytes:
    stream = io.BytesIO()
    with mpl.rc_context({'pdf.fonttype': 42}):
        figure.savefig(stream, format='pdf', metadata={'CreationDate': None})
    return stream.getvalue()


def _frame(canvas: Any, document: Any, certificate: Certificate, head: HeadPictures, pages: int) -> None:
    """Draw the head of a page: number and page, pictures on the first one, and whether it was simulated."""
    right, line = A4[0] - SIDE, A4[1] - 11 * mm
    canvas.setFont(PLAIN, SIZE)
    canvas.setFillColor(SOFT)
    words = _fitting(_known(f'Calibration certificate {_number(certificate)}'), 0.55 * WIDTH)
    canvas.drawString(SIDE, line, words)
    canvas.drawRightString(right, line, f'page {document.page} of {pages}')
    canvas.setStrokeColor(LINE)
    canvas.line(SIDE, line - 2 * mm, right, line - 2 * mm)
    if document.page == 1:
        for picture, anchor, x in ((head.logo, 'nw', SIDE), (head.mark, 'ne', right - ROOM[0])):
            if picture is not None:
                canvas.drawImage(picture, x, line - 5 * mm - ROOM[1], *ROOM, mask='auto', preserveAspectRatio=True,
                                 anchor=anchor)
    if certificate.is_simulated:
        canvas.setFillColor(RED)
        canvas.setFont(BOLD, SIZE + 1)
        canvas.drawCentredString(A4[0] / 2, 8 * mm, 'SIMULATED: no real table was measured')


def _fitting(words: str, width: float) -> str:
    """Return a text, cut with an ellipsis where it is wider."""
    cut = words
    while pdfmetrics.stringWidth(cut, PLAIN, SIZE) > width:
        cut = f'{cut.removesuffix("…")[:-1]}…'
    return cut


def _flowables(one: Certificate, places: Sequence[FigurePlace], behind: int = -1) -> list[Any]:
    identity = one.identity
    flowables: list[Any] = [
        Spacer(1, ROOM[1] - 5 * mm), _words('Calibration certificate', TITLE, BOLD, alignment=1), Spacer(1, 1.5 * mm),
        _words(f'<b>No. {_text(_number(one))}</b>, issued {one.inputs.issued}: error motions of a rotary table',
               alignment=1),
        Spacer(1, 2 * mm)]
    if one.is_simulated:
        flowables += [_boxed(SIMULATED), Spacer(1, 2 * mm)]
    flowables += [_pairs([
        ('Laboratory', '; '.join(filter(None, (
            contact(identity, 'laboratory'), identity['laboratory.email'], identity['laboratory.phone'],
            identity['laboratory.accreditation'])))),
        ('Customer', '; '.join(filter(None, (contact(identity, 'customer'), f'order {identity["customer.order"]}'
                                             if identity['customer.order'] else '')))),
        ('Place and date(s) of calibration', f'{identity["place.name"] or NOT_STATED}; {one.days[0]} to {one.days[1]}'),
        ('Operator', identity['operator.name'])])]
    flowables += [_heading('Calibration item and reference equipment'), _grid(
        [('', 'maker', 'model', 'serial number', 'calibration, remarks'), *(
            (f'<b>{words}</b>', *(_text(identity[f'{name}.{entry}'] or NOT_STATED)
                                  for entry in ('maker', 'model', 'serial')), _text('; '.join(filter(None, (
                                      identity[f'{name}.{entry}'] for entry in ('calibration', 'remarks'))))))
            for name, words in DEVICES.items())])]
    flowables += [_heading('Measurement: method and conditions'),
                  _words(f'{_text(METHOD)} {_text(PAPER)}, <link href="{DOI}">{DOI.partition("org/")[2]}</link>.'),
                  Spacer(1, 1 * mm), _pairs([
                      *_measured(one.runs), ('Conditions', '; '.join(
                          f'{name.lower()}: {words or NOT_STATED}' for name, words in one.conditions)),
                      ('Traceability', identity['traceability.name'] or NOT_STATED), *one.evaluation])]
    flowables += [_heading('Results: error motions of the rotary table (ISO 230-7)'),
                  _words(f'<b>{_text(one.judgement)}</b>'), Spacer(1, 1 * mm)]
    for curves in one.sets:
        table = error_results.errors(curves.lines).select(*SHOWN)
        if len(one.sets) > 1:
            flowables += [_words(f'<b>{_text(curves.words)}</b>')]
        flowables += [_grid([tuple(column.head for column in table.shown), *(
            (*map(_text, row[:-1]), _coloured(row[-1], line.conformity))
            for row, line in zip(table.rows, curves.lines, strict=True))],
            [place for place, column in enumerate(table.shown) if column.number])]
    note = error_results.errors([line for curves in one.sets for line in curves.lines]).note
    flowables += [Spacer(1, 1 * mm), *([_words(f'<b>{_text(one.beside_conformity)}</b>')] * one.is_limited),
                  _words(_text(note), soft=True)]
    if words := identity['certificate.remarks']:
        flowables += [Spacer(1, 1 * mm), _words(f'<b>Remarks</b>: {_text(words)}')]
    if one.compensated:
        flowables += _compensated(one)
    if one.budget:
        flowables += _budget(one.budget)
    flowables += [_heading('Error motions over the table angle, with the band of U (k = 2)'), *places,
                  *map(_values, one.sets)]
    last = [[_heading('Limitations and conditions of validity'), *_bullets(one.unknown)]]
    if one.missing:
        last += [[_heading('Missing mandatory data (ISO/IEC 17025, 7.8.2)'), _words(_text(', '.join(one.missing)))]]
    last += [[_heading('Data and software'), *_bullets(
        [*(f'{file.path}: SHA-256 {file.sha256}' for file in one.files),
         ', '.join(f'{name} {version}' for name, version in one.inputs.programs if version[:1].isdigit()),
         'The attached XML document (DCC) is authoritative; this printout is for information. It can be verified '
         'against the run.']), _signature(one)]]
    for place, section in enumerate(last):
        flowables += [*[PageBreak()] * (place == behind), *section]
    return flowables


def _compensated(one: Certificate) -> Iterable[Any]:
    """Yield the effects in the model with their sizes and U, as a table with its heading."""
    table = effects([(each.name, each.setting, each.parameters) for each in one.compensated], '', one.time_unit)
    rows = [tuple(map(_text, row)) for row in table.rows]
    yield KeepTogether([_heading(f'Compensated: {COMPENSATED}'), _grid(
        [tuple(column.head for column in table.shown), *rows],
        [place for place, column in enumerate(table.shown) if column.number]), Spacer(1, 1 * mm)])
    if table.note:
        yield _words(_text(table.note), soft=True)


def _budget(made: Budget) -> Iterable[Any]:
    """Yield the contributions to U as a table with its heading, what is left out of it, and what is not considered."""
    table = contributions(made)
    is_shown = [bool(np.any(one.mean >= NEGLIGIBLE * made.mean)) for one in made.contributions]
    small = [one.name for one, shown in zip(made.contributions, is_shown, strict=True) if not shown]
    heads = ['contribution', *(f'{curve} / {unit}' for curve, unit in zip(CURVES, curve_units(), strict=True))]
    grid = _grid([heads, *(tuple(map(_text, row)) for row, shown in zip(table.rows, is_shown, strict=True) if shown),
                  *(tuple(f'<b>{_text(cell)}</b>' for cell in row) for row in table.footer)],
                 [place for place, column in enumerate(table.shown) if column.number])
    less = f'Also in u, each below {NEGLIGIBLE:.0%} of it: {", ".join(small)}.' if small else ''
    yield KeepTogether([_heading('Uncertainty budget (GUM)'), grid, Spacer(1, 1 * mm)])
    note = ' '.join(filter(None, (table.note, less, 'Not considered:', *not_considered(made))))
    yield _words(f'<b>Budget</b>: {_text(note)}', soft=True)


def _values(curves: CurveSet) -> Any:
    """Return six curves in numbers, with U."""
    table = values_of(curves.motions)
    return _grid([[column.head for column in table.shown], *(
        tuple(_text(cell.replace('\n', ' ')) for cell in row) for row in table.rows), *(
        tuple(f'<b>{_text(cell)}</b>' for cell in row) for row in table.footer)],
        range(len(table.shown)))


def _measured(runs: Sequence[Measured]) -> Iterable[tuple[str, str]]:
    for run in runs:
        rows = dict(run.rows)
        if len(runs) == 1:
            yield 'Run', run.name
            yield from ((name, rows[name]) for name in OF_RUN if name in rows)
        else:
            yield 'Run', '; '.join([run.name, *(rows[name] for name in OF_ONE_OF_SEVERAL if name in rows)])


def _signature(one: Certificate) -> Any:
    who = signer(one.identity) or f'signer {NOT_STATED}'
    line = '_' * 34
    return KeepTogether([Spacer(1, 9 * mm), _grid([
        (line, line, line), ('place, date', 'signature', _text(who))], lines=False)])


# Parts --------------------------------------------------------------------------------------------


def _number(one: Certificate) -> str:
    return one.identity['certificate.number']


def _known(words: str) -> str:
    """Return a text as the pages set it; raises InvalidData where it has letters that the font cannot set.

    Letters that run from right to left, or combine with others, would need a shaping library."""
    _fonts()
    letters = pdfmetrics.getFont(PLAIN).face.charToGlyph
    text = ''.join(' ' if unicodedata.category(one) in ('Cc', 'Cf') else one
                   for one in unicodedata.normalize('NFC', words))
    lacking = [one for one in text if ord(one) not in letters or unicodedata.bidirectional(one) in ('R', 'AL', 'AN')
               or unicodedata.category(one) in ('Mn', 'Mc', 'Me')]
    if lacking:
        kinds = dict.fromkeys(unicodedata.name(one, f'U+{ord(one):04X}').split()[0].lower() for one in lacking)
        raise InvalidData(f'--pdf: expected letters that its font can set, found {words!r:.80} with letters named '
                          f'{", ".join(kinds)}; state it in Latin, Greek or Cyrillic letters, or leave --pdf out: the '
                          'certificate (XML) takes every script')
    return text


def _text(words: str) -> str:
    return escape(glued(_known(words)), quote=False)


def _words(markup: str, size: float = SIZE, font: str = PLAIN, soft: bool = False, alignment: int = 0) -> Paragraph:
    style = ParagraphStyle('', fontName=font, fontSize=size, leading=1.25 * size, textColor=SOFT if soft else INK,
                           alignment=alignment, splitLongWords=1, allowWidows=0, allowOrphans=0)
    return Paragraph(markup, style)


def _heading(words: str) -> Paragraph:
    """Return a heading, on one page with what follows it."""
    style = ParagraphStyle('', fontName=BOLD, fontSize=HEAD, leading=1.3 * HEAD, spaceBefore=2.4 * mm,
                           spaceAfter=1 * mm, keepWithNext=1)
    return Paragraph(_text(words), style)


def _boxed(words: str) -> Table:
    return Table([[_words(f'<font color="{RED.hexval().replace("0x", "#")}"><b>{_text(words)}</b></font>', HEAD)]],
                 colWidths=[WIDTH], style=TableStyle([('BOX', (0, 0), (-1, -1), 1.4, RED)]))


def _bullets(sentences: Iterable[str]) -> list[Paragraph]:
    style = ParagraphStyle('', fontName=PLAIN, fontSize=SIZE, leading=1.25 * SIZE, leftIndent=8, bulletIndent=0)
    return [Paragraph(_text(words), style, bulletText='•') for words in sentences]


def _pairs(rows: Iterable[tuple[str, str]]) -> Table:
    return Table([[_words(f'<b>{_text(name)}</b>'), _words(_text(words or NOT_STATED))] for name, words in rows],
                 colWidths=[0.15 * WIDTH, 0.85 * WIDTH], style=_style(False))


def _grid(rows: Sequence[Sequence[str]], numbers: Sequence[int] = (), lines: bool = True) -> Table:
    """Return a table of markup, its first row the head; numbers: columns that are aligned right."""
    made = [[_words(f'<b>{_text(cell)}</b>' if row == 0 and lines else cell, alignment=2 if place in numbers else 0)
             for place, cell in enumerate(cells)] for row, cells in enumerate(rows)]
    return Table(made, colWidths=_widths(rows), style=_style(lines), repeatRows=int(lines))


def _style(lines: bool) -> TableStyle:
    ruled = [('LINEBELOW', (0, 0), (-1, 0), 0.8, SOFT), ('LINEBELOW', (0, 1), (-1, -1), 0.3, LINE)] if lines else []
    return TableStyle([('VALIGN', (0, 0), (-1, -1), 'TOP'), ('LEFTPADDING', (0, 0), (-1, -1), 0),
                       ('RIGHTPADDING', (0, 0), (-1, -1), PADDING), ('TOPPADDING', (0, 0), (-1, -1), 0.8),
                       ('BOTTOMPADDING', (0, 0), (-1, -1), 1.2), *ruled])


def _widths(rows: Sequence[Sequence[str]]) -> list[float]:
    """Return the widths of columns of markup, points: each as its longest text where all fit, else at least as its
    longest word, and what is left by the length of the texts."""
    texts = [[unescape(re.sub('<[^>]*>', '', cell)) for cell in column] for column in zip(*rows, strict=True)]
    whole, least = ([max(pdfmetrics.stringWidth(part, BOLD, SIZE) for cell in column for part in cell.split(between))
                     + PADDING + 1 for column in texts] for between in ('\0', ' '))
    short = [min(one, WIDTH / len(texts)) for one in whole] if sum(least) > WIDTH else least
    left, more = WIDTH - sum(short), [max(one - other, 0) for one, other in zip(whole, short, strict=True)]
    if left >= sum(more):
        return [one + other + (left - sum(more)) / len(texts) for one, other in zip(short, more, strict=True)]
    return [one + left * other / sum(more) for one, other in zip(short, more, strict=True)]


def _coloured(words: str, conformity: Conformity | None) -> str:
    colour = COLOURS.get(conformity) if conformity else None
    return f'<font color="{colour}"><b>{_text(words)}</b></font>' if colour else _text(words)

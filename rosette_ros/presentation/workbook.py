# SPDX-License-Identifier: Apache-2.0
"""Results as a workbook for Excel: a sheet with the verdict, one for each table, with exact numbers."""

import io
import re
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from rosette_ros.presentation.table_format import Column, Table

FILLS = {'good': 'C8E6C9', 'doubtful': 'FFE0B2', 'bad': 'FFCDD2'}
"""Colours of verdicts and rows, by level."""
WIDEST = 60
"""Of a column, characters; longer texts are wrapped."""
LONGEST_NAME = 31
"""Characters in the name of a sheet, which Excel allows."""


def workbook(openpyxl: ModuleType, sentences: Sequence[str], level: str, tables: Sequence[Table],
             source: str = '') -> bytes:
    """Return a workbook: sentences of the verdict in the colour of a level, and a sheet for each table.

    Numbers are exact and shown with the digits that print has; openpyxl: the package, which not everybody has;
    source: of the run."""
    made, styles = openpyxl.Workbook(), openpyxl.styles
    first = made.active
    first.title = 'Result'
    first.column_dimensions['A'].width = 2 * WIDEST
    for row, words in enumerate([*sentences, *([f'Run: {source}'] if source else [])], 1):
        cell = first.cell(row, 1, _plain(words))
        cell.alignment = styles.Alignment(wrap_text=True, vertical='top')
        if row == 1:
            cell.font = styles.Font(bold=True)
            if level in FILLS:
                cell.fill = styles.PatternFill('solid', fgColor=FILLS[level])
    for table in tables:
        if table.rows:
            _fill(made.create_sheet(_name(table, made.sheetnames)), table, openpyxl)
    stream = io.BytesIO()
    made.save(stream)
    return stream.getvalue()


def _fill(sheet: Any, table: Table, openpyxl: ModuleType) -> None:
    styles = openpyxl.styles
    sheet.cell(1, 1, _plain(table.title)).font = styles.Font(bold=True)
    for place, column in enumerate(table.columns, 1):
        head = sheet.cell(2, place, f'{column.name} / {column.unit}' if column.name and column.unit else
                          column.name or column.key)
        head.font, head.alignment = styles.Font(bold=True), styles.Alignment(wrap_text=True, vertical='top')
        texts = [str(head.value)]
        for row, value in enumerate(column.values):
            shown = column.shown[row] if column.shown else ''
            cell = sheet.cell(3 + row, place, _value(value))
            if isinstance(value, float):
                cell.number_format = _format(value, shown)
            if table.level(row) in FILLS:
                cell.fill = styles.PatternFill('solid', fgColor=FILLS[table.level(row)])
            cell.alignment = styles.Alignment(wrap_text=not column.number, vertical='top')
            texts.append(shown if column.shown else f'{value!s:.12}')
        sheet.column_dimensions[openpyxl.utils.get_column_letter(place)].width = _width(column, texts)
    if table.note:
        sheet.cell(4 + len(table.rows), 1, _plain(table.note))
    sheet.freeze_panes = 'A3'


def _width(column: Column, texts: Sequence[str]) -> int:
    return 2 + min(WIDEST, max(len(word) for text in texts for word in (text.split() if column.number else [text])
                               or ['']))


def _value(value: Any) -> Any:
    """Return what a cell holds: numbers as they are, what is not finite empty, no text that would be a formula."""
    if isinstance(value, float):
        return value if abs(value) < float('inf') else None
    return value if isinstance(value, bool | int) or value is None else _plain(str(value))


def _plain(text: str) -> str:
    """Return a text that no program takes for a formula, without signs that a workbook cannot hold."""
    text = re.sub('[\x00-\x08\x0b\x0c\x0e-\x1f]', '?', text)
    return f"'{text}" if text[:1] in ('=', '@', '+') and not re.fullmatch(r'\+[\d.]+', text) else text


def _format(value: float, shown: str) -> str:
    """Return the format of a number with as many decimals as its text shows, which may be in another unit."""
    found = re.search(r'\d+(?:\.(\d+))?', shown)
    places = len(found[1] or '') if found else 6
    if found and abs(abs(value) - float(found[0])) > 0.51 * 10**-places:
        return 'General'
    return f'0.{"0" * places}' if places else '0'


def _name(table: Table, taken: Sequence[str]) -> str:
    """Return the name of a sheet, each once."""
    name = plain = re.sub(r'[\\/*?:\[\]]', ' ', table.name)[:LONGEST_NAME - 3]
    number = 1
    while name in taken:
        number += 1
        name = f'{plain} {number}'
    return name

# SPDX-License-Identifier: Apache-2.0
"""What spreadsheets make of a table: padded lines, empty rows, semicolons or tabs, decimal commas."""

import csv
from collections.abc import Sequence

from rosette_ros.core.errors import InvalidData

SEPARATORS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}
Row = tuple[int, list[str]]
"""Line and cells of a row."""
_PLACE = ('x_mm', 'y_mm', 'z_mm')


def read_sheet(lines: Sequence[str], columns: Sequence[str], source: str) -> tuple[list[str], list[Row], str]:
    """Return the lines above the names of the columns; the names and the rows; in words how they were read.

    Decimal commas become points, rows without coordinates are left out. columns: names of those that hold numbers.
    Raises InvalidData where quotes stay open, or it is not clear which sign is that of decimals."""
    at = next((at for at, line in enumerate(lines) if line.strip(',;\t ') and not line.startswith(('#', '"#'))), None)
    if at is None:
        return list(lines), [], ''
    separator = next((one for one in SEPARATORS if one in lines[at]), ',')
    names = [name.strip() for name in _cells(lines[at].rstrip(separator + ' '), separator, at + 1, source)]
    numbers = [row for row, name in enumerate(names) if name in columns]
    places = [row for row, name in enumerate(names) if name in _PLACE]
    rows, is_place = [(at + 1, names)], False
    first = dict[str, tuple[int, str]]()  # decimal sign: line and cell where it stands first
    for line, text in enumerate(lines[at + 1:], at + 2):
        cells = _cells(text, separator, line, source)
        if 2 * separator in text or text.endswith(separator) or len(cells) != len(names):
            while len(cells) > len(names) and not cells[-1].strip():
                cells.pop()
            if not any(map(str.strip, cells)) or (len(cells) == len(names) and places and not any(
                    cells[row].strip() for row in places)):
                continue
        for row in (row for row in numbers if row < len(cells)) if separator != ',' else ():
            for sign in ',.':
                if sign in cells[row]:
                    first.setdefault(sign, (line, cells[row].strip()))
                    is_place |= sign == ',' and row in places
            cells[row] = cells[row].replace(',', '.')
        rows.append((line, cells))
    if len(first) > 1:
        (line, cell), (other, point) = first[','], first['.']
        raise InvalidData(f'{source}: line {line}: wanted one decimal sign in the table, got {cell!r}, and {point!r} '
                          f'in line {other}; save it with a point or a comma everywhere, and no sign between thousands')
    if ',' in first and not is_place:
        line, cell = first[',']
        raise InvalidData(f'{source}: line {line}: wanted numbers with a decimal point, got {cell!r}, and no '
                          'coordinate that shows whether the comma stands for decimals or thousands; write it without')
    words = f'{SEPARATORS[separator]} between cells' * (separator != ',') + ' and decimal commas' * (',' in first)
    heading = [_heading(text, separator, line, source) for line, text in enumerate(lines[:at], 1)]
    return heading, rows, f'the table was read with {words}' if words else ''


def _cells(text: str, separator: str, line: int, source: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), []) if '"' in text else text.split(separator)
    except csv.Error as error:
        raise InvalidData(f'{source}: line {line}: wanted cells with closed quotes, got {error}') from error


def _heading(text: str, separator: str, at: int, source: str) -> str:
    """Return a line above the names without padding, quotes, and the decimal comma of a number."""
    line = (_cells(text, separator, at, source)[0] if text.startswith('"') else text).rstrip(separator + ' ')
    key, _, value = line.partition(':')
    whole, comma, rest = value.strip().partition(',')
    is_number = separator != ',' and comma and whole.isdigit() and rest.isdigit() and key[-3:] in ('_mm', '_um', 'dof')
    return f'{key}: {whole}.{rest}' if is_number else line

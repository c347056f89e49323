# SPDX-License-Identifier: Apache-2.0
"""What spreadsheets make of a table: padded lines, empty rows, semicolons or tabs, decimal commas."""

import csv
from collections.abc import Sequence

from rosette_ros.core.errors import InvalidData

SEPARATORS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}
_PLACE = ('x_mm', 'y_mm', 'z_mm')


def plain_lines(lines: Sequence[str], columns: Sequence[str], source: str) -> tuple[list[str], str]:
    """Return the lines of a table with commas and decimal points, and in words how they were read, '' where as is.

    Empty rows, and rows without coordinates, become empty lines: each line keeps its number. columns: names of those
    that hold numbers. Raises InvalidData where it is not clear which sign is that of decimals.
    """
    at = next((at for at, line in enumerate(lines) if line.strip(',;\t ') and not line.startswith(('#', '"#'))), None)
    if at is None:
        return list(lines), ''
    separator = next((one for one in SEPARATORS if one in lines[at]), ',')
    names = [name.strip() for name in _cells(lines[at].rstrip(separator + ' '), separator)]
    numbers = [row for row, name in enumerate(names) if name in columns]
    places = [row for row, name in enumerate(names) if name in _PLACE]
    out = [_heading(line, separator) for line in lines[:at]] + [','.join(names)]
    first = dict[str, tuple[int, str]]()  # decimal sign: line and cell where it stands first
    is_place = False
    for line, text in enumerate(lines[at + 1:], at + 2):
        if separator == ',' and (2 * separator not in text or '"' in text) and not text.endswith(separator):
            out.append(text)
            continue
        cells = _cells(text, separator)
        while len(cells) > len(names) and not cells[-1].strip():
            cells.pop()
        if not any(map(str.strip, cells)) or (len(cells) == len(names) and places and not any(
                cells[row].strip() for row in places)):
            out.append('')
            continue
        for row in (row for row in numbers if row < len(cells)) if separator != ',' else ():
            for sign in ',.':
                if sign in cells[row]:
                    first.setdefault(sign, (line, cells[row].strip()))
                    is_place |= sign == ',' and row in places
            cells[row] = cells[row].replace(',', '.')
        out.append(','.join(f'"{cell}"' if ',' in cell else cell for cell in cells))
    if len(first) > 1:
        (line, cell), (other, point) = first[','], first['.']
        raise InvalidData(f'{source}: line {line}: wanted one decimal sign in the table, got {cell!r}, and {point!r} '
                          f'in line {other}; save it with a point or a comma everywhere, and no sign between thousands')
    if ',' in first and not is_place:
        line, cell = first[',']
        raise InvalidData(f'{source}: line {line}: wanted numbers with a decimal point, got {cell!r}, and no '
                          'coordinate that shows whether the comma stands for decimals or thousands; write it without')
    words = f'{SEPARATORS[separator]} between cells' * (separator != ',') + ' and decimal commas' * (',' in first)
    return out, f'the table was read with {words}' if words else ''


def _cells(text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), []) if '"' in text else text.split(separator)
    except csv.Error:
        return [text]  # the reader of rows tells what is wrong


def _heading(text: str, separator: str) -> str:
    """Return a line above the names without padding, quotes, and the decimal comma of a number."""
    line = (_cells(text, separator)[0] if text.startswith('"') else text).rstrip(separator + ' ')
    key, _, value = line.partition(':')
    whole, comma, rest = value.strip().partition(',')
    is_number = separator != ',' and comma and whole.isdigit() and rest.isdigit() and key[-3:] in ('_mm', '_um', 'dof')
    return f'{key}: {whole}.{rest}' if is_number else line

# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a ball-centre table to columns of numbers; errors tell line and column."""

import csv
import difflib
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from rosette_ros.core.errors import InvalidData

SCHEMA = 'rosette-ball-centres/1'
COLUMNS = ('seq', 'table_position', 'ball', 'cmm_position', 'table_angle_deg', 'x_mm', 'y_mm',
           'z_mm', 'time_s', 'temperature_C', 'approach')
"""Columns of the table in the order of writing; any order is read."""
TRAVEL_COLUMN = 'table_travel_deg'
"""Written only where angles and approach do not tell how the table travelled."""

_OPTIONAL = frozenset(('cmm_position', 'temperature_C', 'approach', TRAVEL_COLUMN))
_INTEGERS = frozenset(('seq', 'table_position', 'ball', 'cmm_position', 'approach'))
_EMPTY = {'temperature_C': 'nan', 'approach': '0'}  # what an empty cell means
_KEYS = ('schema', 'radius_mm', 'repeatability_um', 'repeatability_dof', 'run_id', 'balls',
         'repeated_balls', 'pauses_before', 'note')


@dataclass(frozen=True, eq=False)
class Table:
    """A table as it was written, N rows.

    source: named in errors; columns: array (N,) by column name, units as in the name; angle_cells:
    the texts of table_angle_deg; lines: (N,) line of each row; radius, repeatability: m; balls: as
    the heading says, or None; session: (N,) 1 and one more from each row of `pauses_before` on.
    """

    source: str
    columns: dict
    angle_cells: tuple
    lines: np.ndarray
    radius: float
    repeatability: float | None
    repeatability_dof: float | None
    run_id: str
    balls: int | None
    repeats: bool
    session: np.ndarray

    def wrong(self, row, column, wanted, got, advice=''):
        """Return the InvalidData for one cell."""
        return _wrong(self.source, self.lines[row], column, wanted, got, advice)


def _wrong(source, line, column, wanted, got, advice=''):
    place = f'{source}: line {line}' + (f': column {column}' if column else '')
    return InvalidData(f'{place}: wanted {wanted}, got {got}' + (f'; {advice}' if advice else ''))


def parse_table(data, source):
    """Return the Table of a file's bytes; InvalidData where it is none."""
    lines = _lines(data, source)
    heading, at = _heading(lines, source)
    if at == len(lines):
        raise InvalidData(f'{source}: wanted a line with the names of the columns '
                          f'({",".join(COLUMNS)}), got none')
    names = [name.strip() for name in lines[at].replace('"', '').split(',')]
    _check_names(names, source, at + 1)
    numbers, rows = _rows(lines, at + 1, len(names), source)
    cells = dict(zip(names, zip(*rows, strict=True), strict=True))
    columns = {name: _numbers(cells[name], name, numbers, source) for name in names
               if name in COLUMNS or name == TRAVEL_COLUMN}  # others are somebody else's
    values = {key: value for key, (value, _) in heading.items()}
    return Table(
        source=source, columns=columns, angle_cells=cells['table_angle_deg'],
        lines=np.array(numbers), radius=_positive(heading, 'radius_mm', source, 3),
        repeatability=_positive(heading, 'repeatability_um', source, 6),
        repeatability_dof=_positive(heading, 'repeatability_dof', source),
        run_id=values.get('run_id', ''), balls=_balls(heading, source),
        repeats=_yes(heading, 'repeated_balls', source),
        session=_session(heading, source, len(numbers)))


def _lines(data, source):
    if not data.strip():
        raise InvalidData(f'{source}: is empty; wanted a table of ball centres, {SCHEMA}')
    if b'\0' in data:
        raise InvalidData(f'{source}: is a binary file; wanted a table of ball centres as text, '
                          f'{SCHEMA}')
    try:
        text = data.decode('utf-8-sig')
    except UnicodeDecodeError as error:
        line = data[:error.start].count(b'\n') + 1
        raise InvalidData(f'{source}: line {line}: wanted text in UTF-8, got the byte '
                          f'0x{data[error.start]:02x}; save the table as UTF-8') from error
    return text.replace('\r\n', '\n').replace('\r', '\n').split('\n')


def _heading(lines, source):
    """Return ({key: (value, line)}, index of the line of names)."""
    heading = {}
    at = 0
    while at < len(lines) and (not lines[at].strip() or lines[at].startswith('#')):
        if lines[at].startswith('#'):
            _take_key(heading, lines[at], at + 1, source)
        at += 1
    wanted = f'"# schema: {SCHEMA}" in the first lines'
    if 'schema' not in heading:
        raise InvalidData(f'{source}: wanted {wanted}, got none')
    schema, line = heading['schema']
    if schema != SCHEMA:
        raise _wrong(source, line, '', wanted, repr(schema))
    if 'radius_mm' not in heading:
        raise InvalidData(f'{source}: wanted "# radius_mm: ...", the nominal radius of the circle '
                          'of ball centres, in the first lines, got none')
    return heading, at


def _take_key(heading, text, line, source):
    key, colon, value = text[1:].partition(':')
    key, value = key.strip(), value.strip()
    if key not in _KEYS:
        near = difflib.get_close_matches(key, _KEYS, 1, 0.75) if colon else ()
        if near:  # a misspelt key would be lost in silence
            raise _wrong(source, line, '', f'the key {near[0]}', repr(text[:80]), 'correct it')
        return  # a remark, or a key of somebody else's
    if key in heading and key != 'note':
        raise _wrong(source, line, '', f'{key} once', f'it again (first in line '
                     f'{heading[key][1]})', 'remove one of them')
    heading[key] = (value, line)


def _check_names(names, source, line):
    missing = [name for name in COLUMNS if name not in names and name not in _OPTIONAL]
    if missing:
        advice = ''
        if len(names) == 1 and (';' in names[0] or '\t' in names[0]):
            advice = 'separate cells by commas, and write decimals with a point'
        raise _wrong(source, line, missing[0], 'this column', ','.join(names)[:200], advice)
    for name in names:
        near = difflib.get_close_matches(name, COLUMNS, 1, 0.75)
        if near and name not in (*COLUMNS, TRAVEL_COLUMN):  # it would be lost in silence
            raise _wrong(source, line, '', f'the column {near[0]}', repr(name), 'rename it')
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise _wrong(source, line, twice[0], 'it once', f'{names.count(twice[0])} of them')


def _rows(lines, at, width, source):
    """Return (line of each row, cells of each row)."""
    numbers = [index + 1 for index in range(at, len(lines)) if lines[index].strip()]
    if not numbers:
        raise InvalidData(f'{source}: wanted rows of ball centres, got none')
    texts = [lines[number - 1] for number in numbers]
    if any('"' in text for text in texts):
        rows = [_quoted(text, number, source)
                for text, number in zip(texts, numbers, strict=True)]
    else:
        rows = [text.split(',') for text in texts]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) == width:
            continue
        if row[0].startswith('#'):
            raise _wrong(source, number, '', 'a reading', repr(lines[number - 1][:80]),
                         'lines with # stand above the names of the columns')
        advice = ('write decimals with a point, not a comma' if len(row) > width
                  else 'is the row cut off?')
        raise _wrong(source, number, '', f'{width} cells', f'{len(row)}', advice)
    return numbers, rows


def _quoted(text, number, source):
    try:
        return next(csv.reader([text], strict=True))
    except csv.Error as error:
        raise _wrong(source, number, '', 'cells with closed quotes', str(error)) from error


def _numbers(cells, name, lines, source):
    """Return one column as an array, (N,)."""
    if name in _EMPTY:
        empty = [not cell.strip() for cell in cells]
        cells = [_EMPTY[name] if is_empty else cell
                 for cell, is_empty in zip(cells, empty, strict=True)]
    else:
        empty = [False] * len(cells)
    joined = ''.join(cells)
    try:
        if '_' in joined or not joined.isascii():
            raise ValueError('float() would take 1_000 and digits of other scripts')
        values = np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        row = next(row for row, cell in enumerate(cells) if not _is_number(cell))
        raise _wrong(source, lines[row], name, 'a number', repr(cells[row][:80])) from None
    bad = np.flatnonzero(~np.isfinite(values) & ~np.array(empty))
    if bad.size:
        raise _wrong(source, lines[bad[0]], name, 'a finite number', repr(cells[bad[0]][:80]),
                     'leave out the row of a ball that was not measured')
    return _whole(values, cells, name, lines, source) if name in _INTEGERS else values


def _whole(values, cells, name, lines, source):
    bad = np.flatnonzero((values != np.floor(values)) | (np.abs(values) > 2**53))
    if bad.size:
        raise _wrong(source, lines[bad[0]], name, 'a whole number', repr(cells[bad[0]][:80]))
    return values.astype(np.int64)


def _is_number(cell):
    try:
        float(cell)
    except ValueError:
        return False
    return '_' not in cell and cell.isascii()


def _positive(heading, key, source, digits=0):
    """Return a number of the heading, its decimal point moved left by `digits`; None if absent."""
    if key not in heading:
        return None
    text, line = heading[key]
    value = float(text) if _is_number(text) else np.nan
    if not (np.isfinite(value) and value > 0):
        raise _wrong(source, line, '', f'{key}: a positive number', repr(text[:80]))
    return float(Decimal(text).scaleb(-digits))


def _balls(heading, source):
    value = _positive(heading, 'balls', source)
    if value is None or value == int(value):
        return None if value is None else int(value)
    raise _wrong(source, heading['balls'][1], '', 'balls: a whole number',
                 repr(heading['balls'][0]))


def _session(heading, source, rows):
    """Return the session of each row, (N,): `pauses_before: 74, 110` names the first rows after a pause."""
    text, line = heading.get('pauses_before', ('', 0))
    session = np.ones(rows, dtype=np.int64)
    for cell in filter(None, map(str.strip, text.split(','))):
        if not (cell.isascii() and cell.isdigit() and len(cell) < 10 and 2 <= int(cell) <= rows):
            raise _wrong(source, line, '', f'pauses_before: numbers of rows in 2..{rows}, separated by commas',
                         repr(cell[:80]))
        session[int(cell) - 1:] += 1
    return session


def _yes(heading, key, source):
    text, line = heading.get(key, ('no', 0))
    if text not in ('yes', 'no'):
        raise _wrong(source, line, '', f'{key}: yes or no', repr(text[:80]))
    return text == 'yes'

# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a ball-centre table, also as a spreadsheet saves it, to columns of numbers."""

import csv
import difflib
import re
from collections.abc import Callable, Collection, Sequence
from decimal import Decimal
from typing import TypeVar

import numpy as np

from rosette_ros.core.axes import rotation_of, unit_axis
from rosette_ros.core.errors import InvalidData, plain
from rosette_ros.core.geometry import Floats, Ints

SCHEMA = 'rosette-ball-centres/1'
COLUMNS = ('seq', 'table_position', 'ball', 'cmm_position', 'table_angle_deg', 'x_mm', 'y_mm', 'z_mm', 'time_s',
           'temperature_C', 'approach')
"""Columns of the table in the order of writing; any order is read."""
WAY_COLUMNS = ('table_travel_deg', 'cmm_sense_x', 'cmm_sense_y', 'cmm_sense_z')
"""Written only where the rows do not tell, of the axes of the CMM that go to and fro."""

_OPTIONAL = frozenset(('cmm_position', 'temperature_C', 'approach', *WAY_COLUMNS))
_INTEGERS = frozenset(('seq', 'table_position', 'ball', 'cmm_position', 'approach'))
_EMPTY = {'temperature_C': 'nan', 'approach': '0'}  # what an empty cell means
LEAVE_OUT = 'leave out the row of a ball that was not measured'
_KEYS = ('schema', 'radius_mm', 'repeatability_um', 'repeatability_dof', 'repeatability_axes_um', 'run_id', 'balls',
         'repeated_balls', 'pauses_before', 'frame', 'table_axis', 'table_x', 'simulated', 'note', 'plate',
         'table_positions', 'table_offset_deg')
SEPARATORS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}
_PLACE = ('x_mm', 'y_mm', 'z_mm')
Row = tuple[int, list[str]]
"""Line and cells of a row."""
_TEMPLATE = '`rosette plan --csv-template` makes an empty table'
_Value = TypeVar('_Value')


def meant(key: str, known: Collection[str]) -> str:
    """Return the known key that a misspelt one means, '' where it is another program's, or a remark."""
    return next(iter(difflib.get_close_matches(key, known, 1, 0.75)), '')


def _wrong(source: str, line: int, column: str, wanted: str, got: object, advice: str = '') -> InvalidData:
    place = f'{source}: line {line}' + (f': column {column}' if column else '')
    return InvalidData(f'{place}: wanted {wanted}, got {got}' + (f'; {advice}' if advice else ''))


def _lines(data: bytes, source: str) -> list[str]:
    if not data.strip():
        raise InvalidData(f'{source}: is empty; wanted a table of ball centres, {SCHEMA}')
    if b'\0' in data:
        raise InvalidData(f'{source}: is a binary file, or text in UTF-16; wanted a table of ball centres as text, '
                          f'{SCHEMA}; save the table as CSV, UTF-8')
    try:
        return re.split('\r\n|\r|\n', data.decode('utf-8-sig'))
    except UnicodeDecodeError as error:
        line = data[:error.start].count(b'\n') + 1
        raise InvalidData(f'{source}: line {line}: wanted text in UTF-8, got the byte 0x{data[error.start]:02x}; save '
                          'the table as UTF-8') from error


def _read_sheet(lines: Sequence[str], source: str) -> tuple[list[str], list[Row], str]:
    """Return the lines above the names of the columns; the names and the rows; in words how they were read.

    Decimal commas become points, rows without coordinates are left out. Raises InvalidData where quotes stay open, or
    it is not clear which sign is that of decimals."""
    at = next((at for at, line in enumerate(lines) if line.strip(',;\t ') and not line.startswith(('#', '"#'))), None)
    if at is None:
        return list(lines), [], ''
    separator = next((one for one in SEPARATORS if one in lines[at]), ',')
    names = [name.strip() for name in _cells(lines[at].rstrip(separator + ' '), separator, at + 1, source)]
    numbers = [row for row, name in enumerate(names) if name in (*COLUMNS, *WAY_COLUMNS)]
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
        raise _wrong(source, line, '', 'one decimal sign in the table', f'{cell!r}, and {point!r} in line {other}',
                     'save it with a point or a comma everywhere, and no sign between thousands')
    if ',' in first and not is_place:
        line, cell = first[',']
        raise _wrong(source, line, '', 'numbers with a decimal point', f'{cell!r}, and no coordinate that shows '
                     'whether the comma stands for decimals or thousands', 'write it without')
    words = f'{SEPARATORS[separator]} between cells' * (separator != ',') + ' and decimal commas' * (',' in first)
    heading = [_heading_line(text, separator, line, source) for line, text in enumerate(lines[:at], 1)]
    return heading, rows, f'the table was read with {words}' if words else ''


def _cells(text: str, separator: str, line: int, source: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), []) if '"' in text else text.split(separator)
    except csv.Error as error:
        raise _wrong(source, line, '', 'cells with closed quotes', error) from error


def _heading_line(text: str, separator: str, at: int, source: str) -> str:
    """Return a line above the names without padding, quotes, and the decimal comma of a number."""
    line = (_cells(text, separator, at, source)[0] if text.startswith('"') else text).rstrip(separator + ' ')
    key, _, value = line.partition(':')
    whole, comma, rest = value.strip().partition(',')
    is_number = separator != ',' and comma and whole.isdigit() and rest.isdigit() and key[-3:] in ('_mm', '_um', 'dof')
    return f'{key}: {whole}.{rest}' if is_number else line


class _Heading:
    """The `# key: value` lines of a table: (value, line) by key. Keys of other programs and remarks are skipped."""

    def __init__(self, lines: list[str], source: str) -> None:
        """Take the lines above the names of the columns; raises InvalidData where schema or radius are missing."""
        self._source = source
        self._values: dict[str, tuple[str, int]] = {}
        for line, text in enumerate(lines, 1):
            key, colon, value = (part.strip() for part in text[1:].partition(':'))
            if key in self._values and key != 'note':
                raise _wrong(source, line, '', f'{key} once', f'it again (first in line {self._values[key][1]})',
                             'remove one of them')
            if key in _KEYS:
                self._values[key] = (value, line)
            elif colon and (near := meant(key, _KEYS)):  # it would be ignored
                raise _wrong(source, line, '', f'the key {near}', repr(text[:80]), 'correct it')
        wanted = f'"# schema: {SCHEMA}" in the first lines'
        if 'schema' not in self._values:
            raise InvalidData(f'{source}: wanted {wanted}, got none; {_TEMPLATE}')
        if self._values['schema'][0] != SCHEMA:
            raise _wrong(source, self._values['schema'][1], '', wanted, repr(self._values['schema'][0]))
        if not {'radius_mm', 'plate'} & {*self._values}:
            raise InvalidData(f'{source}: wanted "# radius_mm: ...", the nominal radius of the circle of ball centres, '
                              'in the first lines, got none')

    def value(self, key: str, wanted: str, convert: Callable[[str], _Value], absent: _Value) -> _Value:
        """Return a value as `convert` makes it of its text; its KeyError or ValueError refuses it."""
        if key not in self._values:
            return absent
        text, line = self._values[key]
        try:
            return convert(text)
        except (KeyError, ValueError) as error:
            raise _wrong(self._source, line, '', f'{key}: {wanted}', repr(text[:80])) from error

    def positive(self, key: str, digits: int = 0) -> float | None:
        """Return a number, its decimal point moved left by `digits`; None if absent."""
        value = self.value(key, 'a positive number', _positive, None)
        return None if value is None else float(value.scaleb(-digits))

    def rotation(self) -> Floats | None:
        """Return the rotation of the table frame in the machine frame, None where nothing says it."""
        axis, x = (self.value(key, f'3 numbers that are not all 0, the direction of {what} in the machine', _direction,
                              None) for key, what in (('table_axis', 'the table axis'), ('table_x', 'ball 1')))
        if axis is None:
            if x is not None:
                raise _wrong(self._source, self._values['table_x'][1], '', 'table_axis beside table_x', 'table_x alone')
            return None
        try:
            return rotation_of(axis, x)
        except InvalidData as error:
            raise InvalidData(f'{self._source}: line {self._values["table_x"][1]}: table_x: {error}; correct it, or '
                              'leave it out where ball 1 is at azimuth 0') from error

    def session(self, rows: int) -> Ints:
        """Return the session of each row, (N,): `pauses_before: 74, 110` names the first rows after a pause."""
        def sessions(text: str) -> Ints:
            session = np.ones(rows, dtype=np.int64)
            for cell in filter(None, map(str.strip, text.split(','))):
                if not (cell.isascii() and cell.isdigit() and len(cell) < 10 and 2 <= int(cell) <= rows):
                    raise ValueError
                session[int(cell) - 1:] += 1
            return session

        return self.value('pauses_before', f'numbers of rows in 2..{rows}, separated by commas', sessions, sessions(''))


class CsvTable:
    """A table as it was written, N rows.

    columns: array (N,) by column name, units as in the name; centre: (N, 3), mm; angle_cells: the texts of
    table_angle_deg; lines: line of each row; radius, repeatability: m; balls: as the heading says, or None; session:
    (N,) 1 and one more from each row of `pauses_before` on; in_machine: whether the coordinates are in the machine
    frame; rotation: as of Run; plate, positions: the plate file, '' where the pitch is equal, and how many steps a turn
    of the table has, or None; table_offset: table angle of table position 1, rad; notes: how the table was read, in
    words."""

    def __init__(self, data: bytes, source: str) -> None:
        above, sheet, self.notes = _read_sheet(_lines(data, source), source)
        heading = _Heading(above, source)
        if not sheet:
            raise InvalidData(f'{source}: wanted a line with the names of the columns ({",".join(COLUMNS)}), got none')
        (line, names), *rows = sheet
        _check_names(names, source, line)
        _check_rows(rows, len(names), source)
        self.lines = [line for line, _ in rows]
        cells = dict(zip(names, zip(*(row for _, row in rows), strict=True), strict=True))
        self.source, self.angle_cells = source, cells['table_angle_deg']
        self.columns = {name: _numbers(cells[name], name, self.lines, source)
                        for name in names if name in (*COLUMNS, *WAY_COLUMNS)}
        self.table_position, self.ball = (self.columns[name].astype(np.int64) for name in ('table_position', 'ball'))
        self.centre: Floats = np.stack([self.columns[f'{axis}_mm'] for axis in 'xyz'], axis=-1)
        self.radius = heading.positive('radius_mm', 3) or 0.0
        self.repeatability = heading.positive('repeatability_um', 6)
        self.repeatability_dof = heading.positive('repeatability_dof')
        self.repeatability_axes = heading.value(
            'repeatability_axes_um', '3 positive numbers, along x, y and z', _of_axes, None)
        self.run_id = plain(heading.value('run_id', 'a name', str, ''))
        self.balls = heading.value('balls', 'a whole number', _whole, None)
        self.repeats, self.simulated = (heading.value(key, 'yes or no', {'yes': True, 'no': False}.__getitem__, False)
                                        for key in ('repeated_balls', 'simulated'))
        self.in_machine = heading.value(
            'frame', 'table or machine', {'table': False, 'machine': True}.__getitem__, False)
        self.rotation = heading.rotation()
        self.session = heading.session(len(rows))
        self.plate = heading.value('plate', 'a file', str, '')
        self.positions = heading.value('table_positions', 'a whole number', _whole, None)
        self.table_offset = heading.value('table_offset_deg', 'an angle in degrees', _angle, 0.0)

    def wrong(self, row: int | np.integer, column: str, wanted: str, got: object, advice: str = '') -> InvalidData:
        """Return the InvalidData for one cell."""
        return _wrong(self.source, self.lines[int(row)], column, wanted, got, advice)


def _positive(text: str) -> Decimal:
    if not _is_number(text) or not 0 < float(text) < np.inf:
        raise ValueError
    return Decimal(text)


def _of_axes(text: str) -> tuple[float, float, float] | None:
    x, y, z = (float(_positive(cell).scaleb(-6)) for cell in re.split(r'[\s,;]+', text))
    return x, y, z


def _direction(text: str) -> Floats:
    cells = re.split(r'[\s,;]+', text)
    if not all(map(_is_number, cells)):
        raise ValueError
    try:
        return unit_axis([float(cell) for cell in cells])
    except InvalidData as error:
        raise ValueError from error


def _whole(text: str) -> int | None:
    value = _positive(text)
    if value != int(value):
        raise ValueError
    return int(value)


def _angle(text: str) -> float:
    """Return an angle in degrees as radians, to the picoradian."""
    value = float(text)
    if not abs(value) <= 360:
        raise ValueError
    return round(float(np.deg2rad(value)), 12)


def _check_names(names: list[str], source: str, line: int) -> None:
    if missing := [name for name in COLUMNS if name not in names and name not in _OPTIONAL]:
        columns = f'the column{"s" * (len(missing) > 1)} {", ".join(missing)}'
        raise _wrong(source, line, '', columns, ','.join(names)[:200], _TEMPLATE)
    for name in names:
        if name not in (*COLUMNS, *WAY_COLUMNS) and (near := meant(name, COLUMNS)):  # it would be ignored
            raise _wrong(source, line, '', f'the column {near}', repr(name), 'rename it')
        if names.count(name) > 1:
            raise _wrong(source, line, name, 'it once', f'{names.count(name)} of them')


def _check_rows(rows: Sequence[Row], width: int, source: str) -> None:
    if not rows:
        raise InvalidData(f'{source}: wanted rows of ball centres, got none')
    for line, row in rows:
        if len(row) != width:
            if row[0].startswith('#'):
                raise _wrong(source, line, '', 'a reading', repr(','.join(row)[:80]),
                             'lines with # stand above the names of the columns')
            advice = 'write decimals with a point, not a comma' if len(row) > width else 'is the row cut off?'
            raise _wrong(source, line, '', f'{width} cells', len(row), advice)


def _numbers(cells: Sequence[str], name: str, lines: list[int], source: str) -> Floats | Ints:
    empty = np.array([name in _EMPTY and not cell.strip() for cell in cells])
    texts = [_EMPTY[name] if is_empty else cell for cell, is_empty in zip(cells, empty)] if empty.any() else cells
    joined = ''.join(texts)
    try:
        if '_' in joined or not joined.isascii():
            raise ValueError('float() would take 1_000 and digits of other scripts')
        values = np.fromiter(map(float, texts), float, len(texts))
    except ValueError:
        at = next(at for at, cell in enumerate(texts) if not _is_number(cell))
        advice = '' if cells[at].strip() else LEAVE_OUT
        raise _wrong(source, lines[at], name, 'a number', repr(cells[at][:80]), advice) from None
    for row in np.flatnonzero(~np.isfinite(values) & ~empty).tolist():
        raise _wrong(source, lines[row], name, 'a finite number', repr(cells[row][:80]),
                     'leave the cell empty where it is not known' if name in _EMPTY else LEAVE_OUT)
    if name not in _INTEGERS:
        return values
    for row in np.flatnonzero((values != np.floor(values)) | (np.abs(values) > 2**53)).tolist():
        raise _wrong(source, lines[row], name, 'a whole number', repr(cells[row][:80]))
    return values.astype(np.int64)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return '_' not in cell and cell.isascii()

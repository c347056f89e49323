# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a ball-centre table, also as people and spreadsheets write it, to columns of numbers.

Lines above the names of the columns, the separator and the decimal sign are found here; cells and numbers are read by
pyarrow.csv. What was taken otherwise than as rosette writes it is a note in words."""

import csv
import difflib
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from decimal import Decimal
from typing import Any, TypeVar

import numpy as np

from rosette_ros.core.axes import rotation_of, unit_axis
from rosette_ros.core.errors import InvalidData, plain
from rosette_ros.core.geometry import Floats, Ints
from rosette_ros.core.records import Bools, resolution_of

SCHEMA = 'rosette-ball-centres/1'
COLUMNS = ('seq', 'table_position', 'ball', 'cmm_position', 'table_angle_deg', 'x_mm', 'y_mm', 'z_mm', 'time_s',
           'temperature_C', 'approach')
"""Columns of the table in the order of writing; any order is read."""
WAY_COLUMNS = ('table_travel_deg', 'cmm_sense_x', 'cmm_sense_y', 'cmm_sense_z')
"""Written only where the rows do not tell, of the axes of the CMM that go to and fro."""
LENGTHS = {'mm': 1.0, 'cm': 10.0, 'm': 1e3, 'um': 1e-3, 'inch': 25.4}
"""Units of lengths in names of columns and in radius_..., in mm."""

_SAME = {'in': 'inch', 'inches': 'inch', 'sec': 's', 'µm': 'um', 'μm': 'um', 'degc': 'c', 'grad': 'deg'}
_TIMES = {'s': 1.0, 'ms': 1e-3, 'min': 60.0, 'h': 3600.0}
_UNITS = {'x': ('x_mm', LENGTHS), 'y': ('y_mm', LENGTHS), 'z': ('z_mm', LENGTHS), 'time': ('time_s', _TIMES),
          'table_angle': ('table_angle_deg', {'deg': 1.0}), 'temperature': ('temperature_C', {'c': 1.0})}
"""Quantities that may be given without a unit, which is then the first one, or in others."""
_PLACE = ('x_mm', 'y_mm', 'z_mm')
_REQUIRED = ('table_position', 'ball', *_PLACE)
_ABSENT = {'seq': 'the rows are taken in measuring order',
           'table_angle_deg': 'the table angles are taken as the nominal ones',
           'time_s': 'the readings are counted instead of seconds, and effects in time are per reading'}
"""What is taken where a column is missing, or all of its cells are empty."""
_INTEGERS = frozenset(('seq', 'table_position', 'ball', 'cmm_position', 'approach'))
_EMPTY = {'temperature_C': np.nan, 'approach': 0.0}  # what an empty cell means
LEAVE_OUT = 'leave out the row of a ball that was not measured'
_TEXTS = ('schema', 'run_id', 'note', 'plate', 'frame', 'pauses_before')
_KEYS = (*_TEXTS, 'radius_mm', 'repeatability_um', 'repeatability_dof', 'repeatability_axes_um', 'balls',
         'repeated_balls', 'table_axis', 'table_x', 'simulated', 'table_positions', 'table_offset_deg')
SEPARATORS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}
_SEP = re.compile(r'"?sep=([,;|:\t])"?[,;\s]*')
_CLOCK = re.compile(r'\d[.\s-]*[^\W\d_]{3}|\d:\d|\d[-/.]\d+[-/.]\d')
_HEADS = 1000
"""The names of the columns stand in one of so many lines."""
Row = tuple[int, str]
"""Line and text of a row."""
_TEMPLATE = ('`rosette plan --balls 12 --radius-mm 182.5 --order diagonal --csv-template` prints an empty table for '
             'such a plate')
_Value = TypeVar('_Value')


def meant(key: str, known: Collection[str]) -> str:
    """Return the known key that a misspelt one means, '' where it is another program's, or a remark."""
    return next(iter(difflib.get_close_matches(key, known, 1, 0.75)), '')


def _wrong(source: str, line: int, column: str, wanted: str, got: object, advice: str = '') -> InvalidData:
    place = f'{source}: line {line}' + (f': column {column}' if column else '')
    return InvalidData(f'{place}: wanted {wanted}, got {got}' + (f'; {advice}' if advice else ''))


def _column(name: str) -> tuple[str, float]:
    """Return which column a name means, '' if none, and the factor to its unit."""
    words = re.sub(r'[\W_]+', '_', name.strip().casefold()).strip('_')
    known = next((one for one in (*COLUMNS, *WAY_COLUMNS) if one.casefold() == words), '')
    stem, _, unit = words.rpartition('_')
    if known or words in _UNITS:
        return known or _UNITS[words][0], 1.0
    column, units = _UNITS.get(stem, ('', {}))
    factor = units.get(_SAME.get(unit, unit))
    return (column, factor) if factor else ('', 1.0)


def _heads(lines: Sequence[str], separators: str) -> Iterator[tuple[int, str]]:
    """Yield what seem to be the names of columns: the line from 0, and the separator."""
    for at, line in enumerate(lines[:_HEADS]):
        known = {one: sum(bool(_column(name)[0]) for name in line.replace('"', '').lstrip('# ').split(one))
                 for one in separators if one in line}
        if max(known.values(), default=0) > 2:
            yield at, max(known, key=known.__getitem__)


class _Sheet:
    """The lines of a table: `above` the names of its columns, the names, and the rows that are not empty.

    columns: which cell of a row, from 0, and factor to the unit, by column; notes: how it was read."""

    def __init__(self, data: bytes, source: str) -> None:
        """Find the names and how cells are separated; raises InvalidData where it is no text or quotes stay open."""
        self.source, self.notes = source, list[str]()
        lines = self._lines(data)
        given = _SEP.fullmatch(lines[0])
        at, self.separator = next(_heads(lines, given[1] if given else ''.join(SEPARATORS)), (None, ','))
        is_known = at is not None
        if at is None:
            at = next((at for at, line in enumerate(lines) if line.strip(',;\t ') and not line.startswith(
                ('#', '"#', 'sep='))), len(lines))
            self.separator = next((one for one in SEPARATORS if one in ''.join(lines[at:at + 1])), ',')
        elif len(self.cells(at + 1, lines[at])) == 1:  # a spreadsheet took each line for one cell
            lines = [''.join(self.cells(line, text)[:1]) for line, text in enumerate(lines, 1)]
            self.notes.append('each line was one quoted cell')
        ends = self.separator + ' '
        self.above = [(line, [cell.strip() for cell in self.cells(line, text.rstrip(ends))]
                       if self.separator != ',' or text.startswith('"') else [text.rstrip(ends)])
                      for line, text in enumerate(lines[given is not None:at], 1 + (given is not None))]
        self.line, self.columns = at + 1, dict[str, tuple[int, float]]()
        head = ''.join(lines[at:at + 1]).rstrip(ends)
        self.names = [name.strip() for name in self.cells(self.line, head.lstrip('# ') if is_known else head)]
        self.rows = [(line, self._fitted(line, text)) for line, text in enumerate(lines[at + 1:], at + 2)
                     if text.strip('",;\t ')]

    def _lines(self, data: bytes) -> list[str]:
        if not data.strip():
            raise InvalidData(f'{self.source}: is empty; wanted a table of ball centres, {SCHEMA}')
        if b'\0' in data:
            raise InvalidData(f'{self.source}: is a binary file, or text in UTF-16; wanted a table of ball centres as '
                              f'text, {SCHEMA}; save the table as CSV, UTF-8')
        try:
            text = data.decode('utf-8-sig')
        except UnicodeDecodeError:
            text = data.decode('cp1252', 'replace')
            self.notes.append('the text is not UTF-8 and was read as Windows-1252')
        return re.split('\r\n|\r|\n', text)

    def cells(self, line: int, text: str) -> list[str]:
        """Return the cells of a line."""
        try:
            return (next(csv.reader([text], delimiter=self.separator, strict=True), []) if '"' in text
                    else text.split(self.separator))
        except csv.Error as error:
            raise _wrong(self.source, line, '', 'cells with closed quotes', error) from error

    def _fitted(self, line: int, text: str) -> str:
        """Return a row without the separators that a spreadsheet appends."""
        count = len(self.cells(line, text)) if '"' in text else text.count(self.separator) + 1
        return text.removesuffix(self.separator * (count - len(self.names)))

    def table(self) -> tuple[list[int], dict[str, tuple[Floats, Bools]], list[str]]:
        """Return the lines of the rows with coordinates, their columns and which cells are empty, the cells of angles.

        Raises InvalidData where columns are missing or stand twice, or cells are no numbers."""
        self._find_columns()
        texts = self._read((*_PLACE, 'table_angle_deg'), 'string', '.')
        comma = self.separator != ',' and any(
            ',' in cell for name in _PLACE for cell in texts[name].to_pylist() if cell)
        if self.separator != ',':
            name = SEPARATORS.get(self.separator, repr(self.separator))
            self.notes.insert(0, f'the table was read with {name} between cells{" and decimal commas" * comma}')
        columns = {name: (values.to_numpy(zero_copy_only=False), _is_empty(values)) for name, values in self._read(
            self.columns, 'float64', ',' if comma else '.').items()}
        is_row = ~np.all([columns[name][1] for name in _PLACE], axis=0)
        columns = {name: (values[is_row], empty[is_row]) for name, (values, empty) in columns.items()}
        angles = [cell.replace(',', '.') for cell, is_one in zip(texts['table_angle_deg'].to_pylist(), is_row)
                  if is_one and cell] if 'table_angle_deg' in texts else []
        if not is_row.any():
            raise InvalidData(f'{self.source}: wanted rows of ball centres, got none')
        return [line for (line, _), is_one in zip(self.rows, is_row) if is_one], columns, angles

    def _find_columns(self) -> None:
        taken = []
        if not any(self.names):
            raise InvalidData(f'{self.source}: wanted a line with the names of the columns ({",".join(COLUMNS)}), got '
                              'none')
        for at, name in enumerate(self.names):
            column, factor = _column(name)
            if column in self.columns:
                raise _wrong(self.source, self.line, column, 'it once', f'it again as {name!r:.80}')
            if column:
                self.columns[column] = at, factor
                taken += [f'{name!r:.80}{f" times {factor:g}" * (factor != 1)} as {column}'] * (name != column)
            elif near := meant(name, COLUMNS):  # it would be ignored
                raise _wrong(self.source, self.line, '', f'the column {near}', f'{name!r:.80}', 'rename it')
        if missing := [name for name in _REQUIRED if name not in self.columns]:
            raise _wrong(self.source, self.line, '', f'the column{"s" * (len(missing) > 1)} {", ".join(missing)}',
                         ','.join(self.names)[:200], _TEMPLATE)
        if taken:
            self.notes.append(f'columns were taken so: {", ".join(taken)}')
        if not self.rows:
            raise InvalidData(f'{self.source}: wanted rows of ball centres, got none')

    def _read(self, wanted: Collection[str], kind: str, decimal: str) -> dict[str, Any]:
        """Return columns, as one kind of pyarrow's."""
        import pyarrow as pa  # a log does without
        import pyarrow.csv as arrow_csv

        refused, text = list[Any](), '\n'.join(text for _, text in self.rows).replace('−', '-').encode()
        names = {column: str(at) for column, (at, _) in self.columns.items() if column in wanted}

        def refuse(row: Any) -> str:
            refused.append(row)
            return 'error'

        try:
            found = arrow_csv.read_csv(
                pa.py_buffer(text), arrow_csv.ReadOptions(
                    use_threads=False, block_size=len(text) + 1, column_names=list(map(str, range(len(self.names))))),
                arrow_csv.ParseOptions(delimiter=self.separator, ignore_empty_lines=False,
                                       invalid_row_handler=refuse),
                arrow_csv.ConvertOptions(
                    include_columns=list(names.values()),
                    column_types=dict.fromkeys(names.values(), pa.type_for_alias(kind)),
                    decimal_point=decimal, strings_can_be_null=True, null_values=[' ' * count for count in range(9)]))
        except pa.ArrowInvalid as error:
            raise self._refusal(str(error), refused, decimal) from None
        return {column: found[name].combine_chunks() for column, name in names.items()}

    def _refusal(self, error: str, refused: Sequence[Any], decimal: str) -> InvalidData:
        if refused:
            line, text = self.rows[refused[0].number - 1]
            if text.startswith(('#', '"#')):
                return _wrong(self.source, line, '', 'a reading', f'{text!r:.80}',
                              'lines with # stand above the names of the columns')
            is_long = refused[0].actual_columns > len(self.names)
            return _wrong(self.source, line, '', f'{len(self.names)} cells', refused[0].actual_columns,
                          'write decimals with a point, not a comma' if is_long else 'is the row cut off?')
        found = re.search(r"column #(\d+): Row #(\d+): .* invalid value '(.*)'", error, re.DOTALL)
        if not found:
            return InvalidData(f'{self.source}: wanted a table of ball centres, got: {" ".join(error.split())}')
        cell, other = found[3], ',' if decimal == '.' else '.'
        advice = (LEAVE_OUT if not cell.strip() else
                  f'the coordinates have decimal {"points" if other == "," else "commas"}; write all numbers so, and '
                  'no sign between thousands' if other in cell and self.separator != ',' else
                  'it looks like a date or a time of day, which spreadsheets make of numbers; give a number'
                  if _CLOCK.search(cell) else '')
        return _wrong(self.source, self.rows[int(found[2]) - 1][0], _column(self.names[int(found[1])])[0], 'a number',
                      f'{cell!r:.80}', advice)


def _is_empty(values: Any) -> Bools:
    """Return which of the values of pyarrow's are missing, (N,): asked itself, it would load much more."""
    seen = values.buffers()[0]  # a bit for each
    bits = np.ones(len(values), np.uint8) if seen is None else np.unpackbits(
        np.frombuffer(seen, np.uint8), count=values.offset + len(values), bitorder='little')[values.offset:]
    return np.equal(bits, 0)


class _Heading:
    """The `# key: value` lines of a table: (value, line) by key. Keys of other programs and remarks are skipped."""

    def __init__(self, sheet: _Sheet) -> None:
        """Take the lines above the names of the columns; raises InvalidData where schema or radius are missing."""
        self._source = source = sheet.source
        self._values: dict[str, tuple[str, int]] = {}
        self.factor = 1.0
        titles = []
        for line, cells in sheet.above:
            text, *others = cells
            key, colon, first = (part.strip() for part in text.lstrip('# ').partition(':'))
            values = [value for value in (first, *others) if value]
            key = self._length(key, sheet.notes)
            if key in self._values and key != 'note':
                raise _wrong(source, line, '', f'{key} once', f'it again (first in line {self._values[key][1]})',
                             'remove one of them')
            if key in _KEYS:
                if sheet.separator != ',' and key not in _TEXTS:
                    values = [re.sub(r'^([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)$', r'\1.\2', value) for value in values]
                self._values[key] = (', '.join(values), line)
            elif text.startswith('#'):
                if colon and (near := meant(key, _KEYS)):  # it would be ignored
                    raise _wrong(source, line, '', f'the key {near}', f'{text!r:.80}', 'correct it')
            elif text:
                titles.append(text)
        if titles:
            sheet.notes.append(f'passed over above the names of the columns: {"; ".join(titles)[:200]!r}')
        wanted = f'"# schema: {SCHEMA}" in the first lines'
        if 'schema' not in self._values:
            raise InvalidData(f'{source}: wanted {wanted}, got none; add that line; {_TEMPLATE}')
        if self._values['schema'][0] != SCHEMA:
            raise _wrong(source, self._values['schema'][1], '', wanted, repr(self._values['schema'][0]))
        if not {'radius_mm', 'plate'} & {*self._values}:
            raise InvalidData(f'{source}: wanted "# radius_mm: ...", the nominal radius of the circle of ball centres, '
                              'in the first lines, got none')

    def _length(self, key: str, notes: list[str]) -> str:
        """Return the key radius_mm in place of radius_ in another unit."""
        stem, _, unit = key.rpartition('_')
        factor = LENGTHS.get(_SAME.get(unit, unit)) if stem == 'radius' else None
        if factor is None or key == 'radius_mm':
            return key
        self.factor = factor
        notes.append(f'{key} times {factor:g} as radius_mm')
        return 'radius_mm'

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

    columns: array (N,) by column name, units as in the name, without those of which nothing is given; centre: (N, 3),
    mm; angle_cells: the texts of table_angle_deg; lines: line of each row; radius, repeatability: m; step: to which the
    coordinates are rounded, m, 0 where they are not; balls: as the heading says, or None; session: (N,) 1 and one more
    from each row of `pauses_before` on; in_machine: whether the coordinates are in the machine frame; rotation: as of
    Run; plate, positions: the plate file, '' where the pitch is equal, and how many steps a turn of the table has, or
    None; table_offset: table angle of table position 1, rad; notes: how the table was read, in words."""

    def __init__(self, data: bytes, source: str) -> None:
        sheet = _Sheet(data, source)
        heading, self.source, self.notes = _Heading(sheet), source, sheet.notes
        self.lines, columns, self.angle_cells = sheet.table()
        made = {name: self._numbers(name, values, empty) for name, (values, empty) in columns.items()
                if name in _REQUIRED or not empty.all()}
        written: Floats = np.stack([made[name] for name in _PLACE], axis=-1)
        self.columns = {name: values if factor == 1 else values * factor for name, values in made.items()
                        if (factor := sheet.columns[name][1])}
        self.centre: Floats = np.stack([self.columns[name] for name in _PLACE], axis=-1)
        self.step = resolution_of(written / 1e3) * sheet.columns['x_mm'][1]
        self.table_position, self.ball = (self.columns[name].astype(np.int64) for name in ('table_position', 'ball'))
        if absent := [f'{name} ({words})' for name, words in _ABSENT.items() if name not in self.columns]:
            self.notes.append(f'not in the table: {", ".join(absent)}')
        self.radius = heading.factor * (heading.positive('radius_mm', 3) or 0.0)
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
        self.session = heading.session(len(self.lines))
        self.plate = heading.value('plate', 'a file', str, '')
        self.positions = heading.value('table_positions', 'a whole number', _whole, None)
        self.table_offset = heading.value('table_offset_deg', 'an angle in degrees', _angle, 0.0)

    def _numbers(self, name: str, values: Floats, empty: Bools) -> Floats | Ints:
        """Return a column as an array (N,); raises InvalidData where a cell is empty, infinite or no whole number."""
        found: Floats = np.where(empty, _EMPTY.get(name, np.inf), values)
        for row in np.flatnonzero(~np.isfinite(found) & ~(empty & (name in _EMPTY))):
            raise self.wrong(row, name, 'a number' if empty[row] else 'a finite number', '\'\'' if empty[row] else
                             found[row], 'leave the cell empty where it is not known' if name in _EMPTY else LEAVE_OUT)
        if name not in _INTEGERS:
            return found
        for row in np.flatnonzero((found != np.floor(found)) | (np.abs(found) > 2**53)):
            raise self.wrong(row, name, 'a whole number', f'{found[row]:g}')
        return found.astype(np.int64)

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


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return '_' not in cell and cell.isascii()

# SPDX-License-Identifier: Apache-2.0
"""From the bytes of a ball-centre table, also as people and spreadsheets write it, to columns of numbers.

Lines above the names of the columns, the separator and the decimal sign are found here. What was taken otherwise than
as rosette writes it is a note in words."""

import contextlib
import re
from collections.abc import Collection, Iterable, Iterator, Sequence

import numpy as np

from rosette_ros.core.run.errors import InvalidData, counted, plain
from rosette_ros.core.run.geometry import Floats, Ints
from rosette_ros.core.run.records import Bools, steps_of
from rosette_ros.io.column_map import ALIASES, ColumnMap, column_map, option_words, proposed
from rosette_ros.io.csv_cells import cells_of
from rosette_ros.io.foreign.foreign_table import ForeignTable
from rosette_ros.io.foreign.formats import read_foreign
from rosette_ros.io.table_heading import (
    KEYS,
    LENGTHS,
    SAME,
    SCHEMA,
    Heading,
    angle_of,
    key_of,
    meant,
    moment_of,
    of_axes,
    whole_number,
    wrong,
)
from rosette_ros.io.table_times import moments

COLUMNS = ('seq', 'table_position', 'ball', 'cmm_position', 'table_angle_deg', 'x_mm', 'y_mm', 'z_mm', 'time_s',
           'temperature_C', 'approach')
"""Columns of the table in the order of writing; any order is read."""
WAY_COLUMNS = ('table_travel_deg', 'cmm_sense_x', 'cmm_sense_y', 'cmm_sense_z')
"""Written only where the rows do not tell, of the axes of the CMM that go to and fro."""
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
SEPARATORS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}
_SEP = re.compile(r'"?sep=([,;|:\t])"?[,;\s]*')
_CLOCK = re.compile(r'\d[.\s-]*[^\W\d_]{3}|\d:\d|\d[-/.]\d+[-/.]\d')
_MINUS = dict.fromkeys(map(ord, '−–‒﹣－'), '-')
"""Signs that programs and people write for a minus."""
_OTHER_DECIMAL = str.maketrans('.,', ',.')
_HEADS, MOST_COLUMNS = 1000, 10_000
"""The names of the columns stand in one of so many lines; so many there may be."""
Row = tuple[int, str]
"""Line and text of a row."""
_TEMPLATE = ('`rosette plan --balls 12 --radius-mm 182.5 --order diagonal --csv-template` prints an empty table for '
             'such a plate')


def _column(name: str) -> tuple[str, float]:
    """Return which column a name means, '' if none, and the factor to its unit."""
    words = re.sub(r'[\W_]+', '_', name.strip().casefold()).strip('_')
    known = next((one for one in (*COLUMNS, *WAY_COLUMNS) if one.casefold() == words), '')
    stem, _, unit = words.rpartition('_')
    if known or words in _UNITS:
        return known or _UNITS[words][0], 1.0
    column, units = _UNITS.get(stem, ('', {}))
    factor = units.get(SAME.get(unit, unit))
    return (column, factor) if factor else ('', 1.0)


def _heads(lines: Sequence[str], separators: str, names: Collection[str] = ()) -> Iterator[tuple[int, str]]:
    """Yield what seem to be the names of columns: the line from 0, and the separator.

    names: of columns that have to be there, as a map of the columns gives them."""
    for at, line in enumerate(lines[:_HEADS]):
        known = {one: sum(name in cells if names else bool(_column(name)[0]) for name in names or cells)
                 for one in separators if one in line
                 if (cells := [cell.strip() for cell in line.replace('"', '').lstrip('# ').split(one)])}
        if max(known.values(), default=0) >= (len(names) or 3):
            yield at, max(known, key=known.__getitem__)


class _Sheet:
    """The lines of a table: `above` the names of its columns, the names, and the rows that are not empty.

    columns: which cell of a row, from 0, and factor to the unit, by column; notes: how it was read."""

    def __init__(self, data: bytes, source: str, columns: ColumnMap | None = None) -> None:
        """Find the names and how cells are separated, and arrange them by a map of the columns.

        Raises InvalidData where it is no text, quotes stay open, or columns of the map are missing."""
        self.source, self.notes = source, list[str]()
        self.begun: float | None = None
        whole = self._text(data)
        self.format, foreign = read_foreign(whole, source) or (
            '', ForeignTable(list(enumerate(re.split('\r\n|\r|\n', whole), 1)), {}))
        numbered, self.unit, self.known = foreign.lines, foreign.unit, foreign.columns
        numbers, lines = (list(one) for one in zip(*numbered))
        for line, text in zip(numbers, lines[:_HEADS]):
            if (most := max(map(text.count, SEPARATORS))) >= MOST_COLUMNS:
                raise wrong(source, line, '', f'at most {MOST_COLUMNS} columns', most + 1, 'save those that are needed')
        given = _SEP.fullmatch(lines[0][:100])
        separators = given[1] if given else ''.join(SEPARATORS)
        seen = next(_heads(lines, separators, columns.names), None) if columns else None
        at, self.separator = seen or next(_heads(lines, separators), (None, ','))
        is_known = at is not None
        if at is None:
            at = next((at for at, line in enumerate(lines) if line.strip(',;\t ') and not line.startswith(
                ('#', '"#', 'sep='))), len(lines))
            self.separator = next((one for one in SEPARATORS if one in ''.join(lines[at:at + 1])), ',')
        elif len(self.cells(numbers[at], lines[at])) == 1:  # a spreadsheet took each line for one cell
            lines = [''.join(self.cells(line, text)[:1]) for line, text in zip(numbers, lines)]
            self.notes.append('each line was one quoted cell')
        ends = self.separator + ' '
        self.above = [(line, [cell.strip() for cell in self.cells(line, text.rstrip(ends))]
                       if self.separator != ',' or text.startswith('"') else [text.rstrip(ends)])
                      for line, text in zip(numbers[given is not None:at], lines[given is not None:at])]
        self.line, self.columns = numbers[min(at, len(numbers) - 1)], dict[str, tuple[int, float]]()
        head = ''.join(lines[at:at + 1]).rstrip(ends)
        self.names = [name.strip() for name in self.cells(self.line, head.lstrip('# ') if is_known else head)]
        self.rows = [(line, self._fitted(line, text)) for line, text in zip(numbers[at + 1:], lines[at + 1:])
                     if text.strip('",;\t ')]
        self.is_mapped = columns is not None
        if columns:
            self._arrange(columns)

    def _arrange(self, columns: ColumnMap) -> None:
        """Put the columns of the table, and entries of its heading, in place of what a map says of those of a file."""
        if missing := sorted(columns.names - {*self.names}):
            raise wrong(self.source, self.line, '', f'the column{"s" * (len(missing) > 1)} {", ".join(missing)} of '
                         f'{option_words()}', ','.join(self.names)[:200])
        found, other = columns.readings(self.names, [(line, self.cells(line, text)) for line, text in self.rows],
                                        self.source)
        if other:
            self.notes.append(f'passed over: {counted(other, "row")} of other features')
        keys = list(dict.fromkeys(key for _, texts in found for key in texts))
        if 'angle' in keys and 'table' not in keys and 'table_position' not in keys:
            with contextlib.suppress(ValueError, ArithmeticError, KeyError):  # what is no number is refused below
                steps = int(columns.heading.get('balls', '0')) or max(int(texts['ball']) for _, texts in found)
                for _, texts in found:
                    texts['table'] = str(round(float(texts['angle'].replace(',', '.')) * steps / 360) % steps + 1)
            keys.append('table')
        self.notes.append(f'columns were taken by a map: {columns.words()}')
        names = [f'{key}_{self.unit}' if self.unit and key in 'xyz' else ALIASES.get(key, key) for key in keys]
        self.names = [_UNITS.get(name, (name,))[0] for name in names]
        self.notes += self._read_with('')
        self.separator = '\t'
        self.rows = [(line, '\t'.join(texts.get(key, '') for key in keys)) for line, texts in found]
        stated = {'schema': SCHEMA, **columns.heading}
        replaced = {*stated, *(key[:7] for key in stated if key.startswith('radius_'))}
        self.above = [*((line, cells) for line, cells in self.above
                        if cells[0].startswith('#') and not {key_of(cells[0]), key_of(cells[0])[:7]} & replaced),
                      *((self.line, [f'# {key}: {value}']) for key, value in stated.items())]

    def _text(self, data: bytes) -> str:
        if not data.strip():
            raise InvalidData(f'{self.source}: is empty; expected a table of ball centres, {SCHEMA}')
        if b'\0' in data:
            raise InvalidData(f'{self.source}: is a binary file, or text in UTF-16; expected a table of ball centres '
                              'as '
                              f'text, {SCHEMA}; save the table as CSV, UTF-8')
        try:
            text = data.decode('utf-8-sig')
        except UnicodeDecodeError:
            text = data.decode('cp1252', 'replace')
            self.notes.append('the text is not UTF-8 and was read as Windows-1252')
        return text

    def cells(self, line: int, text: str) -> list[str]:
        """Return the cells of a line."""
        return cells_of(text, self.source, line, self.separator)

    def _fitted(self, line: int, text: str) -> str:
        """Return a row without the separators that a spreadsheet appends."""
        count = len(self.cells(line, text)) if '"' in text else text.count(self.separator) + 1
        return text.removesuffix(self.separator * (count - len(self.names)))

    def table(self) -> tuple[list[int], dict[str, tuple[Floats, Bools]], list[str]]:
        """Return the lines of the rows with coordinates, their columns and which cells are empty, the cells of angles.

        Raises InvalidData where columns are missing or stand twice, or cells are no numbers."""
        texts = self._texts()
        comma = self.separator != ',' and any(',' in cell for name in _PLACE for cell in texts[name])
        if not self.is_mapped:
            self.notes[:0] = self._read_with(' and decimal commas' * comma)
        times = moments(texts['time_s'], self._no_time) if 'time_s' in texts else None
        columns = {name: (self._numbers(name, cells, ',' if comma else '.'), np.array([not cell for cell in cells]))
                   for name, cells in texts.items() if name != 'time_s' or times is None}
        if times is not None:
            since = np.array([np.nan if one is None else one for one in times.since_first], dtype=float)
            columns['time_s'], self.columns['time_s'] = (since, np.isnan(since)), (self.columns['time_s'][0], 1.0)
            self.notes.append(f'{times.words} taken as seconds since the first')
            self.begun = times.begun
        is_row = ~np.all([columns[name][1] for name in _PLACE], axis=0)
        columns = {name: (values[is_row], empty[is_row]) for name, (values, empty) in columns.items()}
        angles = [cell.replace(',', '.') for cell, is_one in zip(texts['table_angle_deg'], is_row)
                  if is_one and cell] if 'table_angle_deg' in texts else []
        if not is_row.any():
            raise InvalidData(f'{self.source}: expected rows of ball centres, found none')
        return [line for (line, _), is_one in zip(self.rows, is_row) if is_one], columns, angles

    def _read_with(self, commas: str) -> list[str]:
        """Return the format, or what was between the cells, in words, where it was no comma."""
        if self.format:
            return [f'the file was read as {self.format}']
        name = SEPARATORS.get(self.separator, repr(self.separator))
        return [f'the table was read with {name} between cells{commas}'] * (self.separator != ',')

    def find_columns(self) -> list[str]:
        """Find which column is which and return those that are missing; raises InvalidData where one stands twice."""
        taken = []
        if not any(self.names):
            raise InvalidData(f'{self.source}: expected a line with the names of the columns ({",".join(COLUMNS)}), '
                              'found '
                              'none')
        for at, name in enumerate(self.names):
            column, factor = _column(name)
            if column in self.columns:
                raise wrong(self.source, self.line, column, 'it once', f'it again as {name!r:.80}')
            if column:
                self.columns[column] = at, factor
                taken += [f'{name!r:.80}{f" times {factor:g}" * (factor != 1)} as {column}'] * (name != column)
            elif near := meant(name, COLUMNS):  # it would be ignored
                raise wrong(self.source, self.line, '', f'the column {near}', f'{name!r:.80}', 'rename it')
        if taken:
            self.notes.append(f'columns were read as follows: {", ".join(taken)}')
        return [name for name in _REQUIRED if name not in self.columns]

    def proposal(self, stated: Iterable[str]) -> ColumnMap:
        """Return what the columns seem to be; stated: keys of the heading."""
        return proposed(self.names, [(line, self.cells(line, text)) for line, text in self.rows], stated, self.known)

    def _texts(self) -> dict[str, list[str]]:
        """Return the cells of each column, '' where nothing stands; raises InvalidData where a row has more or fewer.
        """
        rows = [self.cells(line, text.translate(_MINUS)) for line, text in self.rows]
        uneven = next((at for at, cells in enumerate(rows) if len(cells) != len(self.names)), None)
        if uneven is not None:
            raise self._uneven(*self.rows[uneven], len(rows[uneven]))
        return {name: [cells[at].strip() for cells in rows] for name, (at, _) in self.columns.items()}

    def _no_time(self, row: int, wanted: str, advice: str) -> InvalidData:
        line, text = self.rows[row]
        return wrong(self.source, line, 'time_s', wanted, repr(self.cells(line, text)[self.columns['time_s'][0]][:80]),
                     advice)

    def _uneven(self, line: int, text: str, count: int) -> InvalidData:
        if text.startswith(('#', '"#')):
            return wrong(self.source, line, '', 'a reading', f'{text!r:.80}',
                         'lines with # stand above the names of the columns')
        return wrong(self.source, line, '', f'{len(self.names)} cells', count,
                     'write decimals with a point, not a comma' if count > len(self.names) else 'is the row cut off?')

    def _numbers(self, column: str, cells: Sequence[str], decimal: str) -> Floats:
        """Return the numbers of a column, (N,), NaN where nothing stands; raises InvalidData where a cell is none."""
        texts = [cell.translate(_OTHER_DECIMAL) for cell in cells] if decimal == ',' else cells
        every = ''.join(texts)
        if every.isascii() and '_' not in every:  # which only Python takes for numbers
            with contextlib.suppress(ValueError):
                return np.array([float(text) if text else np.nan for text in texts])
        row = next(row for row, text in enumerate(texts) if text and not _is_number(text))
        raise self._no_number(row, column, cells[row], decimal)

    def _no_number(self, row: int, column: str, cell: str, decimal: str) -> InvalidData:
        other = ',' if decimal == '.' else '.'
        advice = (f'the coordinates have decimal {"points" if other == "," else "commas"}; write all numbers so, and '
                  'no sign between thousands' if other in cell and self.separator != ',' else
                  'it looks like a date or a time of day, which spreadsheets make of numbers; give a number'
                  if _CLOCK.search(cell) else '')
        if cell.startswith('='):
            advice = 'it is a formula of a spreadsheet; save the values'
        return wrong(self.source, self.rows[row][0], column, 'a number', f'{cell!r:.80}', advice)


def _is_number(text: str) -> bool:
    with contextlib.suppress(ValueError):
        float(text)
        return text.isascii() and '_' not in text
    return False


def _check_all(sheet: _Sheet, heading: Heading, columns_of: ColumnMap | None) -> None:
    """Raise InvalidData that says all that is missing of heading and columns at once, and how to state it."""
    missing, source = sheet.find_columns(), sheet.source
    heads = f'{" and ".join(heading.lacks)} in the first lines' if heading.lacks else ''
    names = f'the column{"s" * (len(missing) > 1)} {", ".join(missing)}' if missing else ''
    made = sheet.proposal(heading.keys) if missing and sheet.rows and not columns_of else None
    if made and (made.is_enough or 'schema' not in heading.keys):
        advice = made.advice(source)
    else:
        advice = (f'say all of it in {option_words()}' if columns_of else
                  f'{"add that line; " * (not missing)}{_TEMPLATE}')
    if missing and not heads:
        raise wrong(source, sheet.line, '', names, ','.join(sheet.names)[:200], advice)
    if heads:
        got = ','.join(sheet.names)[:200] if missing else 'none'
        raise InvalidData(f'{source}: expected {heads}{", " * bool(names)}{names}, found {got}; {advice}')
    if not sheet.rows:
        raise InvalidData(f'{source}: expected rows of ball centres, found none')


def proposal_for(data: bytes, source: str) -> ColumnMap | None:
    """Return what the columns of a foreign table seem to be, None for a table of ball centres."""
    sheet = _Sheet(data, source)
    heading = Heading(sheet.above, source, sheet.separator, sheet.notes)
    return sheet.proposal(heading.keys) if [*heading.lacks, *sheet.find_columns()] else None


def read_columns(given: str | dict[str, str] | None) -> ColumnMap | None:
    """Return the map of `--columns`, or of its entries; None where it is not given. Raises InvalidData."""
    return None if given is None else column_map(given, [*COLUMNS, *WAY_COLUMNS], KEYS)


class CsvTable:
    """A table as it was written, N rows.

    columns: array (N,) by column name, units as in the name, without those of which nothing is given; centre: (N, 3),
    mm; angle_cells: the texts of table_angle_deg; lines: line of each row; radius, repeatability: m; steps: (N, 3) to
    which the coordinates are rounded, m, 0 where they are not; begun: as of Run; balls: as the heading says, or None;
    session: (N,) 1 and one more from each row of `pauses_before` on; in_machine: whether the coordinates are in the
    machine frame; rotation: as of Run; plate, positions: the plate file, '' where the pitch is equal, and how many
    steps a turn of the table has, or None; table_offset: table angle of table position 1, rad; notes: how the table was
    read, in words."""

    def __init__(self, data: bytes, source: str, columns_of: ColumnMap | None = None) -> None:
        sheet = _Sheet(data, source, columns_of)
        heading = Heading(sheet.above, source, sheet.separator, sheet.notes)
        self.source, self.notes = source, sheet.notes
        _check_all(sheet, heading, columns_of)
        self.lines, columns, self.angle_cells = sheet.table()
        stated = heading.value('first_reading_at', 'a date such as 2026-11-27T08:00:34Z', moment_of, None)
        self.begun = stated if sheet.begun is None else sheet.begun
        made = {name: self._numbers(name, values, empty) for name, (values, empty) in columns.items()
                if name in _REQUIRED or not empty.all()}
        written: Floats = np.stack([made[name] for name in _PLACE], axis=-1)
        self.columns = {name: values if factor == 1 else values * factor for name, values in made.items()
                        if (factor := sheet.columns[name][1])}
        self.centre: Floats = np.stack([self.columns[name] for name in _PLACE], axis=-1)
        self.steps: Floats = steps_of(written / 1e3) * sheet.columns['x_mm'][1]
        self.table_position, self.ball = (self.columns[name].astype(np.int64) for name in ('table_position', 'ball'))
        if absent := [f'{name} ({words})' for name, words in _ABSENT.items() if name not in self.columns]:
            self.notes.append(f'not in the table: {", ".join(absent)}')
        self.radius = heading.factor * (heading.positive('radius_mm', 3) or 0.0)
        self.repeatability = heading.positive('repeatability_um', 6)
        self.repeatability_dof = heading.positive('repeatability_dof')
        self.repeatability_axes = heading.value(
            'repeatability_axes_um', '3 positive numbers, along x, y and z', of_axes, None)
        self.run_id = plain(heading.value('run_id', 'a name', str, ''))
        self.balls = heading.value('balls', 'a whole number', whole_number, None)
        self.repeats, self.simulated = (heading.value(key, 'yes or no', {'yes': True, 'no': False}.__getitem__, False)
                                        for key in ('repeated_balls', 'simulated'))
        self.in_machine = heading.value(
            'frame', 'table or machine', {'table': False, 'machine': True}.__getitem__, False)
        self.rotation = heading.rotation()
        self.session = heading.session(len(self.lines))
        self.plate = heading.value('plate', 'a file', str, '')
        self.positions = heading.value('table_positions', 'a whole number', whole_number, None)
        self.table_offset = heading.value('table_offset_deg', 'an angle in degrees', angle_of, 0.0)

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
        return wrong(self.source, self.lines[int(row)], column, wanted, got, advice)

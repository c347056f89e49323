# SPDX-License-Identifier: Apache-2.0
"""The `# key: value` lines above the columns of a ball-centre table, and their values."""

import difflib
import re
from collections.abc import Callable, Collection, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from typing import TypeVar

import numpy as np

from rosette_ros.core.run.axes import rotation_of, unit_axis
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Floats, Ints
from rosette_ros.core.run.number_limits import is_size

SCHEMA = 'rosette-ball-centres/1'
LENGTHS = {'mm': 1.0, 'cm': 10.0, 'm': 1e3, 'um': 1e-3, 'inch': 25.4}
"""Units of lengths in names of columns and in radius_..., in mm."""
SAME = {'in': 'inch', 'inches': 'inch', 'sec': 's', 'µm': 'um', 'μm': 'um', 'degc': 'c', 'grad': 'deg'}
FIRST_DATE = 946684800.0
"""Times before it, s since the epoch, that of 2000-01-01, are counts from 0 and no dates."""
_TEXTS = ('schema', 'run_id', 'note', 'plate', 'frame', 'pauses_before', 'first_reading_at')
KEYS = (*_TEXTS, 'radius_mm', 'repeatability_um', 'repeatability_dof', 'repeatability_axes_um', 'balls',
         'repeated_balls', 'table_axis', 'table_x', 'simulated', 'table_positions', 'table_offset_deg')
_Value = TypeVar('_Value')


def meant(key: str, known: Collection[str]) -> str:
    """Return the known key that a misspelt one means, '' where it is another program's, or a remark."""
    return next(iter(difflib.get_close_matches(key, known, 1, 0.75)), '')


def wrong(source: str, line: int, column: str, wanted: str, got: object, advice: str = '') -> InvalidData:
    """Return the InvalidData for a line or one of its cells."""
    place = f'{source}: line {line}' + (f': column {column}' if column else '')
    return InvalidData(f'{place}: expected {wanted}, found {got}' + (f'; {advice}' if advice else ''))


def key_of(text: str) -> str:
    """Return the key of a `# key: value` line."""
    return text.lstrip('# ').partition(':')[0].strip()


class Heading:
    """The `# key: value` lines of a table: (value, line) by key. Keys of other programs and remarks are skipped."""

    def __init__(self, above: Sequence[tuple[int, Sequence[str]]], source: str, separator: str,
                 notes: list[str]) -> None:
        """Take the lines above the names of the columns; lacks: what is missing of schema and radius, in words."""
        self._source = source
        self._values: dict[str, tuple[str, int]] = {}
        self.factor = 1.0
        titles = []
        for line, cells in above:
            text, *others = cells
            key, colon, first = key_of(text), ':' in text, text.partition(':')[2].strip()
            values = [value for value in (first, *others) if value]
            key = self._length(key, notes)
            if key in self._values and key != 'note':
                raise wrong(source, line, '', f'{key} once', f'it again (first in line {self._values[key][1]})',
                             'remove one of them')
            if key in KEYS:
                if separator != ',' and key not in _TEXTS:
                    values = [re.sub(r'^([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)$', r'\1.\2', value) for value in values]
                self._values[key] = (', '.join(values), line)
            elif text.startswith('#'):
                if colon and (near := meant(key, KEYS)):  # it would be ignored
                    raise wrong(source, line, '', f'the key {near}', f'{text!r:.80}', 'correct it')
            elif text:
                titles.append(text)
        if titles:
            notes.append(f'passed over above the names of the columns: {"; ".join(titles)[:200]!r}')
        schema = f'"# schema: {SCHEMA}"'
        if self._values.get('schema', (SCHEMA,))[0] != SCHEMA:
            raise wrong(source, self._values['schema'][1], '', f'{schema} in the first lines',
                         repr(self._values['schema'][0]))
        self.keys = {*self._values}
        self.lacks = [schema] * ('schema' not in self.keys) + [
            '"# radius_mm: ...", the nominal radius of the circle of ball centres,'] * (
            not {'radius_mm', 'plate'} & self.keys)

    def _length(self, key: str, notes: list[str]) -> str:
        """Return the key radius_mm in place of radius_ in another unit."""
        stem, _, unit = key.rpartition('_')
        factor = LENGTHS.get(SAME.get(unit, unit)) if stem == 'radius' else None
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
            raise wrong(self._source, line, '', f'{key}: {wanted}', repr(text[:80])) from error

    def positive(self, key: str, digits: int = 0) -> float | None:
        """Return a number, its decimal point moved left by `digits`; None if absent."""
        value = self.value(key, 'a positive number', positive_number, None)
        return None if value is None else float(value.scaleb(-digits))

    def rotation(self) -> Floats | None:
        """Return the rotation of the table frame in the machine frame, None where nothing says it."""
        axis, x = (self.value(key, f'3 numbers that are not all 0, the direction of {what} in the machine', _direction,
                              None) for key, what in (('table_axis', 'the table axis'), ('table_x', 'ball 1')))
        if axis is None:
            if x is not None:
                raise wrong(self._source, self._values['table_x'][1], '', 'table_axis beside table_x', 'table_x alone')
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


def positive_number(text: str) -> Decimal:
    if not _is_number(text) or not is_size(float(text)):
        raise ValueError
    return Decimal(text)


def of_axes(text: str) -> tuple[float, float, float] | None:
    x, y, z = (float(positive_number(cell).scaleb(-6)) for cell in re.split(r'[\s,;]+', text))
    return x, y, z


def _direction(text: str) -> Floats:
    cells = re.split(r'[\s,;]+', text)
    if not all(map(_is_number, cells)):
        raise ValueError
    try:
        return unit_axis([float(cell) for cell in cells])
    except InvalidData as error:
        raise ValueError from error


def moment_of(text: str) -> float | None:
    """Return a date with time of day, UTC where no zone is stated, as s since the epoch."""
    moment = datetime.fromisoformat(text)
    seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if seconds < FIRST_DATE:
        raise ValueError
    return seconds


def moment_words(seconds: float) -> str:
    """Return a time, s since the epoch, as a date with time of day, to the microsecond."""
    return datetime.fromtimestamp(seconds, UTC).isoformat()


def whole_number(text: str) -> int | None:
    value = positive_number(text)
    if value != int(value):
        raise ValueError
    return int(value)


def angle_of(text: str) -> float:
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

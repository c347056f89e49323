# SPDX-License-Identifier: Apache-2.0
"""A measuring plan as a file, schema rosette-plan/1: an order as YAML, or its readings one by one as CSV."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.core.model.base_entries import refuse_undetermined
from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.geometry import TWO_PI, Floats, Ints, nominal_angles, wrap
from rosette_ros.core.run.number_limits import is_number
from rosette_ros.core.run.scheme import Scheme, order_name, places_in_use, plan
from rosette_ros.core.run.touches import TOUCHES
from rosette_ros.io.csv_cells import cells_of
from rosette_ros.io.safe_yaml import known_keys, of_schema, parse_yaml
from rosette_ros.io.table_heading import meant
from rosette_ros.io.text_file import read_limited

SCHEMA = 'rosette-plan/1'
MOST_BYTES, MOST_READINGS, MOST_BALLS = 16 << 20, 200_000, 1000
OWN_NAME = 'plan'
"""Name of a list of readings that states none."""
_HEAD = ('schema', 'balls', 'radius_mm', 'order', 'table_offset_deg')
_CHOICE = ('seed', 'turning', 'cmm_positions', 'balls_in_use', 'touches')
"""What an order may have besides."""
_COLUMNS = ('table_position', 'ball', 'approach', 'session', 'touches')
WAIT = 'wait_s'
"""The column of the waits, which only plans have that wait."""
LONGEST_WAIT = 86400
"""Of a reading, s."""
_IS_TABLE = re.compile(rb'^"?#\s*schema\s*:', re.MULTILINE)
_WHOLE, _REAL = re.compile(r'[+-]?[0-9]{1,18}'), re.compile(r'[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?')
_NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')


@dataclass(frozen=True, eq=False)
class MeasuringPlan:
    """A scheme on a plate; radius: of the circle of ball centres, m."""

    scheme: Scheme
    radius: float


def read_plan(path: str | Path) -> MeasuringPlan:
    """Return the plan of a file; raises InvalidPlan, naming file, key and row, where it cannot be measured."""
    return parse_plan(read_limited(path, 'a plan file', MOST_BYTES, InvalidPlan), str(path))


def parse_plan(data: bytes, source: str) -> MeasuringPlan:
    """Return the plan of a file's bytes; errors as of `read_plan`."""
    keys, columns = _table(data, source) if _IS_TABLE.search(data) else (parse_yaml(data, source, InvalidPlan), None)
    values = of_schema(keys, SCHEMA, source, InvalidPlan, 'a plan file')
    known_keys(values, _HEAD if columns is not None else (*_HEAD, *_CHOICE), f'{source}: key', InvalidPlan)
    n, radius = values.get('balls'), _number(values.get('radius_mm'), source, 'radius_mm')
    if type(n) is not int or not 3 <= n <= MOST_BALLS:
        raise InvalidPlan(f'{source}: balls: expected a whole number in 3..{MOST_BALLS}, found {n!r:.40}')
    if not 1 <= radius <= 1e4:
        raise InvalidPlan(f'{source}: radius_mm: expected a number in 1..10000, found {radius:g}')
    offset = _number(values.get('table_offset_deg', 0.0), source, 'table_offset_deg')
    order = str(values.get('order', OWN_NAME))
    scheme = _of_order(n, values, source) if columns is None else _of_rows(n, order, columns, source)
    try:
        scheme = scheme.shifted(offset)
    except InvalidPlan as error:
        raise InvalidPlan(f'{source}: {error}') from None
    refuse_undetermined(scheme, source)
    return MeasuringPlan(scheme, 1e-3 * radius)


def format_plan(made: MeasuringPlan) -> str:
    """Return a plan as the text of a file, reading by reading."""
    scheme = made.scheme
    head = {'schema': SCHEMA, 'balls': scheme.n, 'radius_mm': round(1e3 * made.radius, 9), 'order': scheme.order}
    if scheme.table_offset:
        head['table_offset_deg'] = round(float(np.rad2deg(scheme.table_offset)), 12)
    columns = {name: getattr(scheme, name).tolist() for name in _COLUMNS}
    if scheme.wait.any():
        columns[WAIT] = scheme.wait.round(3).tolist()
    rows = zip(*columns.values())
    return '\n'.join([*(f'# {name}: {value}' for name, value in head.items()), ','.join(columns),
                      *(','.join(map(str, row)) for row in rows), ''])


def _of_order(n: int, values: Mapping[str, Any], source: str) -> Scheme:
    """Return the scheme of an order."""
    if 'order' not in values:
        raise InvalidPlan(f'{source}: expected an order, or a table of readings with the columns table_position and '
                          'ball, found neither')
    seed, touches = (int(_wholes([values.get(name, 0)], source, name, 0, high)[0])
                     for name, high in (('seed', 2**53), ('touches', max(TOUCHES))))
    given = (values.get(name, '') for name in ('cmm_positions', 'balls_in_use'))
    texts = (', '.join(map(str, one)) if isinstance(one, list) else str(one) for one in given)
    try:
        scheme = plan(n, str(values['order']), seed, str(values.get('turning', 'forward')), *(
            places_in_use(text, n) for text in texts))
    except InvalidPlan as error:
        raise InvalidPlan(f'{source}: {error}') from None
    _checked_touches(np.array([touches]), source)
    return replace(scheme, touches=np.full(scheme.ball.size, touches))


def _of_rows(n: int, order: str, texts: Mapping[str, list[str]], source: str) -> Scheme:
    """Return the scheme of a table of readings."""
    known_keys(texts, (*_COLUMNS, WAIT), f'{source}: column', InvalidPlan)
    if missing := [name for name in _COLUMNS[:2] if name not in texts]:
        raise InvalidPlan(f'{source}: expected the columns table_position and ball, found none named {missing[0]}')
    if not _NAME.fullmatch(order):
        raise InvalidPlan(f'{source}: order: expected a name of at most 40 small letters, digits and "_", found '
                          f'{order!r:.60}')
    size = len(texts['ball'])
    if size > MOST_READINGS:
        raise InvalidPlan(f'{source}: too large: expected at most {MOST_READINGS} readings, found {size}')

    def column(name: str, low: int, high: int, default: int) -> Ints:
        return _wholes(list(map(_value, texts[name])) if name in texts else [default] * size, source, name, low, high)

    table, ball = column('table_position', 1, n, 0), column('ball', 1, n, 0)
    session = column('session', 1, size, 1)
    for row in np.flatnonzero(~np.isin(np.diff(session, prepend=1), (0, 1)))[:1]:
        raise InvalidPlan(f'{source}: row {row + 1}: session: expected 1 in the first row and one more after each '
                          'pause, '
                          f'found {session[row]}')
    touches = _checked_touches(column('touches', 0, 1000, 0), source)
    return Scheme(n, order_name(order), 0, table, ball, _senses(n, table, column('approach', -1, 1, 0)), touches,
                  session, wait=_waits(texts.get(WAIT, ['0'] * size), source))


def _waits(texts: list[str], source: str) -> Floats:
    """Return waits, (N,), s."""
    values = list(map(_value, texts))
    for row, value in enumerate(values, 1):
        if isinstance(value, str) or not 0 <= value <= LONGEST_WAIT:
            raise InvalidPlan(f'{source}: row {row}: {WAIT}: expected a number of seconds in 0..{LONGEST_WAIT}, found '
                              f'{value!r:.40}')
    return np.array(values, dtype=float)


def _senses(n: int, table_position: Ints, approach: Ints) -> Ints:
    """Return the sense of the last table move of each reading; where none is given (0), that of the shortest way."""
    step = wrap(np.diff(nominal_angles(n)[table_position - 1], prepend=0.0))
    step[0] = 0.0
    moved = np.abs(step) > 0.5 * TWO_PI / n
    shortest = np.where((step < 0) & (np.abs(step) < np.pi - 0.25 * TWO_PI / n), -1, 1)
    own = np.where(approach == 0, np.where(moved, shortest, 0), approach)
    last = np.maximum.accumulate(np.where(own != 0, np.arange(own.size), -1))
    return np.where(last >= 0, own[np.maximum(last, 0)], 1)


def _checked_touches(touches: Ints, source: str) -> Ints:
    for row in np.flatnonzero(~np.isin(touches, (0, *TOUCHES)))[:1]:
        where = f'row {row + 1}: ' if touches.size > 1 else ''
        raise InvalidPlan(f'{source}: {where}touches: expected one of {", ".join(map(str, TOUCHES))}, or 0 for '
                          f'as many as the CMM usually makes, found {touches[row]}')
    return touches


def _number(value: Any, source: str, name: str) -> float:
    if value is None:
        raise InvalidPlan(f'{source}: {name}: expected a number, but it is missing')
    if not is_number(value):
        raise InvalidPlan(f'{source}: {name}: expected a finite number, found {value!r:.40}')
    return float(value)


def _wholes(values: list[Any], source: str, name: str, low: int, high: int) -> Ints:
    """Return whole numbers low .. high, (N,)."""
    for row, one in enumerate(values, 1):
        if type(one) is not int or not low <= one <= high:
            where = f'row {row}: ' if len(values) > 1 else ''
            raise InvalidPlan(f'{source}: {where}{name}: expected a whole number in {low}..{high}, found {one!r:.40}')
    return np.array(values, dtype=np.int64)


def _table(data: bytes, source: str) -> tuple[dict[str, int | float | str], dict[str, list[str]]]:
    """Return the keys of the lines `# key: value` of a table, and its columns.

    Keys of other programs are skipped; raises InvalidPlan where one is given twice or misspelt: it would be ignored."""
    try:
        lines = [(number, line) for number, line in enumerate(data.decode('utf-8-sig').splitlines(), 1)
                 if line.strip(' \t,;')]
    except UnicodeDecodeError as error:
        raise InvalidPlan(f'{source}: expected UTF-8 text, found byte {data[error.start]:#04x}') from None
    notes = [line.strip('",; \t')[1:].partition(':') for _, line in lines if line.startswith(('#', '"#'))]
    keys = dict[str, int | float | str]()
    for key, text in ((key.strip(), text.strip()) for key, separator, text in notes if separator):
        if key in keys:
            raise InvalidPlan(f'{source}: expected the key {key} once, found it again: {text!r:.40}; remove one of '
                              'them')
        if key in _HEAD:
            keys[key] = _value(text)
        elif near := meant(key, _HEAD):
            raise InvalidPlan(f'{source}: expected the key {near}, found {key!r:.80}; correct it')
    head, *rows = [cells_of(line, source, number, kind=InvalidPlan) for number, line in lines
                   if not line.startswith(('#', '"#'))] or [[]]
    head = [name.strip() for name in head]
    for number, row in enumerate(rows, 1):
        if len(row) != len(head):
            raise InvalidPlan(f'{source}: row {number}: expected {len(head)} cells, {", ".join(head)}, found '
                              f'{len(row)}')
    if len({*head}) < len(head):
        raise InvalidPlan(f'{source}: expected each column once, found {", ".join(head)}')
    if not rows:
        raise InvalidPlan(f'{source}: expected rows below the columns {", ".join(_COLUMNS)}, found none')
    return keys, {name: list(column) for name, column in zip(head, zip(*rows))}


def _value(text: str) -> int | float | str:
    text = text.strip()
    return int(text) if _WHOLE.fullmatch(text) else float(text) if _REAL.fullmatch(text) else text

# SPDX-License-Identifier: Apache-2.0
"""A measuring plan as a file, schema rosette-plan/1: its readings one by one, CSV, YAML or JSON, or an order, YAML."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rosette_ros.core.errors import InvalidPlan
from rosette_ros.core.geometry import TWO_PI, Ints, nominal_angles, wrap
from rosette_ros.core.model.base_entries import refuse_undetermined
from rosette_ros.core.scheme import Scheme, cmm_position, places_in_use, plan
from rosette_ros.core.touches import TOUCHES
from rosette_ros.io.keyed_table import is_keyed_table, keyed_table
from rosette_ros.io.safe_yaml import is_finite, known_keys, of_schema, parse_yaml
from rosette_ros.io.text_file import read_limited

SCHEMA = 'rosette-plan/1'
MOST_BYTES, MOST_READINGS, MOST_BALLS = 16 << 20, 200_000, 1000
OWN_NAME = 'plan'
"""Name of an order that has none."""
_HEAD = ('balls', 'radius_mm', 'order', 'touches', 'table_offset_deg')
_ORDER = ('seed', 'turning', 'cmm_positions', 'balls_in_use')
_PLACES = ('table_position', 'table_angle_deg', 'ball', 'cmm_position', 'cmm_azimuth_deg')
_COLUMNS = (*_PLACES, 'approach', 'session', 'touches')
_WRITTEN = ('table_position', 'ball', 'cmm_position', 'approach', 'session', 'touches')
_TOLD = ('seq', 'x_mm', 'y_mm', 'z_mm', 'centre_m', 'table_angle_rad', 'travel', 'expected')
"""What `rosette plan` prints beside a plan: it follows from the plan and is not read."""
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
    given = _from_csv(data, source) if is_keyed_table(data) else parse_yaml(data, source, InvalidPlan)
    values = of_schema(given, SCHEMA, source, InvalidPlan, 'a plan file')
    if 'n' in values and 'radius_m' in values:  # as `rosette plan --json` prints it
        values = {'balls': values.pop('n'), 'radius_mm': _number(values.pop('radius_m'), source, 'radius_m') * 1e3,
                  **values}
    if 'table_offset_rad' in values:  # likewise
        radians = _number(values.pop('table_offset_rad'), source, 'table_offset_rad')
        values = {'table_offset_deg': float(np.rad2deg(radians)), **values}
    known = tuple(dict.fromkeys(('schema', *_HEAD, *_ORDER, *_COLUMNS)))
    known_keys((key for key in values if key not in _TOLD), known, f'{source}: key or column', InvalidPlan)
    n, radius = values.get('balls'), _number(values.get('radius_mm'), source, 'radius_mm')
    if type(n) is not int or not 3 <= n <= MOST_BALLS:
        raise InvalidPlan(f'{source}: balls: wanted a whole number in 3..{MOST_BALLS}, got {n!r:.40}')
    if not 1 <= radius <= 1e4:
        raise InvalidPlan(f'{source}: radius_mm: wanted a number in 1..10000, got {radius:g}')
    made = _of_rows if any(name in values for name in _PLACES) else _of_order
    offset = _number(values.get('table_offset_deg', 0.0), source, 'table_offset_deg')
    scheme = made(n, values, source)
    try:
        scheme = scheme.shifted(offset)
    except InvalidPlan as error:
        raise InvalidPlan(f'{source}: {error}') from None
    refuse_undetermined(scheme, source)
    return MeasuringPlan(scheme, 1e-3 * radius)


def format_plan(made: MeasuringPlan, as_yaml: bool = False) -> str:
    """Return a plan as the text of a file, reading by reading."""
    scheme = made.scheme
    head = {'schema': SCHEMA, 'balls': scheme.n, 'radius_mm': round(1e3 * made.radius, 9), 'order': scheme.order}
    if scheme.table_offset:
        head['table_offset_deg'] = round(float(np.rad2deg(scheme.table_offset)), 12)
    columns = {name: getattr(scheme, name) for name in _WRITTEN}
    if as_yaml:
        return yaml.dump({**head, **{name: values.tolist() for name, values in columns.items()}}, sort_keys=False,
                         width=120, default_flow_style=None, Dumper=getattr(yaml, 'CSafeDumper', yaml.SafeDumper))
    rows = zip(range(1, scheme.ball.size + 1), *(values.tolist() for values in columns.values()))
    return '\n'.join([*(f'# {name}: {value}' for name, value in head.items()), ','.join(('seq', *_WRITTEN)),
                      *(','.join(map(str, row)) for row in rows), ''])


def _of_order(n: int, values: Mapping[str, Any], source: str) -> Scheme:
    """Return the scheme of a file without readings, which names an order."""
    if 'order' not in values:
        raise InvalidPlan(f'{source}: wanted readings (table_position and ball, or their angles) or an order, got '
                          'neither')
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


def _of_rows(n: int, values: Mapping[str, Any], source: str) -> Scheme:
    """Return the scheme of a file that lists its readings."""
    if given := [name for name in _ORDER if values.get(name)]:
        if given != ['seed']:
            raise InvalidPlan(f'{source}: wanted readings or {given[-1]}, which chooses them, got both; leave out one')
    size = max(len(values[name]) if isinstance(values.get(name), list) else 1 for name in _PLACES)
    if size > MOST_READINGS:
        raise InvalidPlan(f'{source}: too large: wanted at most {MOST_READINGS} readings, got {size}')
    columns = {name: values[name] if isinstance(values[name], list) else [values[name]] * size
               for name in _COLUMNS if name in values}
    for name, one in columns.items():
        if len(one) != size:
            raise InvalidPlan(f'{source}: {name}: wanted a value for each of {size} readings, got {len(one)}')
    table, on = (_places(n, columns, source, values.get('table_offset_deg', 0.0), *names) for names in (
        ('table_position', 'table_angle_deg'), ('cmm_position', 'cmm_azimuth_deg')))
    ball = _wholes(columns['ball'], source, 'ball', 1, n) if 'ball' in columns else None
    pairs = _pairs(n, table, ball, on)
    if pairs is None:
        raise InvalidPlan(f'{source}: wanted two of table position, ball and CMM position of every reading (the third '
                          f'follows), got {", ".join(columns)}')
    table, ball = pairs
    position = cmm_position(n, table, ball)
    if on is not None and not np.array_equal(on, position):
        row = int(np.flatnonzero(on != position)[0])
        raise InvalidPlan(f'{source}: row {row + 1} contradicts itself: table position {table[row]} brings ball '
                          f'{ball[row]} to CMM position {position[row]}, got {on[row]}')
    session = _wholes(columns.get('session', [1] * size), source, 'session', 1, size)
    for row in np.flatnonzero(~np.isin(np.diff(session, prepend=1), (0, 1)))[:1]:
        raise InvalidPlan(f'{source}: row {row + 1}: session: wanted 1 in the first row and one more after each pause, '
                          f'got {session[row]}')
    approach = _wholes(columns.get('approach', [0] * size), source, 'approach', -1, 1)
    touches = _checked_touches(_wholes(columns.get('touches', [0] * size), source, 'touches', 0, 1000), source)
    order = str(values.get('order', OWN_NAME))
    if not _NAME.fullmatch(order):
        raise InvalidPlan(f'{source}: order: wanted a name of at most 40 small letters, digits and "_", got '
                          f'{order!r:.60}')
    return Scheme(n, order, int(_wholes([values.get('seed', 0)], source, 'seed', 0, 2**53)[0]), table, ball,
                  _senses(n, table, approach), touches, session)


def _places(n: int, columns: Mapping[str, Any], source: str, offset: float, name: str, angle: str) -> Ints | None:
    """Return positions 1..n from the column of their numbers, of their angles, or of both, which must agree.

    offset: angle of position 1, degrees.
    """
    numbers = _wholes(columns[name], source, name, 1, n) if name in columns else None
    if angle not in columns:
        return numbers
    degrees = np.array([_number(one, source, f'row {row}: {angle}') for row, one in enumerate(columns[angle], 1)])
    turns = (degrees - offset) * n / 360
    found = np.rint(turns).astype(int) % n + 1
    for row in np.flatnonzero(np.abs(turns - np.rint(turns)) > 1e-6 * n)[:1]:
        raise InvalidPlan(f'{source}: row {row + 1}: {angle}: wanted a multiple of 360°/{n} = {360 / n:.6g}°'
                          f'{f" from table_offset_deg {offset:g} on" * bool(offset)}, got {degrees[row]:.9g}')
    if numbers is not None and not np.array_equal(found, numbers):
        row = int(np.flatnonzero(found != numbers)[0])
        raise InvalidPlan(f'{source}: row {row + 1} contradicts itself: {name} {numbers[row]} and {angle} '
                          f'{degrees[row]:g}, which is position {found[row]}')
    return found


def _pairs(n: int, table: Ints | None, ball: Ints | None, on: Ints | None) -> tuple[Ints, Ints] | None:
    """Return table positions and balls from two of table position, ball and CMM position; None from fewer."""
    if table is not None and ball is not None:
        return table, ball
    if table is not None and on is not None:
        return table, (on - table) % n + 1
    return ((on - ball) % n + 1, ball) if ball is not None and on is not None else None


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
        raise InvalidPlan(f'{source}: {where}touches: wanted one of {", ".join(map(str, TOUCHES))}, or 0 for '
                          f'as many as the CMM usually makes, got {touches[row]}')
    return touches


def _number(value: Any, source: str, name: str) -> float:
    if value is None:
        raise InvalidPlan(f'{source}: {name}: wanted a number, but it is missing')
    if not is_finite(value):
        raise InvalidPlan(f'{source}: {name}: wanted a finite number, got {value!r:.40}')
    return float(value)


def _wholes(values: list[Any], source: str, name: str, low: int, high: int) -> Ints:
    """Return whole numbers low .. high, (N,)."""
    for row, one in enumerate(values, 1):
        if type(one) is not int or not low <= one <= high:
            where = f'row {row}: ' if len(values) > 1 else ''
            raise InvalidPlan(f'{source}: {where}{name}: wanted a whole number in {low}..{high}, got {one!r:.40}')
    return np.array(values, dtype=np.int64)


def _from_csv(data: bytes, source: str) -> dict[str, Any]:
    """Return what a table says, as the YAML form has it."""
    keys, columns = keyed_table(data, source, ('schema', *_HEAD, *_ORDER), InvalidPlan)
    return {**{name: _value(text) for name, text in keys.items()},
            **{name: list(map(_value, column)) for name, column in columns.items()}}


def _value(text: str) -> int | float | str:
    text = text.strip()
    return int(text) if _WHOLE.fullmatch(text) else float(text) if _REAL.fullmatch(text) else text

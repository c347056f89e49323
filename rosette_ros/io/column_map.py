# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs: what their columns are (schema rosette-columns/1), applied and proposed.

Names of features give numbers by a pattern, such as `Ball{ball}_T{table}`; a table with a row for each coordinate has
the columns `axis` (or `{axis}` in the pattern) and `value`. Further entries are those of the heading: radius_mm."""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import yaml

from rosette_ros.core.run.errors import InvalidData, unknown
from rosette_ros.core.run.typed_words import as_typed
from rosette_ros.io.safe_yaml import PlainDumper, of_schema, parse_yaml
from rosette_ros.io.text_file import read_limited

SCHEMA = 'rosette-columns/1'
MOST_BYTES = 1 << 16
ALIASES = {'table': 'table_position', 'angle': 'table_angle'}
"""Short names of columns."""
ALIASED = {name: short for short, name in ALIASES.items()}
SOURCES = ('name', 'axis', 'value', 'pattern')
"""What a map may name beside the columns of the table and keys of its heading."""
NUMBERS = {'ball': r'[0-9]{1,9}', 'table': r'[0-9]{1,9}', 'angle': r'[+-]?[0-9]{1,9}(?:[.,][0-9]{1,18})?',
           'axis': '[A-Za-z]{1,20}'}
"""What stands in braces in a pattern, and how it is written."""
LONGEST = 1000
"""Characters of a name that are looked at: of a feature, of a column."""
_AXES = ('x', 'y', 'z')
_CALLED = {
    'table': 'table|table position|table pos|tisch|tischposition|tischstellung|position|pos',
    'ball': 'ball|ball no|kugel|kugel nr|sphere no', 'angle': 'rotary|rotary angle|table angle|angle|winkel|drehwinkel',
    'time': 'time|zeit|timestamp|date|datum|date time|datum zeit|zeitpunkt|time s|zeit s|seconds|sekunden',
    'temperature': 'temperature|temp|temperatur',
    **{axis: f'{axis}|actual {axis}|{axis} actual|meas {axis}|{axis} meas|ist {axis}|{axis} ist' for axis in _AXES},
    'name': 'feature|feature name|featurename|name|id|element|merkmal|label|characteristic',
    'axis': 'axis|ax|achse', 'value': 'actual|meas|measured|ist|istwert|value|messwert'}
"""How programs and laboratories call a quantity, in small letters without units."""
_HINTS = {'ball': 'bks', 'table': 'tp', 'angle': 'arw'}
"""First letters of what stands before a number in the name of a feature: ball, Kugel, sphere; table, position ..."""
Cells = Sequence[tuple[int, Sequence[str]]]
"""Line and cells of each row."""


EXAMPLE = {'table': '...', 'ball': '...', 'x': '...', 'y': '...', 'z': '...', 'radius_mm': '182.5'}
"""What is asked of columns whose names say nothing."""


@dataclass(frozen=True)
class ColumnMap:
    """Which column of a file is what.

    columns: name in the file by quantity, a minus sign before it where it counts the other way; pattern: of the names
    of features, '' where there are none; heading: what the file does not state, by key of the heading.
    """

    columns: Mapping[str, str]
    pattern: str = ''
    heading: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """The names of columns that a file has to have; those of coordinates in rows are no columns."""
        return {name.removeprefix('-') for key, name in self.columns.items()
                if 'value' not in self.columns or key in SOURCES or key == 'time'}

    @property
    def is_enough(self) -> bool:
        """Whether ball, table position and coordinates follow from it."""
        known = {*(ALIASED.get(key, key) for key in self.columns), *re.findall(r'{(\w+)}', self.pattern)}
        return {'ball'} <= known and bool({'table', 'angle'} & known) and (
            {'axis', 'value'} <= known or {*_AXES} <= {key.partition('_')[0] for key in self.columns})

    @property
    def entries(self) -> dict[str, str]:
        """The map as a file holds it."""
        return {**self.columns, **({'pattern': self.pattern} if self.pattern else {}), **self.heading}

    def words(self) -> str:
        """Return the map as `--columns` takes it."""
        return ','.join(f'{key}={value}' for key, value in self.entries.items())

    def advice(self, source: str) -> str:
        """Return what to do with a table of another program, where this is what its columns seem to be."""
        given = self if self.is_enough else ColumnMap(EXAMPLE)
        return 'if these are ball centres' + as_typed(
            f', try: rosette import {shlex.quote(source)} --columns {shlex.quote(given.words())} --save map.yaml',
            f': columns={given.entries}')

    def readings(self, names: Sequence[str], rows: Cells, source: str) -> tuple[list[tuple[int, dict[str, str]]], int]:
        """Return line and text by quantity of each reading, and how many rows have names that do not fit the pattern.

        Raises InvalidData where none fits."""
        places = {key: names.index(name) for key, column in self.columns.items()
                  if (name := column.removeprefix('-')) in names}
        signs = {key for key, column in self.columns.items() if column.startswith('-')}
        labels = {name: axis for axis in _AXES for name in (axis, f'{axis}value')}
        labels |= {column.casefold(): key for key, column in self.columns.items() if key not in places}
        pattern, found, other, last, is_long = _compiled(self.pattern), list[tuple[int, dict[str, str]]](), 0, '', (
            'value' in places)
        for line, cells in rows:
            texts = {key: cells[at].strip() for key, at in places.items() if at < len(cells)}
            last = name = texts.pop('name', '') or last
            if (fits := pattern.fullmatch(name) if len(name) <= LONGEST else None) is None:
                other += 1
                continue
            texts |= fits.groupdict()
            if is_long:
                axis, value = texts.pop('axis', '').casefold(), texts.pop('value', '')
                if axis not in labels:
                    other += 1
                    continue
                if not found or labels[axis] in found[-1][1] or any(
                        found[-1][1].get(key, text) != text for key, text in texts.items() if key in NUMBERS):
                    found.append((line, texts))
                found[-1][1][labels[axis]] = value
            else:
                found.append((line, texts))
        for _, texts in found:
            for key in signs & texts.keys():
                texts[key] = texts[key].removeprefix('-') if texts[key].startswith('-') else f'-{texts[key]}'
        if rows and not found:
            raise InvalidData(f'{source}: line {rows[0][0]}: expected names such as {self.pattern!r}, found '
                              f'{last!r:.80}; '
                              '{ball}, {table}, {angle} and {axis} in the pattern stand for what changes, * for any '
                              'text')
        return found, other


def _compiled(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a pattern, whose numbers may have zeros in front and * is any text.

    What stands between two * is taken where it comes first, and never tried elsewhere again: a search that goes back
    would take longer than anybody waits for some names, and finds no other match."""
    first, *others = [''.join(
        f'(?P<{part[1:-1]}>{NUMBERS[part[1:-1]]})' if at % 2 and part[1:-1] in NUMBERS else re.escape(part)
        for at, part in enumerate(re.split(r'({\w+})', between))) for between in (pattern or '*').split('*')]
    between = ''.join(f'(?>.*?{one})' for one in others[:-1])
    return re.compile(f'{first}{between}{"".join(f".*?{last}" for last in others[-1:])}', re.IGNORECASE | re.DOTALL)


def option_words() -> str:
    """Return how the map is given where the user stands."""
    return as_typed('--columns', 'columns=')


def column_map(given: str | dict[str, str], columns: Iterable[str], heading: Iterable[str]) -> ColumnMap:
    """Return the map that is given by its entries, or as `--columns`: a file, or quantity=column,...

    columns, heading: keys of both. Raises InvalidData where it is none."""
    if isinstance(given, dict):
        entries, source = given, option_words().rstrip('=')
    elif '=' not in given:
        values = of_schema(parse_yaml(read_limited(given, 'a file of columns', MOST_BYTES), given, InvalidData), SCHEMA,
                           given, InvalidData, 'a file of rosette import FILE --columns ... --save')
        entries, source = {str(key): str(value) for key, value in values.items() if key != 'schema'}, given
    else:
        parts, source = [part.partition('=') for part in given.split(',')], option_words().rstrip('=')
        entries = {key.strip(): value.strip() for key, _, value in parts}
        if bad := next((''.join(part) for part in parts if not (part[0].strip() and part[2].strip())), ''):
            raise InvalidData(f'{source}: expected quantity=column,..., found {bad!r:.80}')
        if len(entries) < len(parts):
            raise InvalidData(f'{source}: expected each quantity once, found {given!r:.200}')
    known = {*_CALLED, *SOURCES, *columns, *heading}
    for key in entries:
        if key not in known and key.rpartition('_')[0] not in (*_AXES, 'time', 'radius'):
            raise InvalidData(f'{source}: {unknown(key, sorted(known))}')
    if len(pattern := entries.get('pattern', '')) > LONGEST:
        raise InvalidData(f'{source}: pattern: expected at most {LONGEST} characters, found {len(pattern)}')
    inside = re.findall(r'{([^{}]*)}', pattern)
    if wrong := [one for one in inside if one not in NUMBERS]:
        raise InvalidData(f'{source}: pattern: {unknown(wrong[0], sorted(NUMBERS))}')
    if twice := [one for one in NUMBERS if inside.count(one) > 1]:
        raise InvalidData(f'{source}: pattern: expected {{{twice[0]}}} once, found {pattern!r:.80}')
    stated = {key: value for key, value in entries.items() if key in heading or key.startswith('radius_')}
    return ColumnMap({key: value for key, value in entries.items() if key not in stated and key != 'pattern'},
                     pattern, stated)


def format_columns(columns: ColumnMap) -> str:
    """Return a map as the text of a file."""
    return str(yaml.dump({'schema': SCHEMA, **columns.entries}, Dumper=PlainDumper, sort_keys=False,
                         allow_unicode=True, width=120))


def proposed(names: Sequence[str], rows: Cells, stated: Iterable[str], known: Mapping[str, str]) -> ColumnMap:
    """Return what the columns of a table seem to be, from their names and the first name of a feature.

    stated: keys that its heading has; known: name of the column by quantity, where its format says it."""
    found = dict(known) or _called(names)
    for axis in _AXES:
        found |= {name.casefold(): name for name in names if re.fullmatch(f'{axis}_[a-z]+', name.casefold())
                  and axis not in found}
    if {'name', 'value'} <= found.keys() and 'axis' not in found:
        at = names.index(found['name'])
        own = _called([cells[at].strip() for _, cells in rows[:1000] if len(cells) > at])
        if {*_AXES} <= own.keys() and {'table', 'angle'} & own.keys():  # a row for each quantity, by its name
            found = {**{key: own[key] for key in ('table', 'ball', 'angle') if key in own}, **found}
            found['axis'] = found.pop('name')
    if {*_AXES} <= {key.partition('_')[0] for key in found}:
        found = {key: name for key, name in found.items() if key not in ('axis', 'value')}
    pattern = ''
    wanted = [key for key in ('ball', 'table', 'angle') if key not in found and not (
        key != 'ball' and {'table', 'angle'} & found.keys())]
    if not wanted and ('axis' in found or 'value' not in found):
        found.pop('name', None)
    elif 'name' in found and rows:
        at, has_axis = names.index(found['name']), 'value' in found and 'axis' not in found
        tried = [_pattern(cells[at].strip()[:LONGEST], wanted, has_axis) for _, cells in rows[:1000] if len(cells) > at]
        pattern = next((one for one in tried if ColumnMap(found, one).is_enough), tried[0])
    made = ColumnMap(found, pattern)
    heading = dict[str, str]()
    if made.is_enough and not {'radius_mm', 'plate'} & {*stated}:
        heading = _circle(made.readings(names, rows, '')[0])
    return ColumnMap(found, pattern, heading)


def _called(names: Sequence[str]) -> dict[str, str]:
    """Return the names by the quantity that they call."""
    plain = {re.sub(r'[\W_]+', ' ', re.sub(r'[\[(].*?[\])]', '', name[:LONGEST])).strip().casefold(): name
             for name in reversed(names)}
    return {key: plain[word] for key, words in _CALLED.items() for word in words.split('|') if word in plain}


def _pattern(name: str, wanted: Sequence[str], has_axis: bool) -> str:
    """Return the pattern of which a name seems to be: 'Ball12_T01' gives 'Ball{ball}_T{table}'."""
    axis = re.search(r'(?<![A-Za-z])[XYZ]$', name) if has_axis else None
    parts, open_ones = re.split(r'(\d+)', name[:axis.start()] if axis else name), list(wanted)
    for at in range(1, len(parts), 2):
        hint = (re.findall('[A-Za-z]+', parts[at - 1]) or [''])[-1][:1].casefold()
        key = next((one for one in open_ones if hint and hint in _HINTS[one]), None) or next(
            (one for one in open_ones if not hint or not any(hint in other for other in _HINTS.values())), None)
        parts[at] = f'{{{key}}}' if key else '*'
        open_ones = [one for one in open_ones if one != key and not (key in ('table', 'angle') and one != 'ball')]
    return ''.join(parts) + '{axis}' * bool(axis)


def _circle(found: Sequence[tuple[int, Mapping[str, str]]]) -> dict[str, str]:
    """Return the radius on which the readings lie, mm, to a tenth, and whether it is about another place than 0."""
    try:
        points = np.array([[float(next(text for key, text in texts.items() if key.partition('_')[0] == axis).replace(
            ',', '.')) for axis in _AXES] for _, texts in found])
    except (ValueError, StopIteration):
        return {}
    if not points.size or not np.abs(points).max() < 1e9 or not np.ptp(points, axis=0).any():
        return {}
    middle = points.mean(axis=0)
    radius = float(np.median(np.linalg.norm(points - middle, axis=1)))
    return {'radius_mm': f'{radius:.1f}', **({'frame': 'machine'} if np.linalg.norm(middle) > radius / 4 else {})}

# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs: what their columns are (schema rosette-columns/1), applied and proposed; K-fields and QIF.

Names of features give numbers by a pattern, such as `Ball{ball}_T{table}`; a table with a row for each coordinate has
the columns `axis` (or `{axis}` in the pattern) and `value`. Further entries are those of the heading: radius_mm.

Q-DAS K-fields (AQDEF) and QIF results become lines of a table with tabs between cells. AQDEF: fields `K2002/1 text`
describe characteristic 1; values stand as `K0001/1 1.5`, or a line for each set with character 15 between
characteristics and 20 between value, attribute, date/time (.DFQ). QIF 2 and 3: the measured spheres of
MeasurementResults."""

import re
import xml.etree.ElementTree as ET
from bisect import bisect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import yaml

from rosette_ros.core.run.errors import InvalidData, unknown
from rosette_ros.io.safe_yaml import PlainDumper, of_schema, parse_yaml
from rosette_ros.io.text_file import read_limited

SCHEMA = 'rosette-columns/1'
MOST_BYTES = 1 << 16
ALIASES = {'table': 'table_position', 'angle': 'table_angle'}
"""Short names of columns."""
ALIASED = {name: short for short, name in ALIASES.items()}
SOURCES = ('name', 'axis', 'value', 'pattern')
"""What a map may name beside the columns of the table and keys of its heading."""
NUMBERS = {'ball': r'\d+', 'table': r'\d+', 'angle': r'[+-]?\d+(?:[.,]\d+)?', 'axis': '[A-Za-z]+'}
"""What stands in braces in a pattern, and how it is written."""
_AXES = ('x', 'y', 'z')
_CALLED = {
    'table': 'table|table position|table pos|tisch|tischposition|tischstellung|position|pos',
    'ball': 'ball|ball no|kugel|kugel nr|sphere no', 'angle': 'rotary|rotary angle|table angle|angle|winkel|drehwinkel',
    'time': 'time|zeit|timestamp|date|datum|date time|datum zeit|zeitpunkt|k0004',
    'temperature': 'temperature|temp|temperatur',
    **{axis: f'{axis}|actual {axis}|{axis} actual|meas {axis}|{axis} meas|ist {axis}|{axis} ist' for axis in _AXES},
    'name': 'feature|feature name|featurename|name|id|element|merkmal|label|characteristic|k2002',
    'axis': 'axis|ax|achse|idsymbol', 'value': 'actual|meas|measured|ist|istwert|value|messwert|k0001'}
"""How programs and laboratories call a quantity, in small letters without units."""
_HINTS = {'ball': 'bks', 'table': 'tp', 'angle': 'arw'}
"""First letters of what stands before a number in the name of a feature: ball, Kugel, sphere; table, position ..."""
Cells = Sequence[tuple[int, Sequence[str]]]
"""Line and cells of each row."""
Lines = list[tuple[int, str]]
"""Line number in the file and text."""
AQDEF = ('K2001', 'K2002', 'K0001', 'K0004')
"""Columns of K-fields: number and description of the characteristic, value, date and time."""
QIF = ('FeatureName', 'x', 'y', 'z', 'TimeStamp')
_FIELD = re.compile(r'(K\d{4})(?:/(\d+))?(?:\s(.*))?')
_NO_VALUE = ('255', '256')
"""Attributes (K0002) of what is no valid value."""
_METRES = {'0.001': 'mm', '0.01': 'cm', '1': 'm', '0.000001': 'um', '0.0254': 'inch'}


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

    def readings(self, names: Sequence[str], rows: Cells, source: str) -> tuple[list[tuple[int, dict[str, str]]], int]:
        """Return line and text by quantity of each reading, and how many rows have names that do not fit the pattern.

        Raises InvalidData where none fits."""
        places = {key: names.index(name) for key, column in self.columns.items()
                  if (name := column.removeprefix('-')) in names}
        signs = {key for key, column in self.columns.items() if column.startswith('-')}
        labels = {**{axis: axis for axis in _AXES}, **{column.casefold(): key for key, column in self.columns.items()
                                                       if key not in places}}
        pattern, found, other, last, is_long = _compiled(self.pattern), list[tuple[int, dict[str, str]]](), 0, '', (
            'value' in places)
        for line, cells in rows:
            texts = {key: cells[at].strip() for key, at in places.items() if at < len(cells)}
            last = name = texts.pop('name', '') or last
            if (fits := pattern.fullmatch(name)) is None:
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
            raise InvalidData(f'{source}: line {rows[0][0]}: wanted names such as {self.pattern!r}, got {last!r:.80}; '
                              '{ball}, {table}, {angle} and {axis} in the pattern stand for what changes, * for any '
                              'text')
        return found, other


def _compiled(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a pattern, whose numbers may have zeros in front and * is any text."""
    parts = re.split(r'({\w+}|\*)', pattern or '*')
    known = ('' if not part else '.*' if part == '*' else f'(?P<{part[1:-1]}>{NUMBERS[part[1:-1]]})'
             if part[:1] == '{' and part[1:-1] in NUMBERS else re.escape(part) for part in parts)
    return re.compile(''.join(known), re.IGNORECASE | re.DOTALL)


def column_map(given: str | dict[str, str], columns: Iterable[str], heading: Iterable[str]) -> ColumnMap:
    """Return the map that is given by its entries, or as `--columns`: a file, or quantity=column,...

    columns, heading: keys of both. Raises InvalidData where it is none."""
    if isinstance(given, dict):
        entries, source = given, '--columns'
    elif '=' not in given:
        values = of_schema(parse_yaml(read_limited(given, 'a file of columns', MOST_BYTES), given, InvalidData), SCHEMA,
                           given, InvalidData, 'a file of rosette import FILE --columns ... --save')
        entries, source = {str(key): str(value) for key, value in values.items() if key != 'schema'}, given
    else:
        parts, source = [part.partition('=') for part in given.split(',')], '--columns'
        entries = {key.strip(): value.strip() for key, _, value in parts}
        if bad := next((''.join(part) for part in parts if not (part[0].strip() and part[2].strip())), ''):
            raise InvalidData(f'--columns: wanted quantity=column,..., got {bad!r:.80}')
        if len(entries) < len(parts):
            raise InvalidData(f'--columns: wanted each quantity once, got {given!r:.200}')
    known = {*_CALLED, *SOURCES, *columns, *heading}
    for key in entries:
        if key not in known and key.rpartition('_')[0] not in (*_AXES, 'time', 'radius'):
            raise InvalidData(f'{source}: {unknown(key, sorted(known))}')
    if wrong := [one for one in re.findall(r'{(.*?)}', entries.get('pattern', '')) if one not in NUMBERS]:
        raise InvalidData(f'{source}: pattern: {unknown(wrong[0], sorted(NUMBERS))}')
    stated = {key: value for key, value in entries.items() if key in heading or key.startswith('radius_')}
    return ColumnMap({key: value for key, value in entries.items() if key not in stated and key != 'pattern'},
                     entries.get('pattern', ''), stated)


def format_columns(columns: ColumnMap) -> str:
    """Return a map as the text of a file."""
    return str(yaml.dump({'schema': SCHEMA, **columns.entries}, Dumper=PlainDumper, sort_keys=False,
                         allow_unicode=True, width=120))


def proposed(names: Sequence[str], rows: Cells, stated: Iterable[str]) -> ColumnMap:
    """Return what the columns of a table seem to be, from their names and the first name of a feature.

    stated: keys that its heading has."""
    plain = {re.sub(r'[\W_]+', ' ', re.sub(r'[\[(].*?[\])]', '', name)).strip().casefold(): name
             for name in reversed(names)}
    found = {key: plain[word] for key, words in _CALLED.items() for word in words.split('|') if word in plain}
    for axis in _AXES:
        found |= {name.casefold(): name for name in names if re.fullmatch(f'{axis}_[a-z]+', name.casefold())
                  and axis not in found}
    if {*_AXES} <= {key.partition('_')[0] for key in found}:
        found = {key: name for key, name in found.items() if key not in ('axis', 'value')}
    pattern = ''
    wanted = [key for key in ('ball', 'table', 'angle') if key not in found and not (
        key != 'ball' and {'table', 'angle'} & found.keys())]
    if not wanted and ('axis' in found or 'value' not in found):
        found.pop('name', None)
    elif 'name' in found and rows:
        at, has_axis = names.index(found['name']), 'value' in found and 'axis' not in found
        tried = [_pattern(cells[at].strip(), wanted, has_axis) for _, cells in rows[:1000] if len(cells) > at]
        pattern = next((one for one in tried if ColumnMap(found, one).is_enough), tried[0])
    made = ColumnMap(found, pattern)
    heading = dict[str, str]()
    if made.is_enough and not {'radius_mm', 'plate'} & {*stated}:
        heading = _circle(made.readings(names, rows, '')[0])
    return ColumnMap(found, pattern, heading)


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
    if not points.size or not np.abs(points).max() < 1e9:
        return {}
    middle = points.mean(axis=0)
    radius = float(np.median(np.linalg.norm(points - middle, axis=1)))
    return {'radius_mm': f'{radius:.1f}', **({'frame': 'machine'} if np.linalg.norm(middle) > radius / 4 else {})}


def foreign_lines(text: str, source: str) -> tuple[Lines, str] | None:
    """Return the lines of a table and the unit of its coordinates, '' if it is not said; None for any other text.

    Raises InvalidData where XML is none, or units differ."""
    begin = text.lstrip()[:4096]
    if re.match(r'K\d{4}(/\d+)?\s', begin):
        return _aqdef(text, source)
    if begin.startswith('<') and 'QIFDocument' in begin:
        return _qif(text, source)
    return None


def _aqdef(text: str, source: str) -> tuple[Lines, str]:
    described: dict[int, dict[str, str]] = {}
    rows: list[tuple[int, int, dict[str, str]]] = []
    last: dict[int, dict[str, str]] = {}
    for line, content in enumerate(re.split('\r\n|\r|\n', text), 1):
        if field := _FIELD.fullmatch(content):
            key, number, value = field[1], int(field[2] or 1), (field[3] or '').strip()
            if key == 'K0001':
                last[number] = {key: value}
                rows.append((line, number, last[number]))
            elif key < 'K0100':
                for one in last.values() if not number else filter(None, [last.get(number)]):
                    one[key] = value
            elif key.startswith('K2'):
                described.setdefault(number, {})[key] = value
        elif content.strip():
            for number, part in enumerate(content.split('\x0f'), 1):
                cells = [cell.strip() for cell in part.split('\x14')]
                rows.append((line, number, dict(zip(('K0001', 'K0002', 'K0004'), cells))))
    units = {one.get('K2142', '').casefold() for one in described.values()} - {''}
    if len(units) > 1:
        raise InvalidData(f'{source}: K2142: wanted one unit of all coordinates, got {", ".join(sorted(units))}')
    table = ([described.get(number, {}).get(key, '') for key in AQDEF[:2]] + [one.get(key, '') for key in AQDEF[2:]]
             for _, number, one in rows)
    return ([(1, '\t'.join(AQDEF)), *((line, '\t'.join(map(_plain, some))) for (line, _, one), some in zip(rows, table)
                                      if one.get('K0002') not in _NO_VALUE)], ''.join(units))


def _qif(text: str, source: str) -> tuple[Lines, str]:
    try:
        root = ET.fromstring(re.sub(r'^\s*<\?xml.*?\?>', '', text))
    except ET.ParseError as error:
        raise InvalidData(f'{source}: wanted QIF (XML), got text that is none: {error}') from None
    name = {one: one.tag.rpartition('}')[2] for one in root.iter()}
    inside = {one: {name[part]: (part.text or '').strip() for part in one} for one in name}
    factor = next((inside[one].get('Factor', '') for unit in name if name[unit] == 'PrimaryUnits' for one in unit.iter(
        ) if name[one] == 'UnitConversion' and any(one in part for part in unit.iter() if name[part] == 'LinearUnit')),
        '')
    items = {one.get('id'): inside[one].get('FeatureName', '') for one in name if name[one].endswith('FeatureItem')}
    spheres = [inside[one] for one in name if name[one] in ('SphereFeatureMeasurement', 'SphereFeatureActual')]
    ends = [0, *(found.end() for found in re.finditer('\n', text))]
    lines = [bisect(ends, found.start()) for found in re.finditer(
        r'<(\w+:)?SphereFeature(Measurement|Actual)[\s>]', text)]
    rows = [(line, [found.get('FeatureName') or items.get(found.get('FeatureItemId')) or '', *place,
                    found.get('TimeStamp', '')]) for line, found in zip(lines, spheres)
            if len(place := found.get('Location', '').split()) == 3]
    if not rows:
        raise InvalidData(f'{source}: wanted QIF results with measured spheres (SphereFeatureMeasurement with a '
                          'Location), got none')
    unit = f'{float(factor or 1):.6f}'.rstrip('0').rstrip('.')
    if unit not in _METRES:
        raise InvalidData(f'{source}: LinearUnit: wanted one of {", ".join(_METRES.values())}, got {factor} m')
    return [(1, '\t'.join(QIF)), *((line, '\t'.join(map(_plain, row))) for line, row in rows)], _METRES[unit]


def _plain(cell: str) -> str:
    return cell.replace('\t', ' ').replace('"', '')

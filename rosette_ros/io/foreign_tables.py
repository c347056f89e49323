# SPDX-License-Identifier: Apache-2.0
"""Q-DAS K-fields (AQDEF) and QIF results as lines of a table with tabs between cells, as any other table is read.

AQDEF: fields `K2002/1 text` describe characteristic 1; values stand as `K0001/1 1.5`, or a line for each set with
character 15 between characteristics and 20 between value, attribute, date/time (.DFQ). QIF 2 and 3: the measured
spheres of MeasurementResults."""

import re
import xml.etree.ElementTree as ET
from bisect import bisect

from rosette_ros.core.errors import InvalidData

Lines = list[tuple[int, str]]
"""Line number in the file and text."""
AQDEF = ('K2001', 'K2002', 'K0001', 'K0004')
"""Columns of K-fields: number and description of the characteristic, value, date and time."""
QIF = ('FeatureName', 'x', 'y', 'z', 'TimeStamp')
_FIELD = re.compile(r'(K\d{4})(?:/(\d+))?(?:\s(.*))?')
_NO_VALUE = ('255', '256')
"""Attributes (K0002) of what is no valid value."""
_METRES = {'0.001': 'mm', '0.01': 'cm', '1': 'm', '0.000001': 'um', '0.0254': 'inch'}


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

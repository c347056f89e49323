# SPDX-License-Identifier: Apache-2.0
"""QIF 2 and 3 (XML): the measured spheres of MeasurementResults, a row for each."""

import contextlib
import re
import xml.etree.ElementTree as ET
from bisect import bisect

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.foreign.foreign_table import ForeignTable

COLUMNS = {'name': 'FeatureName', 'x': 'x', 'y': 'y', 'z': 'z', 'time': 'TimeStamp'}
SPHERES = ('SphereFeatureMeasurement', 'SphereFeatureActual')
_METRES = {'0.001': 'mm', '0.01': 'cm', '1': 'm', '0.000001': 'um', '0.0254': 'inch'}


def read(text: str, source: str) -> ForeignTable | None:
    """Return the measured spheres; None where the text is no QIFDocument.

    Raises InvalidData where it is no XML, has no measured spheres, or has an unknown unit."""
    begin = text.lstrip()[:4096]
    if not (begin.startswith('<') and 'QIFDocument' in begin):
        return None

    try:
        root = ET.fromstring(re.sub(r'^\s*<\?xml.*?\?>', '', text))
    except ET.ParseError as error:
        raise InvalidData(f'{source}: expected QIF (XML), found text that is none: {error}') from None
    name = {one: one.tag.rpartition('}')[2] for one in root.iter()}
    inside = {one: {name[part]: (part.text or '').strip() for part in one} for one in name}
    factor = next((inside[one].get('Factor', '') for unit in name if name[unit] == 'PrimaryUnits' for one in unit.iter(
        ) if name[one] == 'UnitConversion' and any(one in part for part in unit.iter() if name[part] == 'LinearUnit')),
        '')
    items = {one.get('id'): inside[one].get('FeatureName', '') for one in name if name[one].endswith('FeatureItem')}
    sets = [(one.get('id', ''), {items.get(inside[ball].get('FeatureItemId')) or inside[ball].get('FeatureName')
                                 for ball in one.iter() if name[ball] in SPHERES})
            for one in name if name[one] == 'MeasurementResults']
    again = [(other, which) for place, (which, balls) in enumerate(sets) for other, before in sets[:place]
             if balls & before]
    if again:
        raise InvalidData(f'{source}: MeasurementResults: expected the spheres of one run, found the same ones in '
                          f'those with id {again[0][0]} and {again[0][1]}; export each run to a file of its own')
    spheres = [inside[one] for one in name if name[one] in SPHERES]
    ends = [0, *(found.end() for found in re.finditer('\n', text))]
    lines = [bisect(ends, found.start()) for found in re.finditer(
        r'<(\w+:)?SphereFeature(Measurement|Actual)[\s>]', text)]
    rows = [(line, [found.get('FeatureName') or items.get(found.get('FeatureItemId')) or '', *place,
                    found.get('TimeStamp', '')]) for line, found in zip(lines, spheres)
            if len(place := found.get('Location', '').split()) == 3]
    if not rows:
        raise InvalidData(f'{source}: expected QIF results with measured spheres (SphereFeatureMeasurement with a '
                          'Location), found none')
    with contextlib.suppress(ValueError):
        factor = f'{float(factor or 1):.6f}'.rstrip('0').rstrip('.')
    unit = factor
    if unit not in _METRES:
        raise InvalidData(f'{source}: LinearUnit: expected one of {", ".join(_METRES.values())}, found {factor} m')
    return ForeignTable.of_rows(COLUMNS.values(), rows, COLUMNS, _METRES[unit])

# SPDX-License-Identifier: Apache-2.0
"""Q-DAS K-fields (AQDEF, .dfq): a row for each value.

Fields `K2002/1 text` describe characteristic 1; values stand as `K0001/1 1.5`, or a line for each set with character 15
between characteristics and 20 between value, attribute, date/time. Of a pair of files the descriptions (.dfd) stand
first, then, behind a form feed, the values (.dfx), whose lines count."""

import re
from collections.abc import Iterator

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.foreign.foreign_table import ForeignTable

NAMES = ('K2001', 'K2002', 'K0001', 'K0004')
"""Number and description of the characteristic, value, date and time."""
COLUMNS = {'name': 'K2002', 'value': 'K0001', 'time': 'K0004'}
PAIR = ('.dfd', '.dfx')
"""How the names of two files end that belong together: descriptions, values."""
BEHIND = '\f'
_FIELD = re.compile(r'(K[0-9]{4})(?:/([0-9]{1,9}))?(?:\s(.*))?')
_NO_VALUE = ('255', '256')
"""Attributes (K0002) of what is no valid value."""


def read(text: str, source: str) -> ForeignTable | None:
    """Return the values of all characteristics; None where the text does not begin with a K-field.

    Raises InvalidData where the units of the characteristics differ."""
    if not re.match(r'K\d{4}(/\d+)?\s', text.lstrip()[:4096]):
        return None

    described: dict[int, dict[str, str]] = {}
    rows: list[tuple[int, int, dict[str, str]]] = []
    last: dict[int, dict[str, str]] = {}
    for line, content in numbered(text):
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
        elif content.strip() and not content.startswith('K'):  # a field of no characteristic
            for number, part in enumerate(content.split('\x0f'), 1):
                cells = [cell.strip() for cell in part.split('\x14')]
                rows.append((line, number, dict(zip(('K0001', 'K0002', 'K0004'), cells))))

    units = {one.get('K2142', '').casefold() for one in described.values()} - {''}
    if len(units) > 1:
        raise InvalidData(f'{source}: K2142: expected one unit of all coordinates, found {", ".join(sorted(units))}')
    fields = [(line, {**described.get(number, {}), **value}) for line, number, value in rows
              if value.get('K0002') not in _NO_VALUE]
    return ForeignTable.of_rows(
        NAMES, ((line, [one.get(key, '') for key in NAMES]) for line, one in fields), COLUMNS, ''.join(units))


def numbered(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text with their numbers, those of each file of a pair from 1."""
    for part in text.split(BEHIND):
        yield from enumerate(re.split('\r\n|\r|\n', part), 1)

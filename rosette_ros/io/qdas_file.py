# SPDX-License-Identifier: Apache-2.0
"""Results for statistical process control, Q-DAS K-fields (AQDEF, .dfq): a characteristic for each error and its U."""

import datetime
from collections.abc import Sequence
from typing import NamedTuple

from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.io.identity_file import Identity

LONGEST = 80
"""Characters of a text field."""


class Characteristic(NamedTuple):
    """A result: name, value, upper limit or None, unit in ASCII; its standard uncertainty and what is decided about its
    limit, None where there is none."""

    name: str
    value: float
    limit: float | None
    unit: str
    u: float | None = None
    conformity: Conformity | None = None


def format_dfq(characteristics: Sequence[Characteristic], identity: Identity, run_id: str,
               when: datetime.datetime | None, event: str) -> str:
    """Return results as K-fields: part and machine of the identity, then each characteristic with its value.

    when: of the measurement, None where it is not known; event: what is said of all values, such as a verdict."""
    head = [('K0100', str(len(characteristics))), ('K1001', identity['table.model']), ('K1002', 'rotary table'),
            ('K1021', identity['table.maker']), ('K1203', 'calibration'), ('K1206', identity['customer.order']),
            ('K1303', identity['place.name'])]
    fields = [(key, value) for key, value in head if value]
    for place, one in enumerate(characteristics, 1):
        limits = [] if one.limit is None else [(f'K2110/{place}', '0'), (f'K2111/{place}', _number(one.limit))]
        fields += [(f'K2001/{place}', str(place)), (f'K2002/{place}', one.name), *limits,
                   (f'K2142/{place}', one.unit)]
    for place, one in enumerate(characteristics, 1):
        fields += [(f'K0001/{place}', _number(one.value)), (f'K0002/{place}', '0'),
                   *([(f'K0004/{place}', f'{when:%d.%m.%Y/%H:%M:%S}')] if when else []),
                   *([(f'K0008/{place}', identity['operator.name'])] if identity['operator.name'] else []),
                   (f'K0009/{place}', event), (f'K0014/{place}', identity['table.serial'] or run_id)]
    return ''.join(f'{key} {_line(value)}\r\n' for key, value in fields)


def _number(value: float) -> str:
    return f'{value:.9g}'


def _line(text: str) -> str:
    """Return a text as one line that a field holds."""
    return ' '.join(''.join(one if one.isprintable() else ' ' for one in text).split())[:LONGEST]

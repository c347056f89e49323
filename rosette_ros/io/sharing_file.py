# SPDX-License-Identifier: Apache-2.0
"""What several runs share, declared in YAML, schema rosette-sharing/1."""

from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.core.joint.sharing import PARTS, SEATS, apart
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.number_limits import is_number
from rosette_ros.io.safe_yaml import known_keys, of_schema, read_yaml

SCHEMA = 'rosette-sharing/1'
MOST_BYTES = 65536
_KEYS = ('schema', *PARTS, 'seat', 'by_sense', 'plate_turned_deg')


def read_sharing(path: str | Path | None, runs: int) -> dict[str, Any]:
    """Return the fields of Sharing that a file declares for so many runs, {} without a file; raises InvalidData."""
    if path is None:
        return {}
    values = of_schema(read_yaml(path, 'a sharing file', MOST_BYTES, InvalidData), SCHEMA, str(path), InvalidData)
    declared: dict[str, Any] = {}
    known_keys(values, _KEYS, str(path), InvalidData)
    for key, value in values.items():
        if key == 'cmm' and value == 'calibrated':
            declared['cmm_is_calibrated'] = True
        elif key in PARTS:
            declared[key] = _names(value, runs, f'{path}: {key}')
        elif key == 'seat' and value not in tuple(SEATS):  # also of what cannot be a key
            raise InvalidData(f'{path}: seat: expected one of {", ".join(SEATS)}, found {value!r:.80}')
        elif key == 'by_sense' and not isinstance(value, bool):
            raise InvalidData(f'{path}: by_sense: expected true or false, found {value!r:.80}')
        elif key in ('seat', 'by_sense'):
            declared[key] = value
        elif key == 'plate_turned_deg':
            declared['turn'] = tuple(np.deg2rad(_angles(value, runs, f'{path}: {key}')).tolist())
    return declared


def _names(value: object, runs: int, where: str) -> tuple[str, ...]:
    if value in ('shared', 'separate'):
        return ('1',) * runs if value == 'shared' else apart(runs)
    if isinstance(value, list) and len(value) == runs and all(type(one) in (str, int) for one in value):
        return tuple(map(str, value))
    raise InvalidData(f'{where}: expected shared, separate, or a name for each of {runs} runs such as '
                      f'[{", ".join(apart(runs))}], found {value!r:.80}')


def _angles(value: object, runs: int, where: str) -> list[float]:
    if isinstance(value, list) and len(value) == runs and all(map(is_number, value)):
        return value
    raise InvalidData(f'{where}: expected an angle in degrees for each of {runs} runs, the first 0, found '
                      f'{value!r:.80}')

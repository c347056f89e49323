# SPDX-License-Identifier: Apache-2.0
"""A plate of any pitch, schema rosette-plate/1: nominal or calibrated ball centres, as YAML."""

from pathlib import Path

import numpy as np
import yaml

from rosette_ros.core.joint.readings import Plate
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Floats
from rosette_ros.core.run.number_limits import is_number
from rosette_ros.io.safe_yaml import known_keys, of_schema, parse_yaml
from rosette_ros.io.text_file import read_limited

SCHEMA = 'rosette-plate/1'
MOST_BYTES, MOST_BALLS = 1 << 20, 720
_LISTS = ('azimuth_deg', 'radius_mm', 'height_mm')
_KEYS = ('schema', 'calibrated', *_LISTS)
LEAST_BALLS = 3
LEAST_PITCH = 1e-3
"""Balls that are nearer to each other, m, are one ball given twice."""


def read_plate(path: str | Path) -> Plate:
    """Return the Plate of a file; raises InvalidData, naming file and key, where it is none."""
    return parse_plate(read_limited(path, 'a plate file', MOST_BYTES), str(path))


def parse_plate(data: bytes, path: str = 'plate') -> Plate:
    """Return the Plate of a file's bytes; path: its name in errors."""
    values = of_schema(parse_yaml(data, path, InvalidData), SCHEMA, path, InvalidData)
    known_keys(values, _KEYS, path, InvalidData)
    calibrated = values.get('calibrated', False)
    if not isinstance(calibrated, bool):
        raise InvalidData(f'{path}: calibrated: expected true or false, found {calibrated!r:.80}')
    azimuth = values.get('azimuth_deg')
    if not isinstance(azimuth, list) or not LEAST_BALLS <= len(azimuth) <= MOST_BALLS:
        raise InvalidData(f'{path}: azimuth_deg: expected a list of {LEAST_BALLS} to {MOST_BALLS} angles, one for each '
                          f'ball, found {azimuth!r:.80}')
    angle, radius, height = (_numbers(values.get(key, 0.0 if key == 'height_mm' else None), len(azimuth),
                                      f'{path}: {key}') for key in _LISTS)
    if radius.min() <= 0:
        raise InvalidData(f'{path}: radius_mm: expected positive numbers, found {radius.min():g}')
    plate = Plate(np.deg2rad(angle), 1e-3 * radius, 1e-3 * height, calibrated, source=path)
    apart = np.linalg.norm(plate.centres[:, None] - plate.centres, axis=-1) + np.diag(np.full(plate.balls, np.inf))
    one, other = np.unravel_index(np.argmin(apart), apart.shape)
    if apart[one, other] < LEAST_PITCH:
        raise InvalidData(f'{path}: expected each ball at a place of its own, found balls {one + 1} and {other + 1} '
                          'at one')
    return plate


def format_plate(plate: Plate) -> str:
    """Return a plate as the text of a file."""
    columns = zip(_LISTS, (np.rad2deg(plate.azimuth), 1e3 * plate.radius, 1e3 * plate.height), strict=True)
    return yaml.safe_dump({'schema': SCHEMA, 'calibrated': plate.is_calibrated, **{
        name: np.round(values, 9).tolist() for name, values in columns}}, sort_keys=False, default_flow_style=None)


def plate_of_table(name: str, path: str | Path) -> Plate:
    """Return the Plate of the file that a table of ball centres names, which stands beside it; raises InvalidData."""
    file = Path(path).parent / name
    if Path(name).name != name or (file.exists() and not file.is_file()):
        raise InvalidData(f'{path}: plate: expected the name of a file beside the table, found {name!r:.80}')
    return read_plate(file)


def _numbers(value: object, count: int, where: str) -> Floats:
    """Return a number for each ball, from a list or from one number for all."""
    every = value if isinstance(value, list) else [value] * count
    if len(every) != count:
        raise InvalidData(f'{where}: expected a number, or one for each of {count} balls, found {len(every)}')
    for number, one in enumerate(every, 1):
        if not is_number(one):
            raise InvalidData(f'{where}: ball {number}: expected a finite number, found {one!r:.40}')
    return np.array(every, dtype=float)

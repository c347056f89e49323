# SPDX-License-Identifier: Apache-2.0
"""Curves of a table from a file of the user's or of its maker: table angles and some of the six error motions, CSV."""

import math
import re
from collections.abc import Set
from pathlib import Path

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.number_words import ARC_SECOND
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.curve_comparison import TableCurves
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.io.csv_cells import cells_of
from rosette_ros.io.text_file import read_limited

ANGLES = ('table_angle_deg', 'angle_deg', 'angle')
UNITS = {'t': {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'nm': 1e-9},
         'r': {'rad': 1.0, 'mrad': 1e-3, 'urad': 1e-6, 'arcsec': ARC_SECOND}}
"""Units at the end of a column's name, of translations and rotations, in SI."""
LARGEST_FILE, FEWEST = 10_000_000, 4
_COLUMN = re.compile(r'(u_|U_)?(c[tr][xyz])_([a-z]+)(?:_forward)?')
WANTED = f'{ANGLES[0]} and some of ctx_um, cty_um, ctz_um, crx_urad, cry_urad, crz_urad (or mm, arcsec ...)'


def holds_curves(path: str | Path) -> bool:
    """Return whether a file is a table of curves, by the names of its columns."""
    if Path(path).suffix.lower() != '.csv' or not Path(path).is_file():
        return False
    names = next((line for _, line in _lines(path)), '').replace('"', '').split(',')
    return any(_COLUMN.fullmatch(name.strip()) for name in names)


def read_curves(path: str | Path) -> TableCurves:
    """Return the curves of a CSV table; raises InvalidData, naming file and line.

    Columns: the angle in degrees, curves with their unit such as ctz_um, and of each curve u_ctz_um (standard) or
    U_ctz_um (k = 2), without which its uncertainty is not known. Lines that begin with '#' are passed over; of both
    senses of turning the forward one is taken."""
    rows = [(line, cells_of(text, str(path), line)) for line, text in _lines(path)]
    names = [name.strip() for name in rows[0][1]] if rows else []
    places = {match.groups(): place for place, name in enumerate(names) if (match := _COLUMN.fullmatch(name))}
    at = next((names.index(name) for name in ANGLES if name in names), None)
    curves = tuple(curve for curve in CURVES if any(not kind and one == curve for kind, one, _ in places))
    if at is None or not curves:
        raise InvalidData(f'{path}: expected the columns {WANTED}, found {",".join(names)[:200] or "none"}')
    for _, curve, unit in places:
        if unit not in UNITS[curve[1]]:
            raise InvalidData(f'{path}: expected the unit of {curve} as one of {", ".join(UNITS[curve[1]])}, found '
                              f'{unit!r}')
    if len(rows) - 1 < FEWEST:
        raise InvalidData(f'{path}: expected at least {FEWEST} rows of curves, found {len(rows) - 1}')
    numbers = np.array([_numbers(cells, names, {at, *places.values()}, path, line) for line, cells in rows[1:]])
    if not np.isfinite(numbers[:, at]).all():
        raise InvalidData(f'{path}: {names[at]}: expected an angle in each row, found an empty one')
    values, u = np.full((len(numbers), 6), np.nan), np.full((len(numbers), 6), np.nan)
    for (kind, curve, unit), place in places.items():
        target, factor = (u, UNITS[curve[1]][unit]) if kind else (values, UNITS[curve[1]][unit])
        target[:, CURVES.index(curve)] = numbers[:, place] * factor / (COVERAGE_FACTOR if kind == 'U_' else 1)
    return TableCurves(Path(path).name, np.deg2rad(numbers[:, at]), values, u)


def _lines(path: str | Path) -> list[tuple[int, str]]:
    """Return the lines that are neither empty nor remarks, with their numbers."""
    data = read_limited(path, 'a table of curves', LARGEST_FILE)
    try:
        text = data.decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise InvalidData(f'{path}: expected a table of curves as text in UTF-8, found: {error}') from error
    return [(number, line) for number, line in enumerate(text.splitlines(), 1)
            if line.strip() and not line.startswith('#')]


def _numbers(cells: list[str], names: list[str], used: Set[int], path: str | Path, line: int) -> list[float]:
    """Return the cells of a row as numbers, NaN where one is empty, or of a column that is not used."""
    if len(cells) != len(names):
        raise InvalidData(f'{path}: line {line}: expected {len(names)} cells, found {len(cells)}')
    out = [math.nan] * len(cells)
    for place in sorted(used):
        try:
            out[place] = float(cells[place].strip() or 'nan')
        except ValueError as error:
            raise InvalidData(f'{path}: line {line}: {names[place]}: expected a number, found {cells[place]!r:.40}'
                              ) from error
    return out

# SPDX-License-Identifier: Apache-2.0
"""The ball-centre table, rosette-ball-centres/1: a Run as a CSV file for people and spreadsheets.

`# key: value` lines, a line of column names, then one line per reading in measuring order. A table
angle within half a unit of its last written decimal of the nominal one means the nominal one:
51.43 at 7 balls is 360°/7, not an error of 25 µrad.
"""

import os
from decimal import Decimal
from pathlib import Path

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import nominal_angles
from rosette_ros.core.records import Run
from rosette_ros.core.scheme import unwrap_travel
from rosette_ros.data.csv_cells import COLUMNS, SCHEMA, TRAVEL_COLUMN, parse_table
from rosette_ros.data.csv_checks import check_readings, find_balls

MAX_BYTES = 256 << 20
"""A larger table is refused; 360 balls make 17 MB."""
TRAVEL_TOLERANCE = 1e-3
"""A travel that angles and approach tell to within this, rad, is not written."""


def read_csv(path):
    """Return the Run of a CSV table.

    Raises InvalidData that names file, line and column where the table is not what it should be.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InvalidData(f'{path}: wanted a table of at most {MAX_BYTES >> 20} MB, got '
                              f'{path.stat().st_size >> 20} MB')
        data = path.read_bytes()
    except OSError as error:
        raise InvalidData(f'{path}: wanted a table that can be read, got {error.strerror}; '
                          'check the path and its rights') from error
    return parse_csv(data, str(path))


def parse_csv(data, source='table'):
    """Return the Run of a CSV table given as bytes; `source` is named in errors."""
    table = parse_table(data, source)
    n = find_balls(table)
    angle = check_readings(table, n)
    columns = table.columns
    travel = columns.get(TRAVEL_COLUMN)
    return Run.from_readings(
        n=n, radius=table.radius, table_position=columns['table_position'],
        ball=columns['ball'],
        centre=np.stack([columns[f'{axis}_mm'] for axis in 'xyz'], axis=-1) / 1e3,
        table_angle=angle, time=columns['time_s'], temperature=columns.get('temperature_C'),
        approach=columns.get('approach'),
        table_travel=None if travel is None else np.deg2rad(travel),
        repeatability=table.repeatability, repeatability_dof=table.repeatability_dof,
        run_id=table.run_id, repeats=table.repeats, session=table.session, source=source)


def write_csv(run, path, force=False):
    """Write a Run as a CSV table, as a whole or not at all.

    Raises InvalidData where the file exists, unless `force`, or cannot be written.
    """
    path = Path(path)
    if path.exists() and not force:
        raise InvalidData(f'{path}: exists already; wanted a new file. Choose another name, or '
                          '--force to overwrite it')
    temporary = path.with_name(path.name + '.part')
    try:
        temporary.write_text(format_csv(run), encoding='utf-8', newline='')
        os.replace(temporary, path)
    except OSError as error:
        raise InvalidData(f'{path}: wanted a file that can be written, got {error.strerror}; '
                          'check the folder and its rights') from error


def format_csv(run):
    """Return a Run as the text of a CSV table.

    Coordinates in mm with 12 decimals (1e-15 m); everything else such that reading it gives the
    same number, or one that differs by the last bit.
    """
    names = list(COLUMNS)
    cells = {
        'seq': map(str, range(1, run.size + 1)),
        'table_position': map(str, run.table_position.tolist()),
        'ball': map(str, run.ball.tolist()),
        'cmm_position': map(str, run.cmm_position.tolist()),
        'table_angle_deg': _angle_cells(run),
        **{f'{axis}_mm': [f'{value:.12f}' for value in (run.centre[:, column] * 1e3).tolist()]
           for column, axis in enumerate('xyz')},
        'time_s': map(repr, run.time.tolist()),
        'temperature_C': ['' if value != value else repr(value)
                          for value in run.temperature.tolist()],
        'approach': map(str, run.approach.tolist()),
    }
    if not _travel_is_told(run):
        names.append(TRAVEL_COLUMN)
        cells[TRAVEL_COLUMN] = map(repr, np.rad2deg(run.table_travel).tolist())
    rows = zip(*(cells[name] for name in names), strict=True)
    return '\n'.join([*_heading(run), ','.join(names), *map(','.join, rows), ''])


def _heading(run):
    heading = {'schema': SCHEMA, 'radius_mm': _shifted(run.radius, 3), 'balls': run.n}
    if run.repeatability is not None:
        heading['repeatability_um'] = _shifted(run.repeatability, 6)
        if run.repeatability_dof is not None:
            heading['repeatability_dof'] = repr(float(run.repeatability_dof))
    if run.repeats:
        heading['repeated_balls'] = 'yes'
    if run.pauses:
        heading['pauses_before'] = ', '.join(str(first + 1) for first in run.pauses)
    if run.run_id.split():
        heading['run_id'] = ' '.join(run.run_id.split())  # a line break would end the line
    return [f'# {key}: {value}' for key, value in heading.items()]


def _shifted(value, digits):
    """Return value * 10**digits as text, exactly: only the decimal point moves."""
    return format(Decimal(repr(float(value))).scaleb(digits), 'f')


def _angle_cells(run):
    """Return the table angles in degrees: short where nominal, else with decimals to the end."""
    angle = np.rad2deg(run.table_angle)
    nominal = run.table_angle == nominal_angles(run.n)[run.table_position - 1]
    exact = (360.0 * (run.table_position - 1) / run.n).tolist()
    return [repr(short) if is_nominal else f'{value:.15f}'
            for is_nominal, short, value in zip(nominal.tolist(), exact, angle.tolist(),
                                                strict=True)]


def _travel_is_told(run):
    """Whether angles and approach give the recorded travel, up to where it starts."""
    told = unwrap_travel(run.table_angle, run.approach, run.n)
    difference = run.table_travel - told
    return bool(np.ptp(difference) < TRAVEL_TOLERANCE)

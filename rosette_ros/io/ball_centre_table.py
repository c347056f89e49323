# SPDX-License-Identifier: Apache-2.0
"""The ball-centre table, rosette-ball-centres/1: a Run as a CSV file for people and spreadsheets.

`# key: value` lines, a line of column names, then one line per reading in measuring order. A table angle within half a
unit of its last written decimal of the nominal one means the nominal one: 51.43 at 7 balls is 360°/7, not an error of
25 µrad."""

from collections.abc import Iterable, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.core.joint.readings import Plate, Readings
from rosette_ros.core.run.axes import ALONG, moving_axes, words
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import (
    Bools,
    Floats,
    fitted_frame,
    nominal_angles,
    rotate_z,
    rotation_matrix,
    turned_frame,
    wrap,
)
from rosette_ros.core.run.records import Run, turned_steps
from rosette_ros.core.run.scheme import cmm_position, nominal_places
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.csv_parser import COLUMNS, WAY_COLUMNS, CsvTable
from rosette_ros.io.foreign.aqdef import BEHIND
from rosette_ros.io.foreign.formats import pair_of
from rosette_ros.io.plate_file import plate_of_table
from rosette_ros.io.reading_checks import RADII, remarks_on_table
from rosette_ros.io.run_assembly import MAX_BALLS, misplaced
from rosette_ros.io.table_heading import LENGTHS, SCHEMA, moment_words
from rosette_ros.io.text_file import read_limited, write_text

MAX_BYTES = 256 << 20  # a larger table is refused; 360 balls make 17 MB
MOST_POSITIONS = 3600
TRAVEL_TOLERANCE = 1e-3  # a travel that angles and approach determine to within this, rad, is not written
_UNIT = 1.5  # factor within which a ratio of radii is taken for a wrong unit


def read_csv(path: str | Path, columns_of: ColumnMap | None = None) -> Run:
    """Return the Run of a CSV table, or of another one whose columns are known.

    Raises InvalidData that names file, line and column where it is none."""
    return parse_csv(*table_bytes(path), columns_of)


def table_bytes(path: str | Path) -> tuple[bytes, str]:
    """Return the bytes of a table, and the name of the file with its values: a Q-DAS pair is read together.

    Raises InvalidData where a file cannot be read, or one of a pair is missing."""
    if pair := pair_of(path):
        return BEHIND.encode().join(read_limited(one, 'a table', MAX_BYTES) for one in pair), str(pair[1])
    return read_limited(path, 'a table', MAX_BYTES), str(path)


def parse_csv(data: bytes, source: str = 'table', columns_of: ColumnMap | None = None) -> Run:
    """Return the Run of a CSV table given as bytes; `source` is named in errors; columns_of: as of read_csv."""
    table = CsvTable(data, source, columns_of)
    notes = [*table.notes, *_put_on_places(table)]
    n = _find_balls(table)
    _check_rows(table, n)
    angle = _table_angles(table, n)
    places = rotate_z(table.table_offset, nominal_places(n, 1e3 * table.radius, table.table_position, table.ball))
    _check_units(table, places, 'radius_mm')
    if table.in_machine:
        axis = ', '.join(f'{round(value, 3) + 0.0:.3f}' for value in _to_table_frame(table, places))
        notes.append('the table frame was fitted to all readings; its axis, about which positions and balls are '
                     f'counted counter-clockwise, is ({axis}) in the machine frame')
    table.centre, table.rotation = turned_frame(table.table_offset, table.centre, table.rotation)
    _check_places(table, n)
    columns = table.columns
    recorded: dict[str, Any] = {field: columns.get(name) for field, name in (
        ('time', 'time_s'), ('temperature', 'temperature_C'), ('approach', 'approach'))}
    if WAY_COLUMNS[0] in columns:
        recorded['table_travel'] = np.deg2rad(columns[WAY_COLUMNS[0]])
    senses = _sense_columns(table.rotation)
    if all(name in columns for name in senses.values()):
        recorded['cmm_sense'] = np.zeros((len(angle), 3))
        recorded['cmm_sense'][:, list(senses)] = np.stack([columns[name] for name in senses.values()], axis=-1)
    run = Run(
        n, table.radius, table.table_position, table.ball, table.centre / 1e3, table_angle=angle,
        repeatability=table.repeatability, repeatability_dof=table.repeatability_dof,
        repeatability_axes=table.repeatability_axes,
        run_id=table.run_id, repeats=table.repeats, session=table.session,
        source=source, notes=tuple(notes), simulated=table.simulated,
        rotation=table.rotation, table_offset=table.table_offset, begun=table.begun, **recorded)
    turn = table.rotation if table.in_machine else rotation_matrix([0.0, 0.0, table.table_offset])
    steps = table.steps if turn is None else turned_steps(table.steps, turn)
    return run.replace(remarks=remarks_on_table(run, float(table.steps.max()), 'time_s' in columns),
                       written_steps=None if np.array_equal(steps, run.steps) else steps)


def read_with_plate(path: str | Path) -> Readings:
    """Return the Readings of a CSV table with a plate file; raises InvalidData as read_csv, and where they disagree."""
    table = CsvTable(*table_bytes(path))
    plate, positions = _checked_plate(table)
    _check_order(table)
    angle = _table_angles(table, positions)
    every = nominal_angles(positions) + table.table_offset
    nominal = every[table.table_position - 1]
    places = 1e3 * rotate_z(nominal, plate.centres[table.ball - 1])
    notes = table.notes
    _check_units(table, places, f'the plate file {table.plate}')
    if table.in_machine:
        _to_table_frame(table, places)
        notes.append('the table frame was fitted to all readings')
    _check_distance(table, plate, table.centre - places)
    return Readings(plate, every, table.table_position, table.ball, table.centre / 1e3,
                    wrap(angle + table.table_offset - nominal),
                    table.columns.get('approach', np.zeros(table.ball.size)).astype(np.int64),
                    table.repeatability, table.repeatability_dof, None, table.run_id, str(path), tuple(notes),
                    table.simulated, table.rotation, rounding=float(np.sqrt(np.mean(table.steps**2) / 12)))


def write_csv(run: Run, path: str | Path, force: bool = False) -> None:
    """Write a Run as a CSV table; raises InvalidData where the file exists, unless `force`, or cannot be written."""
    write_text(path, format_csv(run), force)


def format_csv(run: Run) -> str:
    """Return a Run as the text of a CSV table.

    Coordinates in mm with 12 decimals (1e-15 m); everything else such that reading it gives the same number, or one
    that differs by the last bit."""
    names, (centre, _) = list(COLUMNS), run.from_angle_zero()
    integers = {'seq': np.arange(1, run.size + 1), 'table_position': run.table_position, 'ball': run.ball,
                'cmm_position': run.cmm_position, 'approach': run.approach}
    cells: dict[str, Iterable[str]] = {
        **{name: map(str, values.tolist()) for name, values in integers.items()},
        **{f'{axis}_mm': map('{:.12f}'.format, values) for axis, values in zip('xyz', (centre.T * 1e3).tolist())},
        'table_angle_deg': _angle_cells(run), 'time_s': map(repr, run.time.tolist()),
        'temperature_C': ['' if value != value else repr(value) for value in run.temperature.tolist()]}
    bare = run.replace(table_travel=None, cmm_sense=None, unrecorded=None)
    told = [name for name in ('table_travel', 'cmm_sense') if name not in run.unrecorded]
    if 'table_travel' in told and ('table_travel' in bare.unrecorded or np.ptp(
            run.table_travel - bare.table_travel) >= TRAVEL_TOLERANCE):
        names.append(WAY_COLUMNS[0])
        cells[WAY_COLUMNS[0]] = map(repr, np.rad2deg(run.table_travel).tolist())
    if 'cmm_sense' in told and not np.array_equal(run.cmm_sense, bare.cmm_sense):
        senses = _sense_columns(run.rotation)
        names += senses.values()
        cells |= {name: map('{:.0f}'.format, run.cmm_sense[:, axis]) for axis, name in senses.items()}
    rows = zip(*(cells[name] for name in names), strict=True)
    return '\n'.join([*_heading(run), ','.join(names), *map(','.join, rows), ''])


def _heading(run: Run) -> list[str]:
    heading: dict[str, object] = {'schema': SCHEMA, 'radius_mm': _shifted(run.radius, 3), 'balls': run.n}
    if run.repeatability is not None:
        heading['repeatability_um'] = _shifted(run.repeatability, 6)
        if run.repeatability_dof is not None:
            heading['repeatability_dof'] = repr(float(run.repeatability_dof))
        if run.repeatability_axes is not None:
            heading['repeatability_axes_um'] = ', '.join(_shifted(one, 6) for one in run.repeatability_axes)
    if run.repeats:
        heading['repeated_balls'] = 'yes'
    if run.pauses:
        heading['pauses_before'] = ', '.join(str(first + 1) for first in run.pauses)
    if run.run_id.split():
        heading['run_id'] = ' '.join(run.run_id.split())  # a line break would end the line
    if run.table_offset:
        heading['table_offset_deg'] = repr(_offset_deg(run))
    if (rotation := run.from_angle_zero()[1]) is not None:
        for key, column in (('table_axis', 2), ('table_x', 0)):
            heading[key] = ', '.join(map(repr, rotation[:, column].tolist()))
    if run.begun is not None:
        heading['first_reading_at'] = moment_words(run.begun)
    if run.simulated:
        heading['simulated'] = 'yes'
    return [f'# {key}: {value}' for key, value in heading.items()]


def _sense_columns(rotation: Floats | None) -> dict[int, str]:
    """Return the columns of the senses of the CMM by its axes, 0..2, that go to and fro."""
    return {axis: WAY_COLUMNS[1 + axis] for axis in moving_axes(rotation)}


def _to_table_frame(table: CsvTable, places: Floats) -> Floats:
    """Put the centres of a table into the frame in which they are nearest to places (N, 3), and return its axis.

    Raises InvalidData where the heading states another axis."""
    frame = fitted_frame(table.centre, places)
    table.centre = frame.to_inner(table.centre)
    axis = frame.rotation[:, 2]
    if table.rotation is not None and (off := np.arccos(np.clip(table.rotation[:, 2] @ axis, -1, 1))) > ALONG:
        raise InvalidData(f'{table.source}: table_axis: expected {words(axis)}, about which the ball centres turn, '
                          'found '
                          f'{words(table.rotation[:, 2])}, {np.rad2deg(off):.0f} deg off; correct it, or '
                          'leave it out')
    table.rotation = frame.rotation
    return axis


def _shifted(value: float, digits: int) -> str:
    """Return value * 10**digits as text, exactly: only the decimal point moves."""
    return format(Decimal(repr(float(value))).scaleb(digits), 'f')


def _angle_cells(run: Run) -> list[str]:
    """Return the table angles in degrees: short where nominal, else with decimals to the end."""
    nominal = run.table_angle == nominal_angles(run.n)[run.table_position - 1]
    exact = (360.0 * (run.table_position - 1) / run.n + _offset_deg(run)).tolist()
    angle = np.rad2deg(run.table_angle + run.table_offset).tolist()
    return [repr(short) if is_nominal else f'{value:.15f}'
            for is_nominal, short, value in zip(nominal.tolist(), exact, angle)]


def _offset_deg(run: Run) -> float:
    """Return the table angle of table position 1, degrees, with no more digits than targets in a log have."""
    return round(float(np.rad2deg(run.table_offset)), 10)


def _checked_plate(table: CsvTable) -> tuple[Plate, int]:
    """Return the plate that a table names, and the steps of its table; raises InvalidData where they do not fit it."""
    plate, positions = plate_of_table(table.plate, table.source), table.positions
    if positions is None or not 1 <= positions <= MOST_POSITIONS:
        raise InvalidData(f'{table.source}: expected "# table_positions: ...", how many equal steps a turn of the '
                          'table '
                          f'has (at most {MOST_POSITIONS}), found {"none" if positions is None else positions}')
    if table.balls not in (None, plate.balls):
        raise InvalidData(f'{table.source}: balls: expected {plate.balls}, as the plate file {table.plate} has, found '
                          f'{table.balls}')
    for name, index, most in (('table_position', table.table_position, positions), ('ball', table.ball, plate.balls)):
        for row in np.flatnonzero((index < 1) | (index > most)):
            raise table.wrong(row, name, f'1..{most}', index[row])
    return plate, positions


def _put_on_places(table: CsvTable) -> list[str]:
    """Number the balls of a plate of its own by their places on a circle of as many steps as the table has."""
    if not table.plate:
        return []
    plate, positions = _checked_plate(table)
    places = plate.places(positions)
    table.ball, table.balls, table.radius = np.array(places)[table.ball - 1], positions, plate.circle
    words = f'the balls have the numbers of their places of {positions}: {", ".join(map(str, places))}'
    return [words, *['the calibration of the plate is not used here (rosette evaluate uses it)'] * plate.is_calibrated]


def _find_balls(table: CsvTable) -> int:
    """Return n, the number of balls and table positions, from the heading or the largest index."""
    indices = {'table_position': table.table_position, 'ball': table.ball}
    for name, index in indices.items():
        for row in np.flatnonzero(index < 1):
            raise table.wrong(row, name, 'at least 1', index[row], 'indices count from 1')
    last = {name: int(index.max()) for name, index in indices.items()}
    smaller, larger = sorted(last, key=lambda name: last[name])
    if table.balls is None and last[smaller] < last[larger]:
        raise table.wrong(
            np.argmax(indices[larger]), larger, f'at most {last[smaller]}, as far as {smaller} goes', last[larger],
            f'as many table positions as balls are measured; if some are missing, say so by "# balls: {last[larger]}"')
    n = last[larger] if table.balls is None else table.balls
    if not 3 <= n <= MAX_BALLS:
        raise InvalidData(f'{table.source}: expected 3 to {MAX_BALLS} balls, found {n}')
    for name, index in indices.items():
        for row in np.flatnonzero(index > n):
            raise table.wrong(row, name, f'1..{n}', index[row], f'the heading says "# balls: {n}"')
    if last[larger] < n and np.unique(table.table_position * (n + 1) + table.ball).size == last[larger]**2:
        raise InvalidData(f'{table.source}: expected a run with {n} balls, as the heading says ("# balls: {n}"), '
                          'found a '
                          f'complete one with {last[larger]}; correct the heading')
    return n


def _check_order(table: CsvTable) -> None:
    """Refuse unknown approaches, rows out of order and balls that stand twice."""
    columns, i, j = table.columns, table.table_position, table.ball
    approach = columns.get('approach', np.zeros(0))
    for row in np.flatnonzero(np.abs(approach) > 1):
        raise table.wrong(row, 'approach', '1, -1 or 0 (unknown)', approach[row],
                          'it is the sense of the last move of the table, counter-clockwise 1')
    for name, falls, least, form in (('seq', np.less_equal, 'more than', 'd'), ('time_s', np.less, 'at least', '.12g')):
        values = columns.get(name, np.zeros(0))
        for row in np.flatnonzero(falls(np.diff(values), 0)):
            raise table.wrong(row + 1, name, f'{least} {values[row]:{form}}, the row before',
                              f'{values[row + 1]:{form}}',
                              'was the clock set back, as at the end of summer time? Write every time with its zone, '
                              'such as +02:00' if name == 'time_s' and table.begun is not None else
                              'rows stand in the order of measuring')
    order = np.lexsort((j, i))
    for again in np.flatnonzero((np.diff(i[order]) == 0) & (np.diff(j[order]) == 0)) if not table.repeats else ():
        first, second = order[again], order[again + 1]
        raise InvalidData(
            f'{table.source}: line {table.lines[second]}: expected each pair of table position and ball once, found '
            f'table_position {i[second]}, ball {j[second]} again (first in line {table.lines[first]}); remove one, or '
            'say "# repeated_balls: yes"')


def _check_rows(table: CsvTable, n: int) -> None:
    """Refuse what _check_order does, and CMM positions of other balls."""
    _check_order(table)
    i, j = table.table_position, table.ball
    wanted = cmm_position(n, i, j)
    given = table.columns.get('cmm_position', wanted)
    for row in np.flatnonzero(given != wanted):
        raise table.wrong(row, 'cmm_position', f'{wanted[row]} for table_position {i[row]}, ball {j[row]} of {n}: '
                          '(i + j - 2) mod n + 1', given[row], 'if there are more balls, say so by "# balls: ..."')


def _table_angles(table: CsvTable, n: int) -> Floats:
    """Return the table angles from that of position 1, nominal where the cell says no more than that, (N,), rad."""
    offset = float(np.rad2deg(table.table_offset))
    if 'table_angle_deg' not in table.columns:
        return 2 * np.pi * (table.table_position - 1) / n
    angle = table.columns['table_angle_deg'].astype(float, copy=False) - offset
    position = table.table_position - 1
    nominal = 360.0 * position / n
    deviation = _wrapped(angle - nominal)
    for row in np.flatnonzero(np.abs(deviation) > 180.0 / n):
        raise table.wrong(row, 'table_angle_deg', f'about {nominal[row] + offset:.6g} for table_position '
                          f'{position[row] + 1} of {n}', table.angle_cells[row].strip(),
                          _angle_advice(angle, nominal, n))
    if offset and abs(float(np.median(deviation))) > abs(offset) / 2:
        raise table.wrong(0, 'table_angle_deg', f'about {nominal[0] + offset:.6g}, as "# table_offset_deg: '
                          f'{offset:.6g}" says', table.angle_cells[0].strip(), 'correct what is wrong, or leave '
                          'the line out where table position 1 is at angle 0')
    turns = np.rint((angle - nominal) / 360.0)
    exact = 2 * np.pi * position / n
    exact = np.where(turns == 0, exact, exact + 2 * np.pi * turns)
    is_nominal: Bools = np.abs(deviation) <= 0.5 * _last_decimal(table.angle_cells) * (1 + 1e-6)
    return np.where(is_nominal, exact, np.deg2rad(angle))


def _wrapped(degrees: Floats) -> Floats:
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def _last_decimal(cells: Sequence[str]) -> Floats:
    """Return the value of the last written decimal of each number, (N,): 0.01 for 51.43."""
    texts = np.strings.lower(np.strings.strip(np.array(cells)))
    mantissa, _, exponent = np.strings.partition(texts, 'e')
    point = np.strings.find(mantissa, '.')
    decimals = np.where(point < 0, 0, np.strings.str_len(mantissa) - point - 1)
    return np.asarray(10.0 ** (np.where(exponent == '', '0', exponent).astype(float) - decimals))


def _angle_advice(angle: Floats, nominal: Floats, n: int) -> str:
    if np.all(np.abs(angle - np.deg2rad(nominal)) < 0.02):
        return 'these are radians; write degrees'
    if np.all(np.abs(_wrapped(angle + nominal)) <= 180.0 / n):
        return 'the table counts clockwise; table positions and angles count counter-clockwise'
    return 'is the number of balls right? If some are missing, say so by "# balls: ..."'


def _check_units(table: CsvTable, places: Floats, stated: str) -> None:
    """Refuse coordinates, and a radius that is `stated`, in another unit than the one in its name.

    places: (N, 3) of the balls in any frame, mm."""
    lies, wanted = (float(np.median(np.linalg.norm(one - one.mean(axis=0), axis=-1))) for one in (table.centre, places))
    radius = float(np.median(np.linalg.norm(places, axis=-1)))
    unit, factor = _unit(wanted / lies if lies else 0.0)
    if unit and (RADII[0] <= 1e-3 * radius <= RADII[1] or unit in ('cm', 'inch')):
        raise InvalidData(
            f'{table.source}: columns x_mm, y_mm, z_mm: expected ball centres on a circle of R = {radius:.6g} mm, as '
            f'{stated} says, found R = {radius * lies / wanted:.4g}; these are {unit}, of {factor:g} mm: name the '
            f'columns x_{unit}, y_{unit}, z_{unit}, or write millimetres')
    unit, factor = _unit(lies / wanted if wanted else 0.0)
    if unit:
        raise InvalidData(
            f'{table.source}: {stated}: expected about {radius * lies / wanted:.4g} mm, as far as the ball centres lie '
            f'from the axis, found {radius:.6g}; this is {unit}, of {factor:g} mm: write '
            f'{f"radius_{unit}, or " * (stated == "radius_mm")}millimetres')


def _unit(ratio: float) -> tuple[str, float]:
    """Return the unit other than mm that a ratio of lengths is about, '' if none, and what it is in mm."""
    return next(((unit, factor) for unit, factor in LENGTHS.items()
                 if factor != 1 and factor / _UNIT < ratio < factor * _UNIT), ('', 1.0))


def _check_places(table: CsvTable, n: int) -> None:
    """Refuse ball centres that lie nearer to another ball's place than to their own."""
    centre, radius = table.centre, table.radius * 1e3
    i, j = table.table_position, table.ball
    for row in misplaced(n, radius, i, j, centre):
        x, y, _ = nominal_places(n, radius, i, j)[row]
        raise table.wrong(
            row, 'x_mm, y_mm, z_mm', f'a place near ({x:.3f}, {y:.3f}, 0) for table_position {i[row]}, ball {j[row]}',
            f'({", ".join(f"{value:.3f}" for value in centre[row])})', 'coordinates stand in the table frame: z along '
            'the axis, ball 1 on +x at table position 1, counted counter-clockwise; say so by "# frame: machine" where '
            'they are those of the machine')


def _check_distance(table: CsvTable, plate: Plate, off: Floats) -> None:
    """Refuse ball centres that are further from their places than half of the way to the nearest other ball."""
    apart = np.linalg.norm(plate.centres[:, None] - plate.centres, axis=-1) + np.diag(np.full(plate.balls, np.inf))
    most = 500 * apart.min()
    distance = np.linalg.norm(off, axis=1)
    for row in np.flatnonzero(distance > most):
        raise table.wrong(
            row, 'x_mm, y_mm, z_mm', f'a place within {most:.3f} mm of that which table angle and plate file give',
            f'one {distance[row]:.3f} mm away', 'the plate file counts azimuths counter-clockwise from x at table '
            'angle 0, in the frame of the table')

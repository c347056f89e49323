# SPDX-License-Identifier: Apache-2.0
"""RUN as a joint evaluation takes it: with the table frame of a log, or with the plate file of a table."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rosette_ros.core.geometry import Floats, nominal_angles, rotate_z, wrap
from rosette_ros.core.joint.readings import Plate, Readings
from rosette_ros.io.ball_centre_table import MAX_BYTES, check_order, checked_plate, table_angles, to_table_frame
from rosette_ros.io.csv_parser import CsvTable
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import is_log, open_run, stated
from rosette_ros.io.text_file import read_limited

_PLATE_LINE = re.compile(rb'^"?#\s*plate\s*:', re.MULTILINE)
_HEAD = 1 << 16


def has_plate(path: str | Path) -> bool:
    """Return whether a path is a ball-centre table with a plate file; raises InvalidData where nothing is there."""
    if is_log(path):
        return False
    with open(path, 'rb') as stream:
        return bool(_PLATE_LINE.search(stream.read(_HEAD)))


def open_readings(path: str | Path, run_id: str | None = None) -> Readings:
    """Return the Readings of a log directory, an .mcap file or a CSV table, which may have a plate of any pitch.

    Raises InvalidData as open_run, and where plate file and table do not belong together."""
    if has_plate(path):
        return _with_plate(Path(path))
    run = open_run(path, run_id)
    return Readings.of(run, read_log(path).frame_of(run.run_id) if is_log(path) else None)


def joint_identity(paths: Sequence[str | Path], run_id: str | None = None, file: str | Path | None = None) -> tuple[
        Identity, tuple[str, ...]]:
    """Return what the logs of several runs and a file state together, and contradictions in words.

    Where two logs differ the first one counts, and the others contradict it."""
    logged, contradictions = Identity(), list[str]()
    for path in paths:
        if is_log(path):
            log = read_log(path)
            found = log.identity(log.run(run_id).run_id)
            contradictions += [f'{path}: {key}: {value!r}, {logged[key]!r} in the logs before'
                               for key, value in found.entries.items() if logged[key] not in ('', value)]
            logged = Identity({**found.entries, **logged.entries}, logged.tolerances or found.tolerances)
    identity, changed = stated(logged, file)
    return identity, (*contradictions, *changed)


def _with_plate(path: Path) -> Readings:
    table = CsvTable(read_limited(path, 'a table', MAX_BYTES), str(path))
    plate, positions = checked_plate(table)
    check_order(table)
    angle = table_angles(table, positions)
    every = nominal_angles(positions) + table.table_offset
    nominal = every[table.table_position - 1]
    places = 1e3 * rotate_z(nominal, plate.centres[table.ball - 1])
    notes = [table.notes] if table.notes else []
    if table.in_machine:
        to_table_frame(table, places)
        notes.append('the table frame was fitted to all readings')
    _check_distance(table, plate, table.centre - places)
    return Readings(plate, every, table.table_position, table.ball, table.centre / 1e3,
                    wrap(angle + table.table_offset - nominal),
                    table.columns.get('approach', np.zeros(table.ball.size)).astype(np.int64),
                    table.repeatability, table.repeatability_dof, None, table.run_id, str(path), tuple(notes),
                    table.simulated, table.rotation)


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

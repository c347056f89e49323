# SPDX-License-Identifier: Apache-2.0
"""RUN as the command line knows it: a log directory, an .mcap file or a CSV table, which may have a plate file."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.io import bag_metadata as bag
from rosette_ros.io.ball_centre_table import read_csv, read_with_plate
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.identity_file import Identity, read_identity
from rosette_ros.io.log_reader import MAGIC, read_log
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.own_readers import own_reader, read_own
from rosette_ros.io.reading_checks import is_in_seconds
from rosette_ros.io.text_file import reading

WANTED = 'a log directory, an .mcap file or a CSV table'
_PLATE_LINE = re.compile(rb'^"?#\s*plate\s*:', re.MULTILINE)
_HEAD = 1 << 16


def is_log(path: str | Path) -> bool:
    """Whether a path is a log: a directory, or a file that begins as MCAP does.

    Raises InvalidData where nothing is there, or it is something else that is known."""
    path = Path(path)
    with reading(path, WANTED):
        if path.is_dir():
            return True
        if path.exists() and not path.is_file():
            raise InvalidData(f'{path}: expected {WANTED}, found a device or a pipe; write it to a file first')
        with open(path, 'rb') as stream:
            begin = stream.read(512)
    if not begin:
        raise InvalidData(f'{path}: is empty; expected {WANTED}')
    if own_reader(path):
        return False
    bag.refuse_other(path, begin)
    return begin.startswith(MAGIC) or path.suffix == '.mcap'


def open_run(path: str | Path, run_id: str | None = None, columns_of: ColumnMap | None = None) -> Run:
    """Return the Run of a log directory, an .mcap file or a CSV table, recognised by its content.

    run_id chooses where a log holds several runs; columns_of: as of open_identified. Raises InvalidData where it is
    none of them, or a table holds another run than the one asked for."""
    return _open(path, run_id, columns_of)[0]


def open_identified(path: str | Path, run_id: str | None = None, file: str | Path | None = None,
                    columns_of: ColumnMap | None = None) -> tuple[Run, Identity, tuple[str, ...]]:
    """Return a Run, its Identity, and in words what a file states other than its log; raises as open_run.

    file: an identity file, whose entries take the place of those in the log; columns_of: what the columns of a table of
    another program are."""
    run, log = _open(path, run_id, columns_of)
    return run, *stated(log.identity(run.run_id) if log else Identity(), file)


def stated(logged: Identity, file: str | Path | None) -> tuple[Identity, tuple[str, ...]]:
    """Return what a log and an identity file state together, and their contradictions in words."""
    return logged.with_changes(read_identity(file)) if file else (logged, ())


def has_plate(path: str | Path) -> bool:
    """Return whether a path is a ball-centre table with a plate file; raises InvalidData where nothing is there."""
    if is_log(path):
        return False
    with open(path, 'rb') as stream:
        return bool(_PLATE_LINE.search(stream.read(_HEAD)))


def open_readings(path: str | Path, run_id: str | None = None, columns_of: ColumnMap | None = None) -> Readings:
    """Return the Readings of a log directory, an .mcap file or a CSV table, which may have a plate of any pitch.

    Raises InvalidData as open_run, and where plate file and table do not belong together."""
    if has_plate(path):
        return read_with_plate(path)
    run, log = _open(path, run_id, columns_of)
    return Readings.of(run, log.frame_of(run.run_id) if log else None)


def joint_identity(runs: Sequence[tuple[str | Path, str | None]], file: str | Path | None = None) -> tuple[
        Identity, tuple[str, ...]]:
    """Return what the logs of several runs, each with its run_id, and a file state together, and contradictions in
    words.

    Where two logs differ the first one counts, and the others contradict it."""
    logged, contradictions = Identity(), list[str]()
    for path, run_id in runs:
        if is_log(path):
            log = read_log(path)
            found = log.identity(log.run(run_id).run_id)
            contradictions += [f'{path}: {key}: {value!r}, {logged[key]!r} in the logs before'
                               for key, value in found.entries.items() if logged[key] not in ('', value)]
            logged = replace(logged if logged.tolerances else found, entries={**found.entries, **logged.entries})
    identity, changed = stated(logged, file)
    return identity, (*contradictions, *changed)


def _open(path: str | Path, run_id: str | None, columns_of: ColumnMap | None = None) -> tuple[Run, LogRun | None]:
    if is_log(path):
        log = read_log(path)
        return log.to_run(run_id), log
    run = read_own(read, path) if (read := own_reader(path)) else read_csv(path, columns_of)
    if run_id not in (None, run.run_id):
        raise InvalidData(f'{path}: expected run {run_id!r}, found {run.run_id!r}')
    # times in an unknown unit are none; a copy of the table keeps them
    return run if is_in_seconds(run.time) else run.replace(time=np.zeros(run.size)), None

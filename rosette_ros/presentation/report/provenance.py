# SPDX-License-Identifier: Apache-2.0
"""Where a run comes from: files and their hashes, when it was measured, with which software."""

import hashlib
import platform
from dataclasses import dataclass, field
from functools import cached_property
from importlib import metadata
from pathlib import Path

import numpy as np

from rosette_ros.core.planning.advice import scheme_of
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.invocation import __version__
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_run import LogRun
from rosette_ros.io.open_run import is_log, open_run, stated
from rosette_ros.io.text_file import regular
from rosette_ros.io.touch_log import refit_if_touched
from rosette_ros.presentation.formatting import instant

SOFTWARE = ('numpy', 'scipy', 'matplotlib', 'jinja2', 'mcap', 'rclpy', 'cyclonedds')
BESIDE = ('machine.yaml', 'cell.yaml')
"""Files of a log's folder with the configuration of the cell."""
LONGEST = 65536


@dataclass(frozen=True)
class FileDigest:
    """A file, its size in bytes and its SHA-256, hex."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Source:
    """Where a run comes from; begun, ended: first and last reading; order: as the cell named it; '' if none.

    until, asked: probability from which on a run that was measured until it is known is settled, 0 for any, and after
    how many readings it was asked; identity: who, what and where; contradictions: in words, what a file states other
    than the log; run_id: of the run.
    """

    path: str
    files: tuple[FileDigest, ...]
    begun: str = ''
    order: str = ''
    configuration: tuple[tuple[str, str], ...] = ()
    ended: str = ''
    identity: Identity = field(default_factory=Identity)
    contradictions: tuple[str, ...] = ()
    run_id: str | None = None
    until: float = 0.0
    asked: tuple[int, ...] = ()

    @cached_property
    def spheres(self) -> SphereRefit | None:
        """The spheres fitted to the touches in the log, read when first asked for; None where there are none."""
        return refit_if_touched(self.path, self.run_id)


def open_source(path: Path | str, run_id: str | None = None, file: Path | str | None = None,
                columns_of: ColumnMap | None = None) -> tuple[Run, Source]:
    """Return the Run and the Source of a log or a table; file, columns_of: as of `open_identified`; raises InvalidData
    as `open_run`."""
    if not is_log(path):
        run = open_run(path, run_id, columns_of)
        begun, ended = _first_and_last(run)
        return run, Source(str(path), (digest(path),), begun, ended=ended, identity=stated(Identity(), file)[0])
    log = read_log(path)
    run = log.to_run(run_id)
    return run, source_of(path, log, run, file)


def source_of(path: Path | str, log: LogRun, run: Run, file: Path | str | None = None) -> Source:
    """Return the Source of a run in a log that was read; path, file: as of open_source."""
    order = next((state.order for state in log.states if state.run_id == run.run_id), '')
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    beside = [(name, (folder / name).read_bytes()[:LONGEST].decode('utf-8', errors='replace'))
              for name in BESIDE if (folder / name).is_file()]
    until, asked = log.asked.get(run.run_id, (0.0, ()))
    entries = '\n'.join(f'{key}: {value}' for key, value in sorted(log.custom_data.items()))
    begun, ended = _first_and_last(run)
    return Source(str(path), tuple(map(digest, log.files)), begun, order,
                  (*beside, *([('entries of the log', entries)] if entries else [])), ended,
                  *stated(log.identity(run.run_id), file), run.run_id, until, tuple(asked))


def _first_and_last(run: Run) -> tuple[str, str]:
    """Return when the first and the last reading of a run were taken, in words, '' where it is not known."""
    if run.begun is None:
        return '', ''
    return instant(round(1e9 * run.begun)), instant(round(1e9 * (run.begun + float(np.ptp(run.time)))))


def digest(path: Path | str) -> FileDigest:
    """Return the FileDigest of a file."""
    try:
        with open(path, 'rb', opener=regular) as stream:
            found = hashlib.file_digest(stream, 'sha256').hexdigest()
            return FileDigest(str(path), stream.tell(), found)
    except OSError as error:
        raise InvalidData(f'{path}: cannot be read: {error.strerror}') from error


def software() -> tuple[tuple[str, str], ...]:
    """Return pairs (name, version) of the software that the numbers depend on."""
    found = [('rosette_ros', __version__), ('Python', platform.python_version())]
    for name in SOFTWARE:
        try:
            found.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            found.append((name, 'not installed'))
    return tuple(found)


def order_of(run: Run, source: Source | None = None) -> str:
    """Return the order in which a run was measured: as its cell named it, else as it is recognised."""
    turning = ', the table turning both ways' if np.any(run.approach < 0) else ''
    return f'{(source.order if source else "") or scheme_of(run).order}{turning}'

# SPDX-License-Identifier: Apache-2.0
"""Where a run comes from: files and their hashes, when it was measured, with which software."""

import hashlib
import platform
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import numpy as np

from rosette_ros import __version__
from rosette_ros.core.advice import scheme_of
from rosette_ros.core.errors import InvalidData
from rosette_ros.data.log_reader import read_log
from rosette_ros.data.open_run import is_log, open_run

SOFTWARE = ('numpy', 'scipy', 'matplotlib', 'jinja2', 'mcap', 'rclpy', 'cyclonedds')
BESIDE = ('machine.yaml', 'cell.yaml')
"""Files of a log's folder that say how the cell was set up."""
LONGEST = 65536


@dataclass(frozen=True)
class FileDigest:
    """A file, its size in bytes and its SHA-256, hex."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Source:
    """Where a run comes from.

    path: as it was given; files: FileDigest each; begun: first entry of the log, ISO 8601, '' if it is
    not known; order: as the cell named it, '' if it did not; configuration: pairs of a name and a text.
    """

    path: str
    files: tuple[FileDigest, ...]
    begun: str = ''
    order: str = ''
    configuration: tuple[tuple[str, str], ...] = ()


def open_source(path, run_id=None):
    """Return the Run and the Source of a log directory, an .mcap file or a CSV table.

    Raises InvalidData as `open_run` does.
    """
    if not is_log(path):
        return open_run(path, run_id), Source(str(path), (digest(path),))
    log = read_log(path)
    run = log.to_run(run_id)
    begun = datetime.fromtimestamp(log.start_ns * 1e-9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
    order = next((state.order for state in log.states if state.run_id == run.run_id), '')
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    beside = [(name, _text(folder / name)) for name in BESIDE if (folder / name).is_file()]
    entries = '\n'.join(f'{key}: {value}' for key, value in sorted(log.custom_data.items()))
    return run, Source(str(path), tuple(map(digest, log.files)), begun, order,
                       (*beside, *([('entries of the log', entries)] if entries else [])))


def digest(path):
    """Return the FileDigest of a file."""
    try:
        with open(path, 'rb') as stream:
            found = hashlib.file_digest(stream, 'sha256').hexdigest()
            return FileDigest(str(path), stream.tell(), found)
    except OSError as error:
        raise InvalidData(f'{path}: cannot be read: {error.strerror}') from error


def _text(path):
    with path.open('rb') as stream:
        return stream.read(LONGEST).decode('utf-8', errors='replace')


def software():
    """Return pairs (name, version) of all that the numbers rest on."""
    found = [('rosette_ros', __version__), ('Python', platform.python_version())]
    for name in SOFTWARE:
        try:
            found.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            found.append((name, 'not installed'))
    return tuple(found)


def order_of(run, source=None):
    """Return the order in which a run was measured: as its cell said, else as it is recognised."""
    scheme = scheme_of(run)
    turning = ', the table turning both ways' if np.any(run.approach < 0) else ''
    return f'{(source.order if source else "") or scheme.order}{turning}'

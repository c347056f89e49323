# SPDX-License-Identifier: Apache-2.0
"""RUN as the command line knows it: a log directory, an .mcap file or a CSV table."""

from pathlib import Path

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.csv_table import read_csv
from rosette_ros.data.log_reader import read_log
from rosette_ros.data.mcap_scan import MAGIC

_SQLITE = b'SQLite format 3\0'
_ZSTANDARD = b'\x28\xb5\x2f\xfd'


def is_log(path):
    """Whether a path is a log: a directory, or a file that begins as MCAP does.

    Raises InvalidData where nothing is there, or it is something else that is known.
    """
    path = Path(path)
    try:
        if path.is_dir():
            return True
        if path.exists() and not path.is_file():
            raise InvalidData(f'{path}: wanted a log directory, an .mcap file or a CSV table, got a device or a '
                              'pipe; write it to a file first')
        with open(path, 'rb') as stream:
            begin = stream.read(16)
    except OSError as error:
        raise InvalidData(f'{path}: wanted a log directory, an .mcap file or a CSV table, got '
                          f'{error.strerror}; check the path and its rights') from error
    if not begin:
        raise InvalidData(f'{path}: is empty; wanted a log directory, an .mcap file or a CSV '
                          'table')
    if begin.startswith(_SQLITE):
        raise InvalidData(f'{path}: is an sqlite3 log; wanted MCAP: convert it with '
                          '`ros2 bag convert`')
    if begin.startswith(_ZSTANDARD):
        raise InvalidData(f'{path}: is a compressed file; wanted a log: unpack it with `zstd -d`')
    return begin.startswith(MAGIC) or path.suffix == '.mcap'


def open_run(path, run_id=None):
    """Return the Run of a log directory, an .mcap file or a CSV table, told by its content.

    run_id chooses where a log holds several runs. Raises InvalidData where it is none of them, or
    a table holds another run than the one asked for.
    """
    if is_log(path):
        return read_log(path).to_run(run_id)
    run = read_csv(path)
    if run_id not in (None, run.run_id):
        raise InvalidData(f'{path}: wanted run {run_id!r}, got {run.run_id!r}')
    return run

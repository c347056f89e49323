# SPDX-License-Identifier: Apache-2.0
"""Writing a log from what is known already: all of it, or nothing."""

import contextlib
import glob
from pathlib import Path

from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.data.bag_metadata import FILE_NAME
from rosette_ros.data.log_writer import LogWriter


@contextlib.contextmanager
def whole_log(directory, name, **options):
    """Open a LogWriter with its options; where the log cannot be written to its end, no file of it is left.

    Raises InvalidData where the directory holds a log, CellError where the disk refuses.
    """
    directory = Path(directory)
    was_there, writer = directory.is_dir(), None
    try:
        writer = LogWriter(directory, name, **options)
        with writer:
            yield writer
    except BaseException as error:
        if writer is None and isinstance(error, InvalidData):
            raise  # nothing was begun: the directory holds the log of somebody else
        _take_back(directory, name, was_there)
        if isinstance(error, CellError) and isinstance(error.__cause__, OSError):
            raise CellError(f'{directory}: cannot write the log: {error.__cause__.strerror}; make room and try again, '
                            'nothing of it was kept') from error
        raise


def _take_back(directory, name, was_there):
    """Remove the files of a log that was begun, and its folder unless it was there before."""
    with contextlib.suppress(OSError):
        for pattern in (f'{glob.escape(name)}_*.mcap*', f'{FILE_NAME}*'):
            for path in directory.glob(pattern):
                path.unlink()
        if not was_there:
            directory.rmdir()

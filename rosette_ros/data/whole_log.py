# SPDX-License-Identifier: Apache-2.0
"""Writing a log from what is known already: all of it, or nothing."""

import contextlib
from pathlib import Path

from rosette_ros.core.errors import CellError
from rosette_ros.data.log_writer import LogWriter


@contextlib.contextmanager
def whole_log(directory, name, **options):
    """Open a LogWriter with its options; where the log cannot be written to its end, nothing of it is left.

    Raises InvalidData where the directory holds a log, CellError where the disk refuses.
    """
    directory = Path(directory)
    before = set(directory.iterdir()) if directory.is_dir() else None
    try:
        with LogWriter(directory, name, **options) as writer:
            yield writer
    except BaseException as error:
        _take_back(directory, before)
        if isinstance(error, CellError) and isinstance(error.__cause__, OSError):
            raise CellError(f'{directory}: cannot write the log: {error.__cause__.strerror}; make room and try again, '
                            'nothing of it was kept') from error
        raise


def _take_back(directory, before):
    """Remove what was not there before; before: paths in the directory, None where there was no directory."""
    with contextlib.suppress(OSError):
        for path in directory.iterdir():
            if path not in (before or ()):
                path.unlink()
        if before is None:
            directory.rmdir()

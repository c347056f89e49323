# SPDX-License-Identifier: Apache-2.0
"""Files that a person gives and gets: refusals in words, text written as a whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from rosette_ros.core.errors import InvalidData, RosetteError


@contextlib.contextmanager
def reading(path: str | Path, wanted: str, kind: type[RosetteError] = InvalidData) -> Iterator[None]:
    """Turn what the system refuses while `wanted`, such as `a log`, is read into an error of a kind."""
    try:
        yield
    except OSError as error:
        raise kind(f'{path}: wanted {wanted} that can be read, got {error.strerror}; check the path and its '
                   'rights') from error


def read_limited(path: str | Path, wanted: str, most: int, kind: type[RosetteError] = InvalidData) -> bytes:
    """Return the bytes of a file; raises an error of a kind where it cannot be read or has more than `most` bytes."""
    with reading(path, wanted, kind), open(path, 'rb') as stream:
        data = stream.read(most + 1)
    if len(data) > most:
        raise kind(f'{path}: wanted {wanted} of at most {most} bytes, got more')
    return data


def refuse_existing(path: str | Path, force: bool = False) -> None:
    """Raise InvalidData where a file exists already and `force` is not set."""
    if Path(path).exists() and not force:
        raise InvalidData(f'{path}: exists already; take another name or use --force')


def write_text(path: str | Path, text: str, force: bool = False) -> None:
    """Write a text file as a whole or not at all.

    Raises InvalidData where one exists already and `force` is not set, or it cannot be written.
    """
    path = Path(path)
    beside = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        refuse_existing(path, force)
        if path.exists() and not path.is_file():
            path.write_text(text, encoding='utf-8')  # a device or a pipe cannot be replaced
            return
        beside.write_text(text, encoding='utf-8', newline='')
        beside.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise InvalidData(f'{path}: cannot be written: {error.strerror}') from error

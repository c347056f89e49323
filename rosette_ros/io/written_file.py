# SPDX-License-Identifier: Apache-2.0
"""A file that is written once, and whether the disk still holds what was written."""

import contextlib
import io
import os
import zlib
from pathlib import Path
from typing import Any

from rosette_ros.io.text_file import give_name


class WrittenFile(io.FileIO):
    """A new file: bytes are added at its end alone, so that one that was cut is shorter than what was written.

    path: its name now. Raises FileExistsError where there is one of that name."""

    def __init__(self, path: Path) -> None:
        """Create the file."""
        super().__init__(path, 'ab', opener=lambda name, flags: os.open(name, flags | os.O_EXCL, 0o666))
        self.path, self._size = path, 0
        self._sum: int | None = 0
        self._identity = _identity(os.fstat(self.fileno()))

    def write(self, data: Any) -> int:
        """Write bytes and add them to the checksum."""
        written = super().write(data)
        self._size += written
        if self._sum is not None:
            self._sum = zlib.crc32(memoryview(data)[:written], self._sum)
        return written

    def truncate(self, size: int | None = None) -> int:
        """Cut the file; its checksum is then no longer known."""
        self._size, self._sum = super().truncate(size), None
        return self._size

    def rename(self, path: Path) -> None:
        """Give the file its final name; raises FileExistsError where there is one of that name."""
        give_name(self.path, path)
        self.path = path

    def remove(self) -> None:
        """Delete the file, unless another one has its name now."""
        with contextlib.suppress(OSError):
            if _identity(os.stat(self.path)) == self._identity:
                self.path.unlink()

    def damage(self, is_whole: bool = False) -> str:
        """Return how the file on the disk differs from what was written, '' where it does not.

        is_whole: whether its bytes are read, too."""
        try:
            status = os.stat(self.path)
            if _identity(status) != self._identity:
                return f'{self.path.name} was replaced by another file'
            if status.st_size != self._size:
                return f'{self.path.name} has {status.st_size} bytes, {self._size} were written'
            if is_whole and self._sum is not None and _sum(self.path) != self._sum:
                return f'{self.path.name} holds other bytes than were written'
        except FileNotFoundError:
            return f'{self.path.name} was deleted'
        except OSError as error:
            return f'{self.path.name} cannot be read: {error.strerror}'
        return ''


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _sum(path: Path) -> int:
    value = 0
    with open(path, 'rb') as stream:
        while data := stream.read(1 << 20):
            value = zlib.crc32(data, value)
    return value

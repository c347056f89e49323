# SPDX-License-Identifier: Apache-2.0
"""Logs in folders, on this computer or behind a URL that fsspec knows: where they are, and what is in them."""

import hashlib
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec

from rosette_ros.archive.run_archive import MARK
from rosette_ros.core.errors import InvalidData
from rosette_ros.io.bag_metadata import FILE_NAME as METADATA
from rosette_ros.io.bag_metadata import is_hidden, is_one_log
from rosette_ros.io.log_reader import holds_log
from rosette_ros.io.text_file import is_regular

_STAMPED = ('size', 'mtime', 'created', 'LastModified', 'last_modified', 'ETag', 'etag')
"""What file systems say of a file that changes when its content does."""


@dataclass(frozen=True)
class FoundLog:
    """A log: path: of its directory or file, absolute, or a URL; files: those with its content, in the order of their
    names; stamp: their sizes and times."""

    path: str
    files: tuple[str, ...]
    stamp: str

    def digest(self) -> str:
        """Return the SHA-256 of the content, hex: of the one file, else of the digests of all; raises OSError."""
        each = []
        for file in self.files:
            with fsspec.open(file, 'rb') as stream:
                each.append(hashlib.file_digest(stream, 'sha256'))
        return each[0].hexdigest() if len(each) == 1 else hashlib.sha256(b''.join(
            one.digest() for one in each)).hexdigest()

    @contextmanager
    def local(self) -> Iterator[Path]:
        """Give the path of the log on this computer: its own, or that of a copy for as long as it is used."""
        if '://' not in self.path:
            yield Path(self.path)
            return
        system, root = fsspec.url_to_fs(self.path)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder, PurePosixPath(root).name)
            wanted = [fsspec.url_to_fs(file)[1] for file in self.files]
            if wanted == [root]:
                system.get_file(root, str(copy))
            else:
                copy.mkdir()
                more = [f'{root}/{METADATA}'] if system.exists(f'{root}/{METADATA}') else []
                for file in (*wanted, *more):
                    system.get_file(file, str(copy / PurePosixPath(file).name))
            yield copy


def find_logs(places: Iterable[str]) -> list[FoundLog]:
    """Return the logs in folders and all that is below them, each once; a place may be a log itself.

    A directory with a metadata.yaml, with .mcap files that rosbag2 has numbered or, on this computer, with those of one
    run that follow each other, is one log; other .mcap files and all .csv files are one each. What is hidden, in the
    trash, or no file is none. Raises InvalidData where nothing is, where an archive is, or where a URL needs a driver.
    """
    found: dict[str, FoundLog] = {}
    for place in places:
        try:
            system, root = fsspec.url_to_fs(place)
            files: dict[str, Mapping[str, Any]] = system.find(root, detail=True)
            if not files and not system.exists(root):
                raise FileNotFoundError(2, 'no such file or folder')
        except (OSError, ValueError, ImportError) as error:
            words = (isinstance(error, OSError) and error.strerror) or ' '.join(str(error).split())
            raise InvalidData(f'{place}: wanted a folder of logs, or a log, got: {words}') from error
        if f'{root}/{MARK}' in files:
            raise InvalidData(f'{place}: wanted a folder of logs, or a log, got an archive')
        is_local = 'file' in ((system.protocol,) if isinstance(system.protocol, str) else system.protocol)
        kept = [path for path, facts in files.items()
                if not any(map(is_hidden, path.removeprefix(root).split('/')))
                and (facts['type'] == 'file' or (is_local and is_regular(Path(path))))]
        if root in files and not kept:
            raise InvalidData(f'{place}: wanted a folder of logs, or a log, got a device, a pipe or a hidden file')
        for path, inside in _grouped(root, kept, is_local):
            if any('\ud800' <= sign <= '\udfff' for sign in path):
                raise InvalidData(f'{path}: wanted a name in UTF-8, got another one; rename it')
            names = [file if is_local else system.unstrip_protocol(file) for file in (path, *inside)]
            stamp = ' '.join(f'{files[file][key]}' for file in inside for key in _STAMPED if key in files[file])
            found.setdefault(names[0], FoundLog(names[0], tuple(names[1:]), stamp))
    return list(found.values())


def _grouped(root: str, files: list[str], is_local: bool) -> Iterator[tuple[str, list[str]]]:
    """Yield the path of each log and the files of its content."""
    if files == [root]:
        yield root, files
        return
    folders = defaultdict[PurePosixPath, list[PurePosixPath]](list)
    for path in map(PurePosixPath, sorted(files)):
        folders[path.parent].append(path)
    for folder, inside in folders.items():
        packed = [path for path in inside if path.match('*.mcap.zst*') and path.with_suffix('') not in inside]
        logs = [path for path in inside if path.suffix == '.mcap'] + packed
        is_one = is_one_log([*(path.name for path in inside), *(path.stem for path in packed)]) or (
            is_local and holds_log(Path(folder)))
        if is_one:  # where its files are missing, it is a log that cannot be read
            yield str(folder), list(map(str, logs or [folder / METADATA]))
        for path in inside:
            if path.suffix == '.csv' or (path in logs and not is_one):
                yield str(path), [str(path)]

# SPDX-License-Identifier: Apache-2.0
"""Files that a person gives and gets: refusals in words, written as a whole or not at all."""

import contextlib
import errno
import logging
import os
import re
import secrets
import stat
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.typed_words import as_typed

NO_FILE = 'a device or a pipe'
READ_IN_FOLDERS = ('*.mcap', 'metadata.yaml', 'rosette-archive.json', '*/*.parquet')
"""What is read of a log and of an archive."""
_DRIVE = re.compile(r'^/([A-Za-z]:[/\\])')
_ADDRESS = re.compile(r'(file|local):(//(localhost)?(?=/)|(?=/(?!/)))')


def path_of(text: str) -> str:
    """Return the path on this computer that a text means: a file:/// address is decoded, `~/` is the user's home."""
    found = _ADDRESS.match(text)
    if found:
        return _DRIVE.sub(r'\1', unquote(text[found.end():]))
    return os.path.expanduser(text) if re.match(r'~([/\\]|$)', text) else text


@contextlib.contextmanager
def reading(path: str | Path, wanted: str, kind: type[RosetteError] = InvalidData) -> Iterator[None]:
    """Turn what the system refuses while `wanted`, such as `a log`, is read into an error of a kind."""
    try:
        yield
    except OSError as error:
        raise kind(f'{path}: expected {wanted} that can be read, found {error.strerror}; check the path and its '
                   'rights') from error


def regular(path: str | Path, flags: int) -> int:
    """Open a file, as `opener` of open(), and wait for nobody; raises OSError where it is a device or a pipe."""
    if not stat.S_ISREG(mode := os.stat(path).st_mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.ENODEV, NO_FILE, str(path))
    return os.open(path, flags | getattr(os, 'O_NONBLOCK', 0))  # no system without it has pipes among files


def is_regular(path: Path) -> bool:
    """Return whether a name found in a folder is that of a file; a device or a pipe is named once, in a warning."""
    if not (is_file := path.is_file()) and path.exists() and not path.is_dir():
        _name_left_out(path)
    return is_file


@cache
def _name_left_out(path: Path) -> None:
    logging.getLogger(__name__).warning('%s: left out: expected a file, found %s', path, NO_FILE)


def read_limited(path: str | Path, wanted: str, most: int, kind: type[RosetteError] = InvalidData) -> bytes:
    """Return the bytes of a file, `~/` being the home of the user, unless there is a folder of that name.

    Raises an error of a kind where it cannot be read or has more than `most` bytes."""
    file = path if os.path.exists(path) else os.path.expanduser(path)
    with reading(path, wanted, kind), open(file, 'rb', opener=regular) as stream:
        data = stream.read(most + 1)
    if len(data) > most:
        raise kind(f'{path}: expected {wanted} of at most {most} bytes, found more')
    return data


def bare_name(path: str | Path) -> str:
    """Return the name of a file without its suffix, or that of a folder, in which a dot ends nothing."""
    full = Path(path).absolute()
    return full.name if full.is_dir() else full.stem


def exists_words() -> str:
    """Return what is wrong with a name that is taken, and what to do."""
    return f'exists already; take another name or use {as_typed("--force", "force=True")}'


def refuse_existing(path: str | Path, force: bool = False) -> None:
    """Raise InvalidData where a file exists already and `force` is not set."""
    if Path(path).exists() and not force:
        raise InvalidData(f'{path}: {exists_words()}')


def refuse_output(path: str | Path, force: bool = False) -> None:
    """Raise InvalidData before any work where a file exists already and `force` is not set, or its folder does not."""
    refuse_existing(path, force)
    if not (folder := Path(path).parent).is_dir():
        raise InvalidData(f'{path}: expected a name in a folder that exists, found none; make {folder} first')


def refuse_read(path: str | Path, read: Iterable[str | Path]) -> None:
    """Raise InvalidData where a file to write is one of those that are read, or of a log or an archive among them."""
    for one in read if os.path.isfile(path) else ():
        inside = [file for pattern in READ_IN_FOLDERS for file in Path(one).glob(pattern)] if os.path.isdir(one) else []
        if any(os.path.isfile(file) and os.path.samefile(path, file) for file in (one, *inside)):
            raise InvalidData(f'{path}: is read by this command; take another name for what it writes')


def write_text(path: str | Path, text: str, force: bool = False) -> None:
    """Write a text file as `write_bytes` does; names of files in it that are no UTF-8 have `?` in them."""
    write_bytes(path, text.encode(errors='replace'), force)


def write_bytes(path: str | Path, data: bytes, force: bool = False) -> None:
    """Write a file as a whole or not at all; one that is replaced keeps its mode, and links to it.

    Raises InvalidData where one exists already and `force` is not set, or it cannot be written."""
    try:
        refuse_existing(path, force)
        if Path(path).exists() and not Path(path).is_file():
            Path(path).write_bytes(data)  # a device or a pipe cannot be replaced
        else:
            replace_file(path, data, force)
    except OSError as error:
        exists = isinstance(error, FileExistsError)
        raise InvalidData(f'{path}: {exists_words() if exists else f"cannot be written: {error.strerror}"}') from error


def replace_file(path: str | Path, data: bytes, force: bool = True) -> None:
    """Bring a whole file to the disk in place of another one, or, without `force`, where there is none.

    A killed writer or a full disk leaves the old one. Raises OSError; FileExistsError without `force`."""
    target = Path(os.path.realpath(path))
    beside = target.with_name(f'.{secrets.token_hex(8)}.part')
    try:
        with open(beside, 'xb') as stream:
            if force and target.exists():
                beside.chmod(stat.S_IMODE(target.stat().st_mode))
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        if force:
            beside.replace(target)
        else:
            give_name(beside, target)
        synchronise_folder(target.parent)
    finally:
        beside.unlink(missing_ok=True)


def remove_file(path: Path) -> None:
    """Delete a file, if there is one, so that it stays deleted when the power ends. Raises OSError."""
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
        synchronise_folder(path.parent)


def give_name(path: Path, name: Path) -> None:
    """Rename a file; raises FileExistsError where there is one of the new name."""
    try:
        os.link(path, name)
        path.unlink()
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        # A file system without hard links.
        name.touch(exist_ok=False)
        path.replace(name)


def synchronise_folder(directory: Path) -> None:
    """Bring the names in a folder to the disk: a file of which only the content is there is lost without power."""
    if not hasattr(os, 'O_DIRECTORY'):  # a system whose file system does so by itself
        return
    folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)

# SPDX-License-Identifier: Apache-2.0
"""Adding logs of folders or URLs to an archive: what is new is evaluated and diagnosed, and written in batches.

Files whose size and time are known are not read; a log whose content is known is not evaluated. What an interrupted
addition has written stays, and the next one goes on from there."""

import datetime
import hashlib
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, Protocol, TypeVar

import fsspec

from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, find
from rosette_ros.archive.run_archive import MARK, RunArchive
from rosette_ros.archive.run_row import STATED, Row, evaluation_row, heading
from rosette_ros.archive.stored_causes import causes_text
from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.joint.run_causes import causes_in
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, RosetteError, one_line
from rosette_ros.core.run.records import Run
from rosette_ros.core.uncertainty.stated_environment import Environment
from rosette_ros.invocation import __version__
from rosette_ros.io.bag_metadata import FILE_NAME as METADATA
from rosette_ros.io.bag_metadata import is_hidden, is_one_log
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import holds_log, read_log
from rosette_ros.io.log_run import PROBE_TARGET, LogRun
from rosette_ros.io.open_run import is_log
from rosette_ros.io.text_file import is_regular
from rosette_ros.presentation.report.provenance import Source, open_source, source_of

TOGETHER = 32
"""Logs whose content is identified in one task: that of a log takes under a millisecond."""
BATCH_ROWS, BATCH_SECONDS = 2000, 20.0
"""Rows are written when there are so many, or after so long."""
KILLED = 'the process that evaluated it was killed again and again, maybe because the computer has too little memory'
Item = TypeVar('Item')
Outcome = TypeVar('Outcome')
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
        for file in self.files:  # two colons in the name of a local file are no chain of URLs
            with fsspec.open(file, 'rb') if '://' in file else open(file, 'rb') as stream:
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


Digest = tuple[FoundLog, str, str]
"""A log, the SHA-256 of its content, '' where it could not be read, and why it could not."""


class Engine(Protocol):
    """Applies a function to items."""

    def results(self, function: Callable[[Item], Outcome], items: Iterable[Item]) -> Iterator[
            tuple[Item, Outcome | None]]:
        """Yield each item with its result, in any order; None where the process that worked on it was killed."""


@dataclass(frozen=True)
class Added:
    """What an addition did, in logs: found; new: neither file nor content known before; copies: content known;
    evaluated and with problems, of the new ones."""

    found: int = 0
    new: int = 0
    copies: int = 0
    evaluated: int = 0
    problems: int = 0


def add_logs(archive: RunArchive, logs: Sequence[FoundLog], engine: Engine, model: Model | None = None,
             identity: Identity | None = None, force: bool = False, keep_identity: bool = False,
             on_progress: Callable[[Added, int], object] = lambda added, left: None,
             environment: Environment | None = None) -> Added:
    """Evaluate the logs that an archive does not hold under a model and this version, and write their rows.

    identity: stated in place of what logs state; force: evaluate all again; keep_identity: runs that the archive knows
    under another model keep what is stated there; on_progress: called after each log with what was Added so far, and
    how many are left; environment: that is stated. Raises InvalidData where the archive cannot be written."""
    model = model or Model()
    archive.check_writable()
    known = archive.read_rows(('path', 'stamp', 'log_sha256'), "model_hash = ? AND version = ? AND log_sha256 <> ''",
                              (model.hash, __version__)).to_pydict()
    places = set() if force else set(zip(known['path'], known['stamp'], strict=True))
    contents = set() if force else set(known['log_sha256'])
    fresh = [log for log in logs if (log.path, log.stamp) not in places]
    added = Added(found=len(logs))
    rows, written = list[Row](), time.monotonic()

    def to_evaluate() -> Iterator[Digest]:
        nonlocal added
        chunks = (fresh[begin:begin + TOGETHER] for begin in range(0, len(fresh), TOGETHER))
        for chunk, found in engine.results(digests, chunks):
            for log, digest, problem in found or [(log, '', KILLED) for log in chunk]:
                if digest in contents:
                    added = replace(added, copies=added.copies + 1)
                    on_progress(added, len(fresh) - added.new - added.copies)
                else:
                    contents.update({digest} - {''})
                    yield log, digest, problem
    try:
        for (log, *_), made in engine.results(partial(rows_of, model=model, identity=identity,
                                                        environment=environment), to_evaluate()):
            made = made or [heading('', log.path, log.stamp, model, _now(), problem=KILLED)]
            is_bad = any(row['problem'] for row in made)
            added = replace(added, new=added.new + 1, evaluated=added.evaluated + (not is_bad),
                            problems=added.problems + is_bad)
            rows += made
            on_progress(added, len(fresh) - added.new - added.copies)
            if len(rows) >= BATCH_ROWS or time.monotonic() - written > BATCH_SECONDS:
                batch, rows, written = rows, [], time.monotonic()
                archive.add(_with_stated(archive, batch) if keep_identity else batch)
    finally:
        if rows:
            archive.add(_with_stated(archive, rows) if keep_identity else rows)
    archive.join_small()
    return added


def _with_stated(archive: RunArchive, rows: Sequence[Row]) -> list[Row]:
    """Return rows with what the newest row of the same run states in an archive, where it holds one."""
    known = archive.query(f"SELECT log_sha256, run_id, {', '.join(STATED)} FROM runs WHERE problem = '' AND "
                          'list_contains(?, log_sha256) ORDER BY added_at',
                          ([row['log_sha256'] for row in rows],)).to_pylist()
    stated = {(row['log_sha256'], row['run_id']): {name: row[name] for name in STATED} for row in known}
    return [row if row['problem'] else {**row, **stated.get((row['log_sha256'], row['run_id']), {})} for row in rows]


def digests(logs: Iterable[FoundLog]) -> list[Digest]:
    """Return the Digest of each log."""
    found = list[Digest]()
    for log in logs:
        try:
            found.append((log, log.digest(), ''))
        except OSError as error:
            found.append((log, '', f'expected a log that can be read, found: {error.strerror or error}; logs have to '
                                   'be where the workers find them by the same path'))
    return found


def rows_of(digest: Digest, model: Model, identity: Identity | None = None,
            environment: Environment | None = None) -> list[Row]:
    """Return the rows of a log: one for each of its runs, or one that says why there is none."""
    log, content, problem = digest
    now = _now()
    head = partial(heading, content, log.path, log.stamp, model, now)
    if problem:
        return [head(problem=problem)]
    rows = list[Row]()
    try:
        with log.local() as path:
            for run_id, open_one, cell in _runs(str(path)):
                try:
                    run, source = open_one()
                    found = find(run, model) if run.n <= MOST_BALLS_JUDGED else None
                    causes = causes_text(causes_in(search_of(run, model))) if found else None
                    rows.append({**head(run_id=run.run_id), **evaluation_row(
                        analyse(run, model), found, source, cell, identity, environment, causes)})
                except RosetteError as error:
                    rows.append(head(run_id=run_id, problem=_words(error, path)))
    except RosetteError as error:
        rows.append(head(problem=_words(error, path)))
    except Exception as error:  # one log must not end the evaluation of all others; its row tells
        rows.append(head(problem=f'an error of the program, please report it: {one_line(error)}'))
    return rows


def _runs(path: str) -> Iterator[tuple[str, Callable[[], tuple[Run, Source]], str]]:
    """Yield the run_id of each run of a log or table, what opens it, and the namespace of its cell."""
    if not is_log(path):
        yield '', partial(open_source, path), ''
        return
    log = read_log(path)
    cell = next((topic.name.rpartition('/')[0].strip('/') for topic in log.topics if topic.type_name == PROBE_TARGET),
                '')
    for run_id in log.run_ids or ('',):
        yield run_id, partial(_opened, path, log, run_id or None), cell


def _opened(path: str, log: LogRun, run_id: str | None) -> tuple[Run, Source]:
    run = log.to_run(run_id)
    return run, source_of(path, log, run)


def _words(error: RosetteError, path: Path) -> str:
    """Return the words of an error without the path of the log, which the row has in a column of its own."""
    return one_line(error).removeprefix(f'{path}: ').replace(str(path), path.name)


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def find_logs(places: Iterable[str]) -> list[FoundLog]:
    """Return the logs in folders and all that is below them, each once; a place may be a log itself.

    A directory with a metadata.yaml, with .mcap files that rosbag2 has numbered or, on this computer, with those of one
    run that follow each other, is one log; other .mcap files and all .csv files are one each. What is hidden, in the
    trash, or no file is none. Raises InvalidData where nothing is, where an archive is, or where a URL needs a driver.
    """
    found: dict[str, FoundLog] = {}
    for place in places:
        try:
            is_here = '://' not in place and Path(place).exists()
            system, root = (fsspec.filesystem('file'), os.path.abspath(place)) if is_here else (
                fsspec.url_to_fs(place))
            files: dict[str, Mapping[str, Any]] = system.find(root, detail=True)
            if not files and not system.exists(root):
                raise FileNotFoundError(2, 'no such file or folder')
        except (OSError, ValueError, ImportError) as error:
            words = (isinstance(error, OSError) and error.strerror) or ' '.join(str(error).split())
            raise InvalidData(f'{place}: expected a folder of logs, or a log, found: {words}') from error
        if f'{root}/{MARK}' in files:
            raise InvalidData(f'{place}: expected a folder of logs, or a log, found an archive')
        is_local = 'file' in ((system.protocol,) if isinstance(system.protocol, str) else system.protocol)
        kept = [path for path, facts in files.items()
                if not any(map(is_hidden, path.removeprefix(root).split('/')))
                and (facts['type'] == 'file' or (is_local and is_regular(Path(path))))]
        if root in files and not kept:
            raise InvalidData(f'{place}: expected a folder of logs, or a log, found a device, a pipe or a hidden file')
        for path, inside in _grouped(root, kept, is_local):
            if any('\ud800' <= sign <= '\udfff' for sign in path):
                raise InvalidData(f'{path}: expected a name in UTF-8, found another one; rename it')
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

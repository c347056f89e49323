# SPDX-License-Identifier: Apache-2.0
"""Adding logs to an archive: what is new is evaluated and diagnosed, and written in batches.

Files whose size and time are known are not read; a log whose content is known is not evaluated. What an interrupted
addition has written stays, and the next one goes on from there."""

import datetime
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from rosette_ros import __version__
from rosette_ros.analysis import MOST_BALLS_JUDGED, analyse, find
from rosette_ros.archive.log_finder import FoundLog
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import STATED, Row, evaluation_row, heading
from rosette_ros.core.errors import RosetteError, one_line
from rosette_ros.core.model.model import Model
from rosette_ros.core.records import Run
from rosette_ros.core.stated_environment import Environment
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_run import PROBE_TARGET, LogRun
from rosette_ros.io.open_run import is_log
from rosette_ros.presentation.report.provenance import Source, open_source, source_of

TOGETHER = 32
"""Logs whose content is identified in one task: that of a log takes under a millisecond."""
BATCH_ROWS, BATCH_SECONDS = 2000, 20.0
"""Rows are written when there are so many, or after so long."""
KILLED = 'the process that evaluated it was killed again and again, maybe because the computer has too little memory'

Digest = tuple[FoundLog, str, str]
"""A log, the SHA-256 of its content, '' where it could not be read, and why it could not."""


Item = TypeVar('Item')
Outcome = TypeVar('Outcome')


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
            found.append((log, '', f'wanted a log that can be read, got: {error.strerror or error}; logs have to '
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
                    rows.append({**head(run_id=run.run_id),
                                 **evaluation_row(analyse(run, model), found, source, cell, identity, environment)})
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

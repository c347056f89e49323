# SPDX-License-Identifier: Apache-2.0
"""An archive on the disk: a folder of Parquet files that are written whole, never changed, and replaced by larger ones.

    ARCHIVE/rosette-archive.json    what it is, and in which version of the format
    ARCHIVE/parts/NAME.parquet      some rows each

Several writers need no lock: each writes files of its own, under names that no other has. What counts where a run was
added twice is decided when rows are read (`ROWS`). A file is removed only after one that holds its rows is on the disk.
"""

import datetime
import io
import json
import logging
import os
import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from rosette_ros.archive.run_row import KEY, OF_EVERY_ROW, SCHEMA, table_of
from rosette_ros.core.run.errors import InvalidData, counted
from rosette_ros.io.text_file import is_regular, path_of, read_limited, reading, write_bytes, write_text

FORMAT = 'rosette-archive/1'
MARK, PARTS = 'rosette-archive.json', 'parts'
LARGE = 20_000
"""Rows of a file that is not joined with others any more: about 60 MB of runs of 12 balls."""
MOST_SMALL, MOST_ROWS = 64, 1_000_000
"""Smaller files than that are joined where there are more; a part of more rows is none that was written here."""
WRONG_CLOCK = datetime.timedelta(days=1)
"""Computers that write into an archive may differ by so much."""
ROW_GROUP = 1000
"""Rows that a query reads at least, of one table mostly: joined files are sorted by table and time."""
ROWS = f'''
    SELECT * FROM parts
    QUALIFY row_number() OVER (PARTITION BY {", ".join(KEY)}, CASE WHEN problem <> '' THEN path END
                               ORDER BY added_at DESC, version DESC) = 1
        AND (problem = '' OR added_at = max(added_at) OVER (PARTITION BY path, model_hash))'''
"""The rows that count: of each run under each model the last; a problem until its file could be read."""


def local_folder(name: str | Path) -> Path:
    """Return the absolute path of a folder on this computer; `~` and file:/// are read.

    Raises InvalidData for other URLs, and for host:/folder where no folder has that name: a folder `s3:` would be made
    here, and queried there."""
    text = path_of(str(name))
    head = text.partition('/')[0]
    if '://' in text or (':' in head and not Path(head).exists()):
        raise InvalidData(f'{name}: expected a folder of this computer as archive, found a place elsewhere; mount it '
                          'and '
                          'name where it is mounted' + f', or write ./{text} for a folder of that name' * (
                              '://' not in text))
    return Path(text).absolute()


def _misfit(path: Path) -> str:
    """Return why a file has not the rows of an archive, in words; '' where it has. Raises what pyarrow raises."""
    file = pq.ParquetFile(path)
    if (rows := file.metadata.num_rows) > MOST_ROWS:
        return f'it has {rows} rows, more than {MOST_ROWS}'
    found = {one.name: one.type for one in file.schema_arrow}
    for one in SCHEMA:
        if one.name in found and found[one.name] not in (one.type, pa.null()):
            return f'its column {one.name} is {found[one.name]}, not {one.type}'
    if lacking := [name for name in OF_EVERY_ROW if name not in found]:
        return f'it has no column {lacking[0]}'
    stated = file.read(columns=list(OF_EVERY_ROW))
    if empty := [name for name in OF_EVERY_ROW if stated[name].null_count]:
        return f'its column {empty[0]} is empty in {counted(stated[empty[0]].null_count, "row")}'
    last, now = pc.max(stated['added_at'].cast(pa.int64())).as_py(), datetime.datetime.now(datetime.UTC)
    if last is not None and last > 1e6 * (now + WRONG_CLOCK).timestamp():
        return 'its rows were added on a day that has not come'
    return ''


def _damage(path: Path) -> str:
    """Return why a file with rows cannot be read, in words; '' where it can, or is gone."""
    try:
        if not (words := _misfit(path)):
            pq.read_table(path)
        return words
    except FileNotFoundError:
        return ''
    except (pa.ArrowException, OSError) as error:
        return ' '.join(str(error).split())[:120]


class RunArchive:
    """An archive of runs in a folder; raises InvalidData where it is none, or of a newer version of the format."""

    def __init__(self, folder: str | Path, make: bool = False) -> None:
        """Open an archive; make: where there is none yet, make one."""
        self.folder, self._damaged, self._fitting = local_folder(folder), set[Path](), set[Path]()
        mark = self.folder / MARK
        if make and not mark.exists():
            self._make(mark)
        if not mark.exists():
            raise InvalidData(f'{folder}: expected an archive, found '
                              f'{"a folder" if self.folder.is_dir() else "nothing"} '
                              f'without {MARK}; rosette archive add FOLDER --into {folder} makes one')
        try:
            stated = json.loads(read_limited(mark, 'an archive', 65536)).get('schema')
        except (ValueError, AttributeError) as error:
            raise InvalidData(f'{mark}: expected JSON with "schema": "{FORMAT}", found something else') from error
        if stated != FORMAT:
            raise InvalidData(f'{folder}: expected an archive of {FORMAT}, found {stated!r:.60}; use a version of '
                              'rosette '
                              'that knows it')

    def _make(self, mark: Path) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if any(path.name not in (MARK, PARTS) and path.suffix != '.part' for path in self.folder.iterdir()):
                raise InvalidData(f'{self.folder}: expected an archive or an empty folder, found a folder of other '
                                  'files; '
                                  'choose another name')
            (self.folder / PARTS).mkdir(exist_ok=True)
        except OSError as error:
            raise InvalidData(f'{self.folder}: an archive cannot be made: {error.strerror}') from error
        write_text(mark, json.dumps({'schema': FORMAT}) + '\n', force=True)  # two may make it at once

    @property
    def parts(self) -> list[Path]:
        """The files with rows, without those that were found damaged."""
        with reading(self.folder / PARTS, 'the files of an archive'):
            return sorted(path for path in (self.folder / PARTS).iterdir()
                          if path.suffix == '.parquet' and not path.name.startswith('.') and path not in self._damaged
                          and is_regular(path))

    def check_writable(self) -> None:
        """Raise InvalidData where no file can be written: better before hours of work than after."""
        trial = self.folder / PARTS / f'.{secrets.token_hex(8)}.part'
        try:
            os.close(os.open(trial, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            trial.unlink()
        except OSError as error:
            raise InvalidData(f'{self.folder}: expected an archive that can be written, found: '
                              f'{error.strerror}') from error

    def add(self, rows: Sequence[Mapping[str, Any]]) -> Path:
        """Bring rows (see run_row.COLUMNS) to the disk as one more file, and return it; raises InvalidData."""
        return self._write(table_of(rows))

    def _write(self, table: pa.Table) -> Path:
        data = io.BytesIO()
        pq.write_table(table, data, compression='zstd', row_group_size=ROW_GROUP)
        now = datetime.datetime.now(datetime.UTC)
        path = self.folder / PARTS / f'{now:%Y%m%dT%H%M%S}-{secrets.token_hex(8)}.parquet'
        write_bytes(path, data.getvalue())
        return path

    def query(self, sql: str, values: Sequence[Any] = (), views: Mapping[str, str] | None = None) -> pa.Table:
        """Return the answer of DuckDB to a question in SQL, in which `runs` are the rows that count.

        values: for the question marks in it; views: further ones by name, which may use those before them. Raises
        InvalidData where the question cannot be answered, reads other files than those of the archive, or is another
        statement than SELECT."""
        while True:
            self._leave_out_misfits()
            parts = self.parts
            try:
                return self._query(sql, values, {'runs': ROWS, **(views or {})}, parts)
            except duckdb.Error as error:
                if all(path.exists() for path in parts) and not self._leave_out_damaged(parts):
                    # else another process has just joined some
                    raise InvalidData(f'{self.folder}: {" ".join(str(error).split())}') from error
            except RuntimeError as error:  # DuckDB puts it in the place of what the handler of a signal raises
                raise KeyboardInterrupt from error

    def _leave_out_misfits(self) -> None:
        """Leave out files with other columns than those of an archive; each is looked at once."""
        for path in {*self.parts} - self._fitting:
            with suppress(pa.ArrowException, OSError):  # damaged: said where it is read
                if _misfit(path):
                    self._leave_out_damaged([path])
                self._fitting.add(path)

    def _leave_out_damaged(self, parts: Iterable[Path]) -> bool:
        """Name the files that cannot be read, leave them out from now on, and return whether there are any."""
        damaged = {path: words for path in parts if (words := _damage(path))}
        for path, words in damaged.items():
            logging.getLogger(__name__).warning(
                '%s: left out, as it is damaged (%s); its rows are missing: `rosette archive add LOGS --into %s` '
                'restores them, then delete this file', path, words, self.folder)
        self._damaged |= damaged.keys()
        return bool(damaged)

    def _query(self, sql: str, values: Sequence[Any], views: Mapping[str, str], parts: Iterable[Path]) -> pa.Table:
        with duckdb.connect() as base:
            base.execute("SET TimeZone = 'UTC'; SET autoinstall_known_extensions = false")  # nothing from the network
            base.register('parts', SCHEMA.empty_table())
            paths = [str(path) for path in parts]
            if files := [re.sub(r'([*?[])', r'[\1]', path) for path in paths]:  # DuckDB takes them as patterns
                base.register('parts', base.read_parquet(files, union_by_name=True))
            base.execute('SET allowed_paths = $1', [[*paths, *files]])
            base.execute('SET enable_external_access = false; SET lock_configuration = true')
            for name, text in views.items():
                base.execute(f'CREATE TEMP VIEW {name} AS {text}')
            kinds = {one.type for one in base.extract_statements(sql)}
            answer = base.sql(sql, params=list(values)) if kinds <= {duckdb.StatementType.SELECT} else None
            if answer is None:
                raise InvalidData(f'{self.folder}: expected a question (SELECT ...), found {sql!r:.80}')
            return answer.to_arrow_table()

    def read_rows(self, columns: Sequence[str] = (), where: str = '', values: Sequence[Any] = ()) -> pa.Table:
        """Return the rows that count, sorted by table and time, as an Arrow table; `to_pylist` of it gives dicts.

        columns: names of some (run_row.COLUMNS explains them), all if none is named; where: condition in SQL, such as
        `table_serial = ? AND problem = ''`; values: for its question marks."""
        names = ', '.join(f'"{name}"' for name in columns) or '*'
        return self.query(f'SELECT {names} FROM runs {f"WHERE {where}" if where else ""} '
                          'ORDER BY table_serial, measured_at, run_id, log_sha256, model_hash', values)

    def join_small(self) -> str:
        """Join the small files where there are many of them; return what was done in words, '' for nothing.

        Of several processes that do so at once, one that finds its files gone leaves the rest to the others."""
        with suppress(FileNotFoundError, duckdb.Error):
            self.query('SELECT 1 FROM runs LIMIT 1')  # which leaves out what is damaged
            return self._join_small()
        return ''

    def _join_small(self) -> str:
        small = {path: rows for path in self.parts if (rows := pq.read_metadata(path).num_rows) < LARGE}
        if len(small) <= MOST_SMALL:
            return ''
        group, size = list[Path](), 0
        for place, (path, rows) in enumerate(small.items(), 1):
            group, size = [*group, path], size + rows
            if size >= LARGE or place == len(small):
                self._write(self._query('SELECT * FROM runs ORDER BY table_serial, measured_at', (), {'runs': ROWS},
                                        group).cast(SCHEMA))
                for one in group:
                    one.unlink(missing_ok=True)  # another process may have joined the same
                group, size = [], 0
        return f'{counted(len(small), "file")} joined'

# SPDX-License-Identifier: Apache-2.0
"""When a cell calibrates itself next, and who holds it: kept in the archive, so that no restart forgets either.

    ARCHIVE/cells/NAME.json    {"schema": ..., "attempted": TIME, "hold": {"who": ..., "why": ..., "since": ...}}

The last run is that of the archive; `attempted` counts too: a calibration that fails is not repeated at once."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import quote

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.core.errors import CellError, InvalidData, plain
from rosette_ros.io.text_file import read_limited, write_text

SCHEMA = 'rosette-cell/1'
_MOST_BYTES = 65536


@dataclass(frozen=True)
class Hold:
    """Who holds a cell, why, and since when, UTC."""

    who: str
    why: str
    since: datetime

    def __str__(self) -> str:
        """Return it in a sentence without a full stop."""
        return f'{self.who} holds the cell since {self.since:%Y-%m-%d %H:%M} UTC: {self.why or "no reason is stated"}'


class CellSchedule:
    """The schedule of one cell of an archive; raises InvalidData where its file cannot be read.

    cell: namespace of the cell; table: serial number of its table, '' for any; every: s from run to run, 0: never by
    itself."""

    def __init__(self, archive: RunArchive, cell: str, table: str = '', every: float = 0.0) -> None:
        self._archive, self._cell, self._table, self._every = archive, cell, table, timedelta(seconds=every)
        self.path = archive.folder / 'cells' / f'{quote(" ".join(filter(None, (cell, table))), safe=" ")}.json'
        self.hold: Hold | None = None
        self.attempted: datetime | None = None
        if self.path.exists():
            self._read()

    def _read(self) -> None:
        wanted = f'wanted JSON with "schema": "{SCHEMA}", times and a hold'
        try:
            stated: dict[str, Any] = json.loads(read_limited(self.path, 'the schedule of a cell', _MOST_BYTES))
            if stated['schema'] != SCHEMA:
                raise InvalidData(f'{self.path}: {wanted}, got {stated["schema"]!r:.60}; use a version of rosette that '
                                  'knows it')
            self.attempted = _time(stated['attempted']) if stated['attempted'] else None
            hold = stated['hold']
            self.hold = Hold(plain(hold['who']), plain(hold['why']), _time(hold['since'])) if hold else None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InvalidData(f'{self.path}: {wanted}, got something else; remove the file if nobody holds the '
                              'cell') from error

    def take(self, who: str, why: str, now: datetime) -> Hold:
        """Hold the cell for a person or a job; raises CellError where another one holds it."""
        if self.hold is not None and self.hold.who != who:
            raise CellError(f'{self.hold}; {self.hold.who} has to release it')
        self._write(hold=Hold(who, why, self.hold.since if self.hold else now), attempted=self.attempted)
        assert self.hold is not None
        return self.hold

    def release(self, who: str) -> None:
        """End the hold of a person or a job; raises CellError where it is another's."""
        if self.hold is not None and self.hold.who != who:
            raise CellError(f'{self.hold}; {self.hold.who} has to release it')
        if self.hold is not None:
            self._write(hold=None, attempted=self.attempted)

    def attempt(self, now: datetime) -> None:
        """Take note that a calibration begins."""
        self._write(hold=self.hold, attempted=now)

    def due(self, now: datetime) -> datetime | None:
        """Return when the next calibration is due, now where there was none yet; None: never by itself."""
        if not self._every:
            return None
        # Times that lie ahead are of a clock that was wrong.
        before = [one for one in (self.attempted, self._last_run(now)) if one is not None and one <= now]
        return max(before) + self._every if before else now

    def _last_run(self, now: datetime) -> datetime | None:
        found: datetime | None = self._archive.query(
            "SELECT max(measured_at) AS last FROM runs WHERE problem = '' AND cell = ? AND ? IN ('', table_serial) AND "
            'measured_at <= ?', (self._cell, self._table, now)).to_pylist()[0]['last']
        return found

    def _write(self, hold: Hold | None, attempted: datetime | None) -> None:
        text = json.dumps({'schema': SCHEMA, 'attempted': attempted and attempted.isoformat(),
                           'hold': hold and {**vars(hold), 'since': hold.since.isoformat()}}, ensure_ascii=False)
        try:
            self.path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise InvalidData(f'{self.path.parent}: cannot be made: {error.strerror}') from error
        write_text(self.path, f'{text}\n', force=True)
        self.hold, self.attempted = hold, attempted


def _time(text: str) -> datetime:
    found = datetime.fromisoformat(text)
    return found if found.tzinfo else found.replace(tzinfo=UTC)

# SPDX-License-Identifier: Apache-2.0
"""All tables of an archive side by side: the last result of each, conformity, when to calibrate again; urgent first."""

import datetime
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import decided_by
from rosette_ros.archive.table_history import TableTrend, history_of, limits_of, trend_of
from rosette_ros.core.diagnosis.verdict import Outcome
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.number_words import UNKNOWN
from rosette_ros.core.uncertainty.error_summary import Conformity, worst_of
from rosette_ros.presentation.formatting import micro
from rosette_ros.presentation.json_output import Json, plain
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.words.effect_words import names
from rosette_ros.words.verdict_words import SHORT

SCHEMA = 'rosette-plant/1'
LEVELS = {Conformity.FAILS: 'bad', Conformity.UNDECIDED: 'doubtful', Conformity.CONFORMS: 'good'}


@dataclass(frozen=True, eq=False)
class TableStanding:
    """A table as its runs show it.

    runs: how many, dated ones under the model of most; last: the row of the last run; decided: on each stated
    tolerance by it, by curve; trend: None where the runs are too few for one; due: when the next calibration is
    proposed, None where no forecast says it; is_due: whether that is past."""

    serial: str
    runs: int
    last: Mapping[str, Any]
    decided: Mapping[str, Conformity]
    trend: TableTrend | None
    due: datetime.datetime | None
    is_due: bool

    @property
    def conformity(self) -> Conformity | None:
        """What is decided about all tolerances together: the worst; None where none is stated."""
        return worst_of(self.decided.values())

    @property
    def level(self) -> str:
        """How urgent it is: bad, doubtful, good or '' where nothing is known."""
        if self.conformity is Conformity.FAILS or self.is_due:
            return 'bad'
        if self.conformity is Conformity.UNDECIDED or (self.trend and self.trend.recent) or (
                self.last['level'] not in (None, 'good')):
            return 'doubtful'
        return 'good' if self.conformity else ''

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is urgent, in words."""
        said = [f'{curve} {one.value}' for curve, one in self.decided.items() if one is not Conformity.CONFORMS]
        said += ['calibration due'] * self.is_due
        if self.trend:
            dates = self.trend.history.dates
            said += [f'{names(one.owners)} changed before {dates[one.latest]:%Y-%m-%d}' for one in self.trend.recent]
        return tuple(said)


def plant_of(archive: RunArchive, now: datetime.datetime) -> tuple[TableStanding, ...]:
    """Return the tables of an archive, the most urgent first; now: by which it is told whether a calibration is due.

    Raises InvalidData where no run is dated and states its table."""
    rows = archive.read_rows(where="problem = '' AND table_serial <> '' AND measured_at IS NOT NULL").to_pylist()
    if not rows:
        raise InvalidData(f'{archive.folder}: expected dated runs that state the serial number of their table, found '
                          'none; state table.serial in the identity (rosette archive add --identity FILE --force)')
    made = [_state(serial, list(some), now) for serial, some in groupby(rows, key=lambda row: str(row['table_serial']))]
    last = datetime.datetime.max.replace(tzinfo=datetime.UTC)
    order = ('bad', 'doubtful', '', 'good')
    return tuple(sorted(made, key=lambda one: (
        order.index(one.level), one.conformity is not Conformity.FAILS, one.due or last, one.serial)))


def _state(serial: str, rows: Sequence[Mapping[str, Any]], now: datetime.datetime) -> TableStanding:
    model = Counter(row['model_hash'] for row in rows).most_common(1)[0][0]
    rows = sorted((row for row in rows if row['model_hash'] == model), key=lambda row: row['measured_at'])
    last, trend, due = rows[-1], None, None
    decided = decided_by(last, limits_of(rows))
    try:
        trend = trend_of(history_of(rows, serial))
    except InvalidData:  # too few runs for one
        pass
    if trend and trend.forecasts:
        ahead = min(one.interval for one in trend.forecasts.values())
        due = trend.history.dates[-1] + datetime.timedelta(days=ahead)
    return TableStanding(serial, len(rows), last, decided, trend, due, due is not None and due < now)


def plant_table(states: Sequence[TableStanding]) -> Table:
    """Return the tables in a line each."""
    return Table('plant', 'Rotary tables, the most urgent first', (
        words('table', 'table', [one.serial for one in states]),
        words('measured', 'last calibrated', [f'{one.last["measured_at"]:%Y-%m-%d}' for one in states]),
        column('runs', 'runs', [one.runs for one in states], str),
        column('residual_um', 'residual', [1e6 * one.last['rms_m'] for one in states],
               lambda value: micro(1e-6 * value), 'µm'),
        words('verdict', 'verdict', [SHORT[Outcome(one.last['outcome'])] if one.last['outcome'] else 'not judged'
                                     for one in states]),
        words('conformity', 'tolerances', [one.conformity or 'not stated' for one in states]),
        words('due', 'next calibration', [f'{one.due:%Y-%m-%d}' if one.due else UNKNOWN for one in states]),
        words('why', 'why', ['; '.join(one.reasons) for one in states])),
        levels=tuple(one.level for one in states),
        note=f'Next calibration: the shortest interval that rosette trend proposes; {UNKNOWN}: fewer runs or no '
             'tolerance.')


def plant_json(states: Sequence[TableStanding]) -> Json:
    """Return the tables, schema rosette-plant/1, SI."""
    return plain({'schema': SCHEMA, 'tables': [{
        'table': one.serial, 'level': one.level, 'runs': one.runs, 'run_id': one.last['run_id'],
        'path': one.last['path'], 'measured_at': one.last['measured_at'].isoformat(), 'rms_m': one.last['rms_m'],
        'outcome': one.last['outcome'], 'conformity': one.conformity, 'decided': dict(one.decided),
        'due': one.due and one.due.isoformat(), 'is_due': one.is_due, 'reasons': one.reasons} for one in states]})

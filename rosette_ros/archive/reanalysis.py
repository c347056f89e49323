# SPDX-License-Identifier: Apache-2.0
"""All runs of an archive under two models, side by side: where the residual falls, how far the curves move."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from rosette_ros.archive.run_adding import FoundLog, find_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import History, read_history
from rosette_ros.core.diagnosis.verdict import CERTAIN
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.trend import LEAST_RUNS, Event, Forecast
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.json_output import CURVE_KEYS
from rosette_ros.words import archive_words as say

_CHANGES = ', '.join(
    f'list_max(list_transform(list_zip(a.{key}, b.{key}), lambda p: abs(p[2] - p[1]))) AS change_{key}, '
    f'list_max(list_transform(list_zip(a.{key}, b.{key}, a.U_{key}, b.U_{key}), '
    f'lambda p: abs(p[2] - p[1]) / greatest(p[3], p[4]))) AS {curve}_of_U'
    for curve, key in zip(CURVES, CURVE_KEYS, strict=True))
_SIDE_BY_SIDE = f'''
    SELECT b.measured_at, b.table_serial, b.cell, b.run_id, b.path, a.rms_m AS before, b.rms_m AS after,
        a.outcome AS outcome_before, b.outcome AS outcome_after, {_CHANGES},
        list_sort(list_distinct([e.effect for e in b.effects if e.in_model AND
            len([p for p in e.parameters if abs(p.value) > {CERTAIN / COVERAGE_FACTOR} * p.U]) > 0])) AS had
    FROM (SELECT * FROM runs WHERE model_hash = ?) AS a JOIN (SELECT * FROM runs WHERE model_hash = ?) AS b
        USING (log_sha256, run_id)
    WHERE a.problem = '' AND b.problem = '' ORDER BY b.table_serial, b.measured_at, b.run_id'''


@dataclass(frozen=True)
class RunChange:
    """A run under two models.

    before, after: residual, m; change, of_u: largest change of each of CURVES, m and rad, and in units of the larger U
    (k = 2) of both; had: effects of the model after with a parameter of CERTAIN standard
    uncertainties."""

    measured_at: Any
    table_serial: str
    cell: str
    run_id: str
    path: str
    before: float
    after: float
    outcome_before: str | None
    outcome_after: str | None
    change: tuple[float, ...]
    of_u: tuple[float, ...]
    had: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class TrendComparison:
    """The trend of a table under two models. before, after: its runs under each; events: changes under one, the other
    or both models, None where a model shows none; slopes: of each of CURVES under both, since its last change there."""

    before: History
    after: History
    events: tuple[tuple[Event | None, Event | None], ...]
    slopes: dict[str, tuple[Forecast, Forecast]]

    def altered(self, curve: str) -> float:
        """Return by how much the slope of a curve alters, in units of the larger U (k = 2) of both models."""
        before, after = self.slopes[curve]
        return abs(after.slope - before.slope) / (COVERAGE_FACTOR * max(before.slope_u, after.slope_u))


def logs_of(archive: RunArchive) -> tuple[list[FoundLog], list[str]]:
    """Return the logs of an archive that are still where they were found, and the paths of those that are not."""
    found, gone = list[FoundLog](), list[str]()
    for path in dict.fromkeys(archive.read_rows(('path',)).column(0).to_pylist()):
        try:
            found += find_logs([path])
        except InvalidData:
            gone.append(path)
    return found, gone


def side_by_side(archive: RunArchive, before: Model, after: Model) -> list[RunChange]:
    """Return the runs that an archive holds under both models, by table and time."""
    rows = archive.query(_SIDE_BY_SIDE, (before.hash, after.hash)).to_pylist()
    same = [one.name for one in fields(RunChange) if one.name not in ('change', 'of_u', 'had')]
    return [RunChange(
        **{name: row[name] for name in same}, change=tuple(row[f'change_{key}'] for key in CURVE_KEYS),
        of_u=tuple(row[f'{curve}_of_U'] for curve in CURVES), had=tuple(row['had'] or ())) for row in rows]


def not_evaluated(archive: RunArchive, before: Model, after: Model) -> int:
    """Return how many runs of an archive could not be evaluated under one of two models."""
    return int(archive.query("SELECT count(DISTINCT (log_sha256, run_id)) FROM runs WHERE problem <> '' AND "
                             'model_hash IN (?, ?)', (before.hash, after.hash)).column(0)[0].as_py())


def trends_side_by_side(archive: RunArchive, before: Model, after: Model) -> list[TrendComparison]:
    """Return the trend of every table that has at least LEAST_RUNS dated runs under both models."""
    tables = archive.query(
        "SELECT table_serial FROM runs WHERE problem = '' AND measured_at IS NOT NULL AND model_hash IN (?, ?) "
        'GROUP BY table_serial HAVING count(*) FILTER (model_hash = ?) >= ? AND count(*) FILTER (model_hash = ?) >= ? '
        'ORDER BY 1', (before.hash, after.hash, before.hash, LEAST_RUNS, after.hash, LEAST_RUNS)).to_pylist()
    found = []
    for row in tables:
        one, other = (read_history(archive, row['table_serial'], model.hash) for model in (before, after))
        events = one.events(), other.events()
        first, second = one.slopes(events[0]), other.slopes(events[1])
        found.append(TrendComparison(one, other, _paired((one, other), events), {
            curve: (first[curve], second[curve]) for curve in CURVES if curve in first and curve in second}))
    return found


def _paired(histories: Sequence[History], events: Sequence[Sequence[Event]]) -> tuple[
        tuple[Event | None, Event | None], ...]:
    """Return the changes under both models, those that may lie between the same runs together, by time."""
    spans = [[(history.dates[event.earliest - 1], history.dates[event.latest]) for event in some]
             for history, some in zip(histories, events, strict=True)]
    left = dict(enumerate(events[1]))
    pairs: list[tuple[Any, Event | None, Event | None]] = []
    for event, (begin, end) in zip(events[0], spans[0], strict=True):
        same = next((place for place in left if spans[1][place][0] < end and begin < spans[1][place][1]), None)
        pairs.append((begin, event, None if same is None else left.pop(same)))
    pairs += [(spans[1][place][0], None, event) for place, event in left.items()]
    return tuple((one, other) for _, one, other in sorted(pairs, key=lambda pair: pair[0]))


def trend_conclusion(trends: Sequence[TrendComparison]) -> tuple[str, ...]:
    """Return in sentences how changes and slopes alter."""
    if not trends:
        return say.no_trends(LEAST_RUNS)
    pairs = [pair for one in trends for pair in one.events]
    slopes = [one.altered(curve) for one in trends for curve in one.slopes]
    return say.trends(len(trends), sum(None not in pair for pair in pairs), sum(pair[1] is None for pair in pairs),
                      sum(pair[0] is None for pair in pairs), sum(one > 1 for one in slopes), len(slopes))


def conclusion(changes: Sequence[RunChange], terms: Sequence[Term], archive: RunArchive,
               failed: int = 0) -> tuple[str, ...]:
    """Return in sentences what the comparison says.

    terms: that the model after has and before lacks; failed: number of runs that could not be evaluated."""
    left = say.not_evaluated(failed, archive.folder) if failed else ()
    if not changes:
        return (*say.no_changes(), *left)
    falls = [one for one in changes if one.after < 0.9 * one.before]
    most = max(falls, key=lambda one: one.before / one.after).run_id if falls else ''
    had = [(term, [one for one in changes if term.name in one.had]) for term in terms]
    return (*say.changes(len(changes), len(falls), most, sum(max(one.of_u) > 1 for one in changes)),
            *(say.effect(term.name, term.is_open, len(some), len(changes),
                         [one.measured_at for one in some if one.measured_at]) for term, some in had), *left)

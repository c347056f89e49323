# SPDX-License-Identifier: Apache-2.0
"""What a new run of a cell says about its table: the run is added, the trend is judged, limits that are passed told."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosette_ros.archive.engines import PlainLoop
from rosette_ros.archive.log_finder import find_logs
from rosette_ros.archive.run_adding import add_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.table_history import History, read_history
from rosette_ros.core.error_summary import Conformity, conformity
from rosette_ros.core.errors import InvalidData, counted
from rosette_ros.core.model.model import Model
from rosette_ros.core.records import CURVES
from rosette_ros.core.trend import LEAST_RUNS, Event, Forecast
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation import trend_results as results
from rosette_ros.presentation.table_format import Table

LATELY = LEAST_RUNS
"""A change is warned of while it is among so many last runs."""


@dataclass(frozen=True, eq=False)
class CellTrend:
    """The trend of a table after a run. unkept: errors that are not within their tolerance for certain (ISO 14253-1);
    recent: changes among the last runs; warnings: both in sentences."""

    history: History
    events: tuple[Event, ...]
    forecasts: Mapping[str, Forecast]
    unkept: tuple[str, ...]
    recent: tuple[Event, ...]
    warnings: tuple[str, ...]

    @property
    def level(self) -> str:
        """How it is: good, doubtful or bad."""
        return 'bad' if self.unkept else 'doubtful' if self.recent else 'good'

    @property
    def notes(self) -> list[str]:
        """What its tables do not show, in sentences: what was left out, is steady, or cannot be told."""
        history, notes = self.history, []
        if history.left_out:
            notes.append(f'Left out, as they are between the steps of the table: {", ".join(history.left_out)}.')
        if history.other_balls:
            notes.append('Left out of plate, CMM and forecasts, as they have another number of balls than the last '
                         f'run: {", ".join(history.other_balls)}.')
        if not self.events:
            notes.append('No step beyond the scatter of the runs: curves, plate, CMM, effects and residual; slopes in '
                         'time and temperature are no steps.')
        if beyond := [results.component_name(series, part) for series, part, one in history.charts()
                      if one.alarms and one.alarms[-1] == len(one.z) - 1]:
            notes.append(f'In the last run beyond the limits of their control charts: {"; ".join(beyond)}.')
        if course := history.residual_course(self.events):
            notes.append(results.residual_words(course))
        notes += results.too_few_words(history.too_few(self.events))
        if not history.tolerances:
            notes.append('No tolerances are stated (identity file, tolerances): nothing to forecast.')
        return notes

    @property
    def tables(self) -> list[Table]:
        """What changed when, and when tolerances are reached, where there is any."""
        history, events = self.history, self.events
        made = [results.events_table(events, history.dates, history.runs, [
            history.exchanged(event.run) for event in events])] if events else []
        return made + ([results.forecast_table(self.forecasts, history.tolerances, history.dates[-1])]
                       if self.forecasts else [])

    @property
    def sentence(self) -> str:
        """It in a sentence."""
        is_short = len(self.history.runs) < LEAST_RUNS
        said = [*self.warnings] or ['no tolerance is passed'] * bool(self.history.tolerances)
        if is_short:
            said.append(f'changes are looked for from {LEAST_RUNS} runs on')
        elif not self.warnings:
            said.append(f'no step in the last {LATELY} runs')
        return f'{counted(len(self.history.runs), "run")}: {"; ".join(said)}'


def add_and_judge(archive: RunArchive, log: str, model: Model) -> CellTrend:
    """Add the log of a run and return the trend of its table; raises InvalidData where the run cannot be added."""
    log = str(Path(log).absolute())
    add_logs(archive, find_logs([log]), PlainLoop(), model)
    added = archive.read_rows(('problem', 'table_serial', 'cell'), 'path = ? AND model_hash = ?',
                              (log, model.hash)).to_pylist()
    if not added or added[-1]['problem']:
        raise InvalidData(f'{log}: {added[-1]["problem"] if added else "its content is known as another log"}')
    return trend_of(read_history(archive, added[-1]['table_serial'], model.hash, added[-1]['cell'], least=1))


def trend_of(history: History) -> CellTrend:
    """Return the trend that a history shows."""
    events = history.events()
    recent = tuple(event for event in events if event.run >= len(history.runs) - LATELY)
    unkept, said = [], []
    for curve, limit in history.tolerances.items():
        place = CURVES.index(curve)
        value, expanded = float(history.range[-1, place]), float(history.U[-1, place])
        if (found := conformity(value, expanded, limit)) is not Conformity.CONFORMS:
            unkept.append(curve)
            unit = text.CURVE_UNITS[place]
            said.append(f'{curve} {1e6 * value:.3g} ± {1e6 * expanded:.2g} {unit}: {found} to its tolerance of '
                        f'{1e6 * limit:.3g} {unit}')
    for event in recent:
        strongest = event.steps[0]
        said.append(f'{text.names(event.owners)} changed between {history.dates[event.earliest - 1]:%Y-%m-%d} and '
                    f'{history.dates[event.latest]:%Y-%m-%d}: {strongest.series.name} by '
                    f'{results.size_words(strongest)}')
    return CellTrend(history, events, history.forecasts(events), tuple(unkept), recent, tuple(said))

# SPDX-License-Identifier: Apache-2.0
"""The trend of a table judged: limits that are passed, changes among the last runs, notes and tables."""

from collections.abc import Mapping
from dataclasses import dataclass

from rosette_ros.archive.table_history import History
from rosette_ros.core.error_summary import Conformity, conformity
from rosette_ros.core.errors import counted
from rosette_ros.core.records import CURVES
from rosette_ros.core.trend import LEAST_RUNS, Event, Forecast
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation import trend_results as results
from rosette_ros.presentation.table_format import Table

LATELY = LEAST_RUNS
"""A change is warned of while it is among so many last runs."""


@dataclass(frozen=True, eq=False)
class TableTrend:
    """The trend of a table. unkept: errors that are not within their tolerance for certain (ISO 14253-1);
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
        said = [*self.warnings] or [*['no tolerance is passed'] * bool(self.history.tolerances),
                                    f'no step in the last {LATELY} runs']
        return f'{counted(len(self.history.runs), "run")}: {"; ".join(said)}'


def trend_of(history: History) -> TableTrend:
    """Return the trend that a history shows."""
    events = history.events()
    recent = tuple(event for event in events if event.run >= len(history.runs) - LATELY)
    unkept, said = [], []
    for curve, limit in history.tolerances.items():
        place = CURVES.index(curve)
        value, expanded = float(history.range[-1, place]), float(history.U[-1, place])
        if (found := conformity(value, expanded, limit)) is not Conformity.CONFORMS:
            unkept.append(curve)
            factor, unit = text.curve_scales()[place]
            said.append(f'{curve} {factor * value:.3g} ± {factor * expanded:.2g} {unit}: {found} to its tolerance of '
                        f'{factor * limit:.3g} {unit}')
    for event in recent:
        strongest = event.steps[0]
        said.append(f'{text.names(event.owners)} changed between {history.dates[event.earliest - 1]:%Y-%m-%d} and '
                    f'{history.dates[event.latest]:%Y-%m-%d}: {strongest.series.name} by '
                    f'{results.size_words(strongest)}')
    return TableTrend(history, events, history.forecasts(events), tuple(unkept), recent, tuple(said))

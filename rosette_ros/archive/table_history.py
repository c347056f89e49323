# SPDX-License-Identifier: Apache-2.0
"""The runs of one table in an archive as a history: the quantities that are watched, what has changed, the trend."""

import datetime
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import AXES, SERIALS, decided_by
from rosette_ros.core.run.errors import InvalidData, counted
from rosette_ros.core.run.geometry import TWO_PI, nominal_angles, rotate_z, wrap
from rosette_ros.core.run.number_words import Tolerance
from rosette_ros.core.run.records import CURVES, SI_UNITS, Floats, Ints
from rosette_ros.core.table import trend
from rosette_ros.core.table.trend import LEAST_LINE, LEAST_RUNS, Event, Forecast, TimeSeries
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import Conformity
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation import trend_results as results
from rosette_ros.presentation.json_output import CURVE_KEYS
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.effect_words import names, tolerance_words

DAY = 86400.0
LEAST_SHARE = 1e-3
"""A harmonic that is smaller than this share of its u in every run is zero by convention, not by measurement."""

LEAST_PLACES = 3
"""Fewer balls or CMM positions do not say how they lie together, apart from how each of them deviates."""
_TOGETHER = {'rotation': slice(0, 1), 'height': slice(1, 2), 'shift': slice(2, 4), 'tilt': slice(4, 6),
             'size': slice(6, 7)}
"""How all balls (clamping) or CMM positions (frame) lie in the frame of a run: rotation and tilt in rad, the rest in m.
The size, along the radius, is that in the scale of the CMM: rosettes do not tell one from the other."""
_ANGLES = ('rotation', 'tilt')
LATELY = LEAST_RUNS
"""A change is warned of while it is among so many last runs."""


@dataclass(frozen=True, eq=False)
class History:
    """Runs of a table in the order of time.

    dates, runs, paths: when measured, run_id, which several logs may have, and where the log was found; days: (m,)
    since the first; range, U: (m, 6) of the errors, m and rad; curves: (m, 6, n), NaN in runs with another number
    of balls than the last one, which are other_balls; tolerances: by curve, of the last run that states any; decided:
    of them by the last run; temperature: (m,); quantities: what is looked at; serials: of each run by device; missing:
    effects that the diagnosis of each run names; simulated: names of the runs that are; left_out: runs between the
    steps of the table."""

    serial: str
    model_hash: str
    dates: tuple[datetime.datetime, ...]
    runs: tuple[str, ...]
    days: Floats
    range: Floats
    U: Floats
    curves: Floats
    tolerances: Mapping[str, Tolerance]
    decided: Mapping[str, Conformity]
    temperature: Floats
    quantities: tuple[TimeSeries, ...]
    serials: tuple[Mapping[str, str], ...]
    missing: tuple[tuple[str, ...], ...]
    simulated: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    other_balls: tuple[str, ...] = ()
    paths: tuple[str, ...] = ()

    def events(self) -> tuple[Event, ...]:
        """Return the changes, in the order of time."""
        return trend.find_events(self.days, self.quantities, self.temperature)

    def exchanged(self, run: int) -> dict[str, tuple[str, str]]:
        """Return the devices whose serial number is another one from a run on: before and after."""
        before, after = self.serials[run - 1], self.serials[run]
        return {one: (before[one], after[one]) for one in SERIALS if before[one] != after[one]}

    def forecasts(self, events: Sequence[Event]) -> dict[str, Forecast]:
        """Return when each error with a tolerance reaches it, its U being the guard band, from the runs since the last
        change of its curve."""
        return {curve: found for curve, found in self.slopes(events).items() if curve in self.tolerances}

    def slopes(self, events: Sequence[Event]) -> dict[str, Forecast]:
        """Return how each error moves since the last change of its curve; one without a tolerance never reaches it."""
        found = {}
        for place, curve in enumerate(CURVES):
            runs = self._since(curve, events)
            if len(runs) >= LEAST_LINE and np.ptp(self.days[runs]) > 0:
                expanded = self.U[runs, place]
                limit = self.tolerances.get(curve, np.inf) - float(np.median(expanded[-LEAST_RUNS:]))
                found[curve] = trend.forecast(self.days[runs], self.curves[runs, place], expanded / COVERAGE_FACTOR,
                                              limit)
        return found

    def too_few(self, events: Sequence[Event]) -> dict[str, int]:
        """Return the number of runs since the last change of each curve with a tolerance that has no forecast."""
        known = self.slopes(events)
        return {curve: len(self._since(curve, events)) for curve in self.tolerances if curve not in known}

    def _since(self, curve: str, events: Sequence[Event]) -> Ints:
        """Return the runs since the last change of a curve that have as many balls as the last one."""
        begin = max((event.run for event in events if curve in event.curves), default=0)
        return begin + np.flatnonzero(np.all(np.isfinite(self.curves[begin:]), axis=(1, 2)))

    def residual_course(self, events: Sequence[Event]) -> tuple[float, float] | None:
        """Return from where to where the residual has grown or fallen since its last change, m, if it has."""
        series = self.quantities[-1]
        begin = max((event.run for event in events if 'residual' in event.owners), default=0)
        rms, u = series.values[begin:, 0], series.u[begin:, 0]
        found = trend.course(self.days[begin:], np.log(rms), u / rms) if np.all(rms > 0) else None
        return None if found is None else (float(np.exp(found[0])), float(np.exp(found[1])))


def read_history(archive: RunArchive, table: str, model: str = '') -> History:
    """Return the history of a table by its serial number ('': of runs that state none); raises InvalidData.

    model: hash of the model, or its beginning; '': that of most runs."""
    where, values = "problem = '' AND table_serial = ? AND measured_at IS NOT NULL", [table]
    if model:
        where, values = f'{where} AND starts_with(model_hash, ?)', [*values, model]
    rows = archive.read_rows(where=where, values=values).to_pylist()
    hashes = Counter(row['model_hash'] for row in rows)
    if not rows:
        raise InvalidData(f'{archive.folder}: {_why_none(archive, table, model)}')
    best = hashes.most_common(1)[0][0]
    return history_of([row for row in rows if row['model_hash'] == best], table)


def _why_none(archive: RunArchive, table: str, model: str) -> str:
    """Return why an archive has no runs for a trend of a table."""
    every = archive.read_rows(('table_serial', 'model_hash', 'measured_at'), "problem = ''").to_pylist()
    own = [row for row in every if row['table_serial'] == table]
    tables = ', '.join(repr(one) for one in sorted({row['table_serial'] for row in every} - {''})) or 'none'
    if not own and not table:
        return f'expected --table, as every run states one, found none; it has tables {tables}'
    if not own:
        return f'expected dated runs of table {table!r}, found none; it has tables {tables}'
    under = [row for row in own if row['model_hash'].startswith(model)]
    if not under:
        hashes = ', '.join(sorted({row['model_hash'][:12] for row in own}))
        return f'expected runs of table {table!r} under a model {model!r}, found none; it has models {hashes}'
    return (f'expected dated runs of table {table!r}, found {counted(len(under), "run")} without a date; state '
            'measured.begin in the identity (rosette archive add --identity FILE --force)')


def history_of(rows: Sequence[Mapping[str, Any]], serial: str = '') -> History:
    """Return the history of rows (run_row.COLUMNS) under one model, sorted by time; raises InvalidData.

    Runs between the steps of the table are left out; at least LEAST_RUNS others are wanted."""
    rows = sorted(rows, key=lambda row: row['measured_at'])
    left_out = tuple(row['run_id'] for row in rows if _is_between(row))
    rows = [row for row in rows if not _is_between(row)]
    if len(rows) < LEAST_RUNS:
        besides = f', and {counted(len(left_out), "run")} between the steps of the table' if left_out else ''
        whose = f'table {serial!r}' if serial else 'runs that state no table'
        raise InvalidData(f'trend of {whose}: expected at least {LEAST_RUNS} dated runs, found {len(rows)}{besides}')
    dates = tuple(row['measured_at'] for row in rows)
    days = np.array([(date - dates[0]).total_seconds() / DAY for date in dates])
    n = rows[-1]['n']
    return History(
        serial, rows[0]['model_hash'], dates, tuple(row['run_id'] for row in rows), days,
        np.array([[row[f'range_{key}'] for key in CURVE_KEYS] for row in rows]),
        np.array([[row[f'U_range_{key}'] for key in CURVE_KEYS] for row in rows]),
        np.array([[row[key] if row['n'] == n else np.full(n, np.nan) for key in CURVE_KEYS] for row in rows]),
        limits_of(rows), decided_by(rows[-1], limits_of(rows)),
        np.array([np.nan if row['temperature_mean_C'] is None else row['temperature_mean_C'] for row in rows]),
        (*_table(rows), *_places(rows, 'plate', 'ball'), *_places(rows, 'cmm', 'position'), *_effects(rows),
         _residual(rows)),
        tuple({one: row[f'{one}_serial'] for one in SERIALS} for row in rows),
        tuple(tuple(row['missing'] or ()) for row in rows),
        tuple(row['run_id'] for row in rows if row['simulated']), left_out,
        tuple(row['run_id'] for row in rows if row['n'] != n), tuple(row['path'] for row in rows))


def limits_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Tolerance]:
    """Return the tolerances of the last of rows, in the order of time, that states any, by curve, m and rad."""
    return next(filter(None, map(_limits, reversed(rows))), {})


def _limits(row: Mapping[str, Any]) -> dict[str, Tolerance]:
    """Return the tolerances that the identity of a run states, by curve, m and rad."""
    rotation = None if row['rotation'] is None else np.reshape(row['rotation'], (3, 3))
    where = f'{row["run_id"]}: identity'
    return parse_identity(row['identity'].encode(), where).limits(rotation) if 'tolerances' in row['identity'] else {}


def _is_between(row: Mapping[str, Any]) -> bool:
    """Return whether a run is between the steps of the table: CMM positions and angles are other ones than in a run
    from angle 0."""
    return abs(float(wrap(row['angle_rad'][0]))) > 0.1 * TWO_PI / row['n']


def _table(rows: Sequence[Mapping[str, Any]]) -> list[TimeSeries]:
    """Return the harmonics of the six curves that all runs determine."""
    most = (min(row['n'] for row in rows) - 1) // 2
    found = []
    for curve, key in zip(CURVES, CURVE_KEYS, strict=True):
        parts = [trend.harmonics(np.array(row['angle_rad']), np.array(row[key]),
                                 np.array(row[f'U_{key}']) / COVERAGE_FACTOR) for row in rows]
        values, u = (np.array([part[one][:most] for part in parts]) for one in (0, 1))
        found += [TimeSeries('table', f'{curve}, {order + 1} per turn', values[:, order], u[:, order], SI_UNITS[curve],
                             curve, order + 1)
                  for order in range(most) if np.any(np.abs(values[:, order]) > LEAST_SHARE * u[:, order])]
    return found


def _places(rows: Sequence[Mapping[str, Any]], what: str, word: str) -> list[TimeSeries]:
    """Return how all balls or CMM positions lie together (`_TOGETHER`), the deviation of each besides, along radius,
    circle and axis, and its harmonics along x, y, z over their numbers, in the runs with as many as the last one.

    How they lie together scatters as the alignment of a run does, the size with the temperature, and a table whose zero
    has moved turns the plate."""
    n = rows[-1]['n']
    values, u = (np.array([np.column_stack([row[f'{prefix}{what}_{axis}_m'] for axis in AXES]) if row['n'] == n
                           else np.full((n, 3), np.nan) for row in rows]) for prefix in ('', 'U_'))
    owner = 'CMM' if what == 'cmm' else what
    together, values = _together('frame' if what == 'cmm' else 'clamping', values, u / COVERAGE_FACTOR,
                                 np.array([[row['radius_m']] for row in rows]))
    radial, square = rotate_z(-nominal_angles(n), values), u**2
    cosine, sine = np.cos(nominal_angles(n))**2, np.sin(nominal_angles(n))**2
    spread = np.sqrt(np.stack([cosine * square[..., 0] + sine * square[..., 1],
                               sine * square[..., 0] + cosine * square[..., 1], square[..., 2]], axis=-1))
    found = [*together, *(
        TimeSeries(owner, f'{owner} {word} {place + 1}', radial[:, place], spread[:, place] / COVERAGE_FACTOR)
        for place in range(n))]
    for place, axis in enumerate(AXES):
        waves = trend.harmonics(nominal_angles(n), values[..., place], u[..., place] / COVERAGE_FACTOR)
        found += [TimeSeries(owner, f'{owner} {axis}, {order + 1} per turn', waves[0][:, order], waves[1][:, order])
                  for order in range(1, (n - 1) // 2)
                  if np.any(np.abs(waves[0][:, order]) > LEAST_SHARE * waves[1][:, order])]
    return found


def _together(owner: str, values: Floats, u: Floats, radius: Floats) -> tuple[list[TimeSeries], Floats]:
    """Return how places (m, n, 3) with u on circles of a radius, (m, 1), lie together, of the parts that are not zero
    by convention, and the rest of each place; both by least squares over the places that a run has."""
    m, n, _ = values.shape
    angle, zero, one = nominal_angles(n), np.zeros(n), np.ones(n)
    columns = np.stack([np.stack(axes, axis=-1) for axes in (
        (-np.sin(angle), np.cos(angle), zero), (zero, zero, one), (one, zero, zero), (zero, one, zero),
        (zero, zero, np.sin(angle)), (zero, zero, -np.cos(angle)), (np.cos(angle), np.sin(angle), zero))], axis=-1)
    parts, spread, rest = np.full((m, 7), np.nan), np.full((m, 7), np.nan), np.full_like(values, np.nan)
    for run in range(m):
        known = np.all(np.isfinite(values[run]), axis=1)
        if np.count_nonzero(known) >= LEAST_PLACES:
            inverse = np.linalg.pinv(columns[known].reshape(-1, 7))
            parts[run] = inverse @ values[run, known].ravel()
            spread[run] = np.sqrt(inverse**2 @ u[run, known].ravel()**2)
            rest[run] = values[run] - columns @ parts[run]
    size, what = (('size of the CMM positions', 'CMM positions') if owner == 'frame' else
                  ('size of the plate, or scale of the CMM', 'balls'))
    return [TimeSeries(*(('size', size) if name == 'size' else (owner, f'{what} in the frame, {name}')),
                       *((parts[:, place] / radius, spread[:, place] / radius, 'rad') if name in _ANGLES else
                         (parts[:, place], spread[:, place])))
            for name, place in _TOGETHER.items()
            if np.any(np.abs(parts[:, place]) > LEAST_SHARE * spread[:, place])], rest


def _effects(rows: Sequence[Mapping[str, Any]]) -> list[TimeSeries]:
    """Return the parameters of the effects in the model."""
    series: dict[tuple[str, str, str], dict[int, tuple[float, float]]] = {}
    for place, row in enumerate(rows):
        for effect in row['effects'] or ():
            for one in effect['parameters'] if effect['in_model'] else ():
                series.setdefault((effect['effect'], one['name'], one['unit']), {})[place] = (
                    one['value'], one['U'] / COVERAGE_FACTOR)
    found = []
    for (effect, name, unit), known in series.items():
        pair = np.array([known.get(place, (np.nan, np.nan)) for place in range(len(rows))])
        found.append(TimeSeries(effect, f'{effect} {name}', pair[:, :1], pair[:, 1:], unit))
    return found


def _residual(rows: Sequence[Mapping[str, Any]]) -> TimeSeries:
    rms = np.array([[row['rms_m']] for row in rows])
    return TimeSeries('residual', 'residual, rms', rms, rms / np.sqrt(2.0 * np.array([[row['dof']] for row in rows])))


@dataclass(frozen=True, eq=False)
class TableTrend:
    """The trend of a table. decided: on each tolerance by the last run (ISO 14253-1); recent: changes among the last
    runs; warnings: both in sentences."""

    history: History
    events: tuple[Event, ...]
    forecasts: Mapping[str, Forecast]
    decided: Mapping[str, Conformity]
    recent: tuple[Event, ...]
    warnings: tuple[str, ...]

    @property
    def unkept(self) -> tuple[str, ...]:
        """Errors that are not within their tolerance for certain."""
        return tuple(curve for curve, one in self.decided.items() if one is not Conformity.CONFORMS)

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
        return made + ([results.forecast_table(self.forecasts, self.decided, history.dates[-1])]
                       if self.forecasts else [])

    def pictures(self) -> dict[str, Figure]:
        """Return its figures by name: ranges over time, and what changed of the curves where they did."""
        history = self.history
        made = {'ranges': results.ranges_over_time(
            history.dates, history.range, history.U, history.tolerances, self.events, self.forecasts)}
        if any(event.curves for event in self.events):
            made['changes'] = results.changes_of_curves(self.events, history.dates)
        return made

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
    said = list[str]()
    for curve, limit in history.tolerances.items():
        place = CURVES.index(curve)
        value, expanded = float(history.range[-1, place]), float(history.U[-1, place])
        if (found := history.decided[curve]) is not Conformity.CONFORMS:
            factor, unit = text.curve_scales()[place]
            said.append(f'{curve} {factor * value:.3g} ± {factor * expanded:.2g} {unit}: {found} to its tolerance of '
                        f'{tolerance_words(limit)}')
    for event in recent:
        strongest = event.steps[0]
        said.append(f'{names(event.owners)} changed between {history.dates[event.earliest - 1]:%Y-%m-%d} and '
                    f'{history.dates[event.latest]:%Y-%m-%d}: {strongest.series.name} by '
                    f'{results.size_words(strongest)}')
    return TableTrend(history, events, history.forecasts(events), history.decided, recent, tuple(said))

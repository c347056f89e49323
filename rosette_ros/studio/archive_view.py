# SPDX-License-Identifier: Apache-2.0
"""What the studio shows of an archive: its runs by a filter, their curves beside each other, the trend of a table."""

import datetime
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rosette_ros.archive.plant import LEVELS, plant_of, plant_table
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_question import Question
from rosette_ros.archive.run_row import decided_by
from rosette_ros.archive.stored_causes import causes_of_text
from rosette_ros.archive.table_history import TableTrend, limits_of, read_history, trend_of
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import difference, worst_of
from rosette_ros.presentation.cell_results import LEAST_SHOWN, CauseDot, CausesOfRuns
from rosette_ros.presentation.formatting import curve_scales
from rosette_ros.presentation.json_output import CURVE_KEYS
from rosette_ros.presentation.report.page_parts import inline_svgs
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.effect_words import decimals, plain_name
from rosette_ros.words.motion_words import member_words

MOST_CAUSES, EVEN = 20, 0.5
"""Causes that are shown against runs, and the probability that one of the runs exceeds."""
MOST_LISTED = 1000
"""Runs that are listed, the newest ones."""
_KEY = "concat(log_sha256, ' ', run_id)"
_LISTED = f'''
    SELECT {_KEY} AS key, path, run_id, strftime(measured_at, '%Y-%m-%d %H:%M') AS measured, table_serial AS "table",
        cell, n, 1e6 * rms_m AS rms, coalesce(level, '') AS level, array_to_string(missing, ' + ') AS lacks,
        outcome, doubt, identity, rotation, {', '.join(f'range_{key}, U_range_{key}' for key in CURVE_KEYS)}
    FROM runs WHERE {{}} AND model_hash = ? ORDER BY measured_at DESC NULLS LAST, run_id LIMIT {MOST_LISTED}'''


@dataclass(frozen=True)
class ArchiveRuns:
    """Runs of an archive under one model. models: hash and number of runs, most first; tables: serial numbers;
    lines: those that a filter leaves, newest first, with ranges in units of curve_units, and what they decide on
    stated tolerances, '' without one, with its level; total: how many runs the archive has under the model."""

    model: str
    models: tuple[tuple[str, int], ...]
    tables: tuple[str, ...]
    lines: tuple[dict[str, Any], ...]
    total: int


def list_runs(folder: str, question: Question, model: str = '') -> ArchiveRuns:
    """Return the runs of an archive that a question asks for; model: hash, '' for that of most runs."""
    archive = RunArchive(folder)
    models = tuple((row['model_hash'], row['runs']) for row in archive.query(
        "SELECT model_hash, count(*) AS runs FROM runs WHERE problem = '' GROUP BY 1 ORDER BY 2 DESC, 1").to_pylist())
    if not models:
        raise InvalidData(f'{folder}: expected an archive with runs, found one without; add some')
    model = model or models[0][0]
    tables = archive.query("SELECT DISTINCT table_serial AS name FROM runs WHERE problem = '' ORDER BY 1").to_pylist()
    condition, values = question.condition()
    lines = archive.query(_LISTED.format(condition), [*values, model]).to_pylist()
    return ArchiveRuns(model, models, tuple(row['name'] for row in tables), tuple(map(_line, lines)),
                       dict(models).get(model, 0))


def _line(row: dict[str, Any]) -> dict[str, Any]:
    """Return a line of the list."""
    line = {key: row[key] for key in ('key', 'path', 'run_id', 'measured', 'table', 'cell', 'n', 'level', 'lacks')}
    for curve, key, (factor, _) in zip(CURVES, CURVE_KEYS, curve_scales(), strict=True):
        line[curve] = round(factor * row[f'range_{key}'], decimals(factor * row[f'U_range_{key}']))
    worst = worst_of(decided_by(row, limits_of([row])).values())
    return {**line, 'rms': f'{row["rms"]:.3f}', 'tolerances': worst or '',
            'tolerance_level': LEVELS[worst] if worst else ''}


def causes_of(folder: str, keys: Sequence[str], model: str) -> tuple[CausesOfRuns, tuple[tuple[str, str], ...]]:
    """Return the causes of runs by their keys, those that are the most probable in all runs together, each run by
    itself, in the order of time, with path and run_id of each run.

    Raises InvalidData where no row keeps what its run says of causes."""
    rows = RunArchive(folder).read_rows(
        where=f"list_contains(?, {_KEY}) AND model_hash = ? AND causes <> ''", values=(list(keys), model)).to_pylist()
    if not rows:
        raise InvalidData(f'{folder}: expected runs with what they say of causes, found none; add them again with: '
                          'rosette archive add --force')
    rows.sort(key=lambda row: (row['measured_at'] is None, row['measured_at'], row['run_id']))
    every = [causes_of_text(row['causes']).alone for row in rows]
    total = Counter[str]()
    for one in every:
        total.update(one)
    names = [name for name, sum_ in total.most_common(MOST_CAUSES) if max(one.get(name, 0.0) for one in every) > EVEN]
    sizes = [{one['effect']: one['rms_m'] for one in row['effects'] or ()} for row in rows]
    dots = tuple(CauseDot(place, run, one[name], sizes[run].get(name)) for place, name in enumerate(names)
                 for run, one in enumerate(every) if one.get(name, 0.0) >= LEAST_SHOWN)
    said = tuple(plain_name(one) or member_words(one) for one in names)
    return (CausesOfRuns(said, tuple(map(_name_of, rows)), dots),
            tuple((row['path'], row['run_id']) for row in rows))


def _name_of(row: dict[str, Any]) -> str:
    return f'{row["run_id"]}{row["measured_at"]: %Y-%m-%d}' if row['measured_at'] else str(row['run_id'])


def curves_of(folder: str, keys: Sequence[str], model: str) -> list[tuple[str, ErrorMotions]]:
    """Return name and curves of runs by their keys, in the order of time."""
    rows = RunArchive(folder).read_rows(where=f'list_contains(?, {_KEY}) AND model_hash = ?',
                                        values=(list(keys), model)).to_pylist()
    rows.sort(key=lambda row: (row['measured_at'] is None, row['measured_at'], row['run_id']))
    return [(_name_of(row), ErrorMotions(
        np.array(row['angle_rad']), np.column_stack([row[key] for key in CURVE_KEYS]),
        np.column_stack([row[f'U_{key}'] for key in CURVE_KEYS]) / COVERAGE_FACTOR)) for row in rows]


def less_earliest(curves: Sequence[tuple[str, ErrorMotions]]) -> list[tuple[str, ErrorMotions]]:
    """Return the curves less those of the first, with the uncertainty of both; raises InvalidData for other angles."""
    (first, base), *others = curves
    made = []
    for name, motions in others:
        less = difference(motions, base)
        if less is None:
            raise InvalidData(f'expected runs at the same table angles, found {name} with {_angles(motions)} and '
                              f'{first} '
                              f'with {_angles(base)}')
        made.append((f'{name} less {first}', less))
    return made


def _angles(motions: ErrorMotions) -> str:
    return f'{len(motions.angle)} from {np.rad2deg(motions.angle[0]):.6g}°'


def table_trend(folder: str, table: str, model: str) -> tuple[TableTrend, str]:
    """Return the trend of a table under a model, and what changed of its curves as a picture (SVG), '' where nothing
    did; raises InvalidData where it has few runs."""
    trend = trend_of(read_history(RunArchive(folder), table, model))
    changes = {name: made for name, made in trend.pictures().items() if name == 'changes'}
    return trend, ''.join(inline_svgs(changes).values())


def plant_table_of(folder: str) -> Table:
    """Return all tables of an archive in a line each, the most urgent first; raises InvalidData where none is known."""
    return plant_table(plant_of(RunArchive(folder), datetime.datetime.now(datetime.UTC)))

# SPDX-License-Identifier: Apache-2.0
"""Answers of an archive: to SQL, to the questions that most ask, what may move in the cell of a table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_question import Question
from rosette_ros.archive.run_row import AXES
from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.run.errors import InvalidData, counted
from rosette_ros.core.run.records import Run
from rosette_ros.core.sight.visibility import GOOD_SHARE, visibility
from rosette_ros.core.uncertainty.hidden_effects import at_ball, kind_of, size_per_rms
from rosette_ros.core.uncertainty.stated_environment import KINDS, Environment, Size
from rosette_ros.io.open_run import open_run
from rosette_ros.presentation.json_output import CURVE_KEYS

_BOTH = (*CURVE_KEYS, *(f'U_{key}' for key in CURVE_KEYS))
_DEVIATIONS = tuple(f'{prefix}{what}_{axis}_m' for prefix in ('', 'U_') for what in ('plate', 'cmm') for axis in AXES)
_OF = 'log_sha256, run_id, model_hash, table_serial, measured_at'
VIEWS: Mapping[str, str] = {
    'effects': f'''
        SELECT {_OF}, e.effect, e.in_model, e.rms_m, e.setting, p.name AS parameter, p.value, p.U, p.unit
        FROM (SELECT {_OF}, unnest(effects) AS e FROM runs) LEFT JOIN LATERAL (SELECT unnest(e.parameters) AS p) ON true
    ''',
    'curves': f'SELECT {_OF}, unnest(range(1, n + 1)) AS position, '
              f'{", ".join(f"unnest({name}) AS {name}" for name in ("angle_rad", *_BOTH))} FROM runs',
    'deviations': f'SELECT {_OF}, unnest(range(1, n + 1)) AS place, '
                  f'{", ".join(f"unnest({name}) AS {name}" for name in _DEVIATIONS)} FROM runs'}
"""Besides `runs`, in SQL: a row for each parameter of an effect, each angle of the curves, each ball and CMM position.
"""
_ROWS = '''SELECT path, run_id, effects FROM runs WHERE problem = '' AND table_serial = ? AND missing IS NOT NULL
    QUALIFY row_number() OVER (PARTITION BY log_sha256, run_id ORDER BY added_at DESC) = 1
    ORDER BY measured_at, path, run_id'''
_ASKED = '''SELECT path, run_id FROM runs WHERE {}
    QUALIFY row_number() OVER (PARTITION BY log_sha256, run_id ORDER BY added_at DESC) = 1
    ORDER BY measured_at, path, run_id'''


def runs_asked_for(archive: RunArchive, question: Question) -> list[tuple[str, str]]:
    """Return path and run_id of each run that a question asks for, under whichever model, the earliest first.

    Raises as `ask_for`, and InvalidData where there is none."""
    condition, values = question.condition()
    rows = archive.query(_ASKED.format(condition), values).to_pylist()
    if not rows:
        raise InvalidData(f'{archive.folder}: expected runs that are asked for, found none; rosette archive query '
                          f'{archive.folder} lists all')
    return [(row['path'], row['run_id']) for row in rows]


def ask(archive: RunArchive, sql: str) -> pa.Table:
    """Return the answer to a question in SQL over `runs` and VIEWS; raises InvalidData where it cannot be answered."""
    try:
        return archive.query(sql, views=VIEWS)
    except InvalidData as error:
        if isinstance(error.__cause__, duckdb.PermissionException):
            raise InvalidData(f'{archive.folder}: expected a question about the archive alone, found one that reads '
                              f'other files; join them with the answer (--csv, --json) in the program that has them'
                              ) from error
        if isinstance(error.__cause__, (duckdb.ParserException, duckdb.CatalogException, duckdb.BinderException)):
            raise InvalidData(f'{error}; there are the views runs, {", ".join(VIEWS)}: --columns explains the columns '
                              'of runs, the SQL "DESCRIBE curves" lists those of another one') from error
        raise


def ask_for(archive: RunArchive, question: Question) -> pa.Table:
    """Return the answer to a ready question.

    Raises InvalidData where a time or level in it is none, InvalidModel where an effect is none."""
    return archive.query(*question.sql())


@dataclass(frozen=True)
class Shown:
    """What one run says: the size of each effect that was found, as displacement of a ball, and of each that it would
    have shown the size from which on it is found nearly always, m."""

    found: dict[str, float]
    bounds: dict[str, float]


def shown_by(run: Run, effects: Sequence[dict[str, Any]]) -> Shown:
    """Return what a run says; effects: that were found, as an archive keeps them."""
    per_rms, found = size_per_rms(run), dict[str, float]()
    for one in effects:
        if one['effect'] in per_rms:
            size = one['rms_m'] * per_rms[one['effect']]
            found[one['effect']] = float(np.hypot(found.get(one['effect'], 0.0), size))
    bounds = {one.name: one.detectable / 3**0.5 * per_rms[one.name]
              for one in visibility(run, run.repeatability or 1e-7)
              if one.name in per_rms and not one.reason and one.typical_share >= GOOD_SHARE}
    return Shown(found, bounds)


def environment_of_cell(archive: RunArchive, serial: str, otherwise: Environment) -> Environment:
    """Return the Environment that the runs of a table in an archive show; otherwise: of what none of them shows.

    The variance of an effect is the mean of the squares of its sizes over the runs that show it, and a found one has
    it by itself. One that was never found is taken as if one of these runs had had it, anywhere up to the size at which
    it would have been found: bound^2 / 3 / runs; these add up to the number to which it belongs.
    Raises InvalidData where no run of the table can be opened."""
    rows = archive.query(_ROWS, (serial,)).to_pylist()
    every = list[Shown]()
    for row in rows:
        try:
            run = open_run(row['path'], row['run_id'] or None)
        except InvalidData:
            continue  # a log that was moved shows nothing any more
        every.append(shown_by(run, row['effects']))
    if not every:
        raise InvalidData(f'{archive.folder}: expected diagnosed runs of table {serial} whose logs are still there, '
                          'found '
                          f'none of {counted(len(rows), "run")}')
    left, lever = at_ball(otherwise, run), run.radius
    effects, kinds = dict[str, Size](), {kind: [0.0, 0] for kind in KINDS}
    for name in left:
        kind = kind_of(LAWS[name])
        sizes = [one.found[name] for one in every if name in one.found]
        shown = sum(name in one.found or name in one.bounds for one in every)
        if sizes:
            effects[name] = Size(float(np.sqrt(np.sum(np.square(sizes)) / shown)),
                                 f'found in {len(sizes)} of {counted(shown, "run")} of table {serial}')
            continue
        bound = min((one.bounds[name] for one in every if name in one.bounds), default=None)
        kinds[kind][0] += left[name]**2 if bound is None else bound**2 / 3 / shown
        kinds[kind][1] += bound is None
    numbers = {}
    for kind, (square, unknown) in kinds.items():
        words = f'not found in {counted(len(every), "run")} of table {serial}' + (
            f'; {counted(int(unknown), "effect")} that none shows as {otherwise.name}' if unknown else '')
        numbers[kind] = Size(float(np.sqrt(square)) / (lever if KINDS[kind].si == 'rad' else 1.0), words)
    return Environment(f'table {serial}', numbers, effects)

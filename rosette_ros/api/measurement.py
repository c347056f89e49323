# SPDX-License-Identifier: Apache-2.0
"""A run as it is opened: from a log, a table, a file of a laboratory's own or a DataFrame; and what follows from it."""

import html
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.analysis import MOST_BALLS_JUDGED, RunResult, analyse, find
from rosette_ros.api.result import frame_of, html_of
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.diagnosis.verdict import Verdict
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.records import ErrorMotions, Run
from rosette_ros.core.run.typed_words import as_typed
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.budget_file import budget_inputs, read_stated, source_of
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.experience_file import read_experience
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.model_file import read_model
from rosette_ros.io.open_run import has_plate, open_identified, open_readings
from rosette_ros.io.own_readers import Columns, run_of_table
from rosette_ros.io.run_to_log import write_log
from rosette_ros.io.type_definitions import StoredTypes
from rosette_ros.presentation.formatting import run_size, unmeasured_words
from rosette_ros.presentation.joint_results import joint_head
from rosette_ros.presentation.table_format import Table, column
from rosette_ros.words.effect_words import fixed
from rosette_ros.words.reading_words import notes_of, readings_notes, remark_words

Doing = Callable[[str], AbstractContextManager[object]]
"""What tells a person what is done while a block runs."""


class Measurement:
    """A run, who measured what where, and where it came from; made by `read` and `simulate`.

    path: of the file, '' where there is none; stated: an identity file; columns: of a foreign table; truth: of a
    simulated machine, the six curves without the parts that no run can know."""

    def __init__(self, run: Run | None = None, path: str = '', run_id: str | None = None,
                 columns: ColumnMap | None = None, stated: str | Path | None = None, truth: ErrorMotions | None = None
                 ) -> None:
        self.path, self.run_id, self.truth, self.columns, self.stated = path, run_id, truth, columns, stated
        self._run = run

    @cached_property
    def _opened(self) -> tuple[Run, Identity]:
        if self._run is not None:
            return self._run, Identity()
        return open_identified(self.path, self.run_id, self.stated, self.columns)[:2]

    @property
    def run(self) -> Run:
        """The run, as the core has it."""
        return self._opened[0]

    @property
    def identity(self) -> Identity:
        """Who, what and where, and tolerances."""
        return self._opened[1]

    @cached_property
    def readings(self) -> Readings:
        """The run as one of several, which may have a plate of any pitch."""
        return open_readings(self.path, self.run_id, self.columns) if self.path else Readings.of(self.run, None)

    @cached_property
    def has_plate(self) -> bool:
        """Whether it is a table with a plate file, which is evaluated as one of several runs is."""
        return bool(self.path) and has_plate(self.path)

    @property
    def name(self) -> str:
        """What it is called: its run_id, else where it came from."""
        return (self.readings.run_id if self.has_plate else self.run.run_id) or self.path or self.run.source

    def sentences(self) -> tuple[str, ...]:
        """Return what was measured, what is missing and how it was read."""
        if self.has_plate:
            return joint_head(self.readings), *readings_notes(self.readings)
        run = self.run
        return tuple(filter(None, (f'{self.name}: {run_size(run)}', unmeasured_words(run), *notes_of(run),
                                   *map(remark_words, run.remarks))))

    @property
    def table(self) -> Table:
        """The readings, a row each, coordinates in mm in the table frame."""
        run = self.run
        return Table('readings', f'Readings of {self.name}', (
            column('table_position', 'table position', run.table_position, str), column('ball', 'ball', run.ball, str),
            column('cmm_position', 'CMM position', run.cmm_position, str),
            *(column(f'{axis}_mm', axis, 1e3 * run.centre[:, place], partial(fixed, places=5), 'mm')
              for place, axis in enumerate('xyz')),
            column('table_angle_deg', 'table angle', np.rad2deg(run.table_angle), partial(fixed, places=4), '°'),
            column('time_s', 'time', run.time, partial(fixed, places=1), 's'),
            column('temperature_C', 'temperature', run.temperature, partial(fixed, places=2), '°C'),
            column('approach', 'approach', run.approach, str)))

    def to_frame(self) -> Any:
        """Return the readings as a DataFrame (pandas)."""
        return frame_of(self.table)

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write a ball-centre table where the name ends in .csv, else a log, and return the path.

        Raises InvalidData where the file exists, unless `force`; a log is never overwritten."""
        if Path(path).suffix.lower() == '.csv':
            write_csv(self.run, path, force)
            return Path(path)
        return write_log(self.run, path, StoredTypes())

    def __len__(self) -> int:
        return self.run.size

    def __str__(self) -> str:
        return '\n'.join(self.sentences())

    def __repr__(self) -> str:
        return f'<Measurement: {self.sentences()[0]}>'

    def _repr_html_(self) -> str:
        return ''.join(f'<p>{html.escape(one)}</p>' for one in self.sentences()) + html_of(self.table.first(5))


class JudgedRun:
    """A measurement under a model, in an environment where one is stated; everything is calculated once.

    model, inputs: a file or what it says, None for the base model and for no statement; environment: a class, which
    takes the place of what `inputs` says of it; doing: tells what is done; experience, any_cell: as of
    `with_experience`."""

    def __init__(self, measured: Measurement, model: 'Model | str | Path | None' = None,
                 inputs: 'Mapping[str, Any] | str | Path | None' = None, environment: str | None = None,
                 doing: Doing = lambda words: nullcontext(), experience: 'Experience | str | Path | None' = None,
                 any_cell: bool = False) -> None:
        self.measured, self.run, self.identity, self.path = measured, measured.run, measured.identity, measured.path
        self._model, self._stated, self._doing = model, (inputs, environment), doing
        self._experience = experience, any_cell

    @cached_property
    def model(self) -> Model:
        """That which is given, the base model without one, with what earlier runs have taught."""
        return with_experience(model_of(self._model), *self._experience, self.measured)

    @cached_property
    def inputs(self) -> BudgetInputs | None:
        """What is stated for the uncertainty budget, None where nothing is."""
        return stated_inputs(*self._stated, self.model.experience)

    @cached_property
    def fit(self) -> Fit:
        """The least squares."""
        with self._doing('evaluating'):
            return analyse(self.run, self.model)

    @cached_property
    def finding(self) -> Diagnosis | None:
        """What is missing, None where the plate has too many balls to judge it unasked."""
        if self.run.n > MOST_BALLS_JUDGED:
            return None
        fit = self.fit
        with self._doing('looking for what is missing'):
            return find(fit.run, fit.model)

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None as for `finding`."""
        return self.result.verdict

    @cached_property
    def result(self) -> RunResult:
        """The result, and the fit as modelled beside it."""
        return RunResult(self.fit, self.finding, self.inputs)

    @property
    def motions(self) -> ErrorMotions:
        """The six curves of the result, with U."""
        return self.result.curves.motions


def model_of(given: 'Model | str | Path | None') -> Model:
    """Return the Model that is given, or that of a file; without one the base model."""
    return given if isinstance(given, Model) else read_model(given)


def with_experience(model: Model, given: 'Experience | str | Path | None', any_cell: bool,
                    measured: Measurement) -> Model:
    """Return a model with what earlier runs of the cell of a measurement have taught, an Experience or its file.

    any_cell: whether that of another table or CMM is taken, too, which is refused else. Raises InvalidData."""
    if given is None:
        return model
    known = experience_of(given)
    if not any_cell:
        refuse_other_cell(known, measured.identity, f'{measured.name}: expected a run')
    return replace(model, experience=known)


def experience_of(given: 'Experience | str | Path') -> Experience:
    """Return the Experience that is given, or that of a file; raises InvalidData."""
    return given if isinstance(given, Experience) else read_experience(given)


def refuse_other_cell(known: Experience, identity: Identity, wanted: str) -> None:
    """Refuse an experience of another table or CMM than an identity states; wanted: of what, as the error begins.

    Raises InvalidData."""
    for words, taught, stated in (('table', known.table, identity['table.serial']),
                                  ('CMM', known.cmm, identity['cmm.serial'])):
        if taught and stated and taught != stated:
            option = as_typed('--any-cell', 'any_cell=True')
            raise InvalidData(f'{wanted} of {words} {taught}, of which {known.runs} runs have taught the experience, '
                              f'found {words} {stated}; {option} takes it all the same')


def stated_inputs(inputs: 'Mapping[str, Any] | str | Path | None', environment: str | None,
                  experience: Experience | None = None) -> BudgetInputs | None:
    """Return what is stated for the uncertainty budget; raises InvalidData as a file does.

    experience: what earlier runs of the cell have taught of the environment that is stated."""
    stated = read_stated(inputs, environment)
    return budget_inputs(stated, source_of(inputs)).knowing(experience) if stated else None


def read(source: Any, columns: 'Columns | str | None' = None, run_id: str | None = None,
         identity: str | Path | None = None) -> Measurement:
    """Return the run of a log directory, an .mcap file, a table (CSV, AQDEF, QIF ...), a row of an archive, or a
    DataFrame.

    columns: what is which column of a table of another program or of a DataFrame, and what else its heading would say,
    as in {'table': 'Pos', 'ball': 'Kugel', 'x': 'X', 'y': 'Y', 'z': 'Z', 'radius_mm': 182.5}, or a file of `rosette
    import --save`; run_id: which run, where a log holds several; identity: a file that states who, what and where.
    Raises InvalidData where it is none of these."""
    if isinstance(source, Measurement):
        return source
    if isinstance(source, Run):
        return Measurement(source)
    if not isinstance(source, str | Path):
        if isinstance(columns, str):
            raise InvalidData(f'columns: expected a mapping beside a DataFrame, found {columns!r:.80}')
        row = archive_row(source)
        return read(row, columns, run_id, identity) if row else Measurement(run_of_table(source, columns))
    given = columns if isinstance(columns, str) or columns is None else {
        key: str(value) for key, value in columns.items()}
    places = read_columns(given)
    made = Measurement(None, str(source), run_id, places, identity)
    made.sentences()  # reads it
    return made


def archive_row(source: Any) -> str:
    """Return the path of the log that a row of `rosette archive list` names, '' for anything else."""
    try:
        path = source['path'] if getattr(source, 'ndim', 0) == 1 or isinstance(source, Mapping) else ''
    except (KeyError, TypeError):
        return ''
    return path if isinstance(path, str) else ''


def several(runs: Any) -> list[Measurement]:
    """Return the runs that are given: one or a list of them, each as `read` takes it; raises RosetteError for none."""
    made = [read(one) for one in runs] if isinstance(runs, list | tuple) else [read(runs)]
    if not made:
        raise RosetteError('runs: expected at least one, found none')
    return made

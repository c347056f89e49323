# SPDX-License-Identifier: Apache-2.0
"""The row that an archive keeps of a run under a model: its columns, and how they follow from an evaluation."""

import datetime
import json
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from rosette_ros.analysis import RunResult
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.records import CURVES, Floats
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import Conformity, conformity, doubt_of
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS
from rosette_ros.core.uncertainty.stated_environment import Environment
from rosette_ros.invocation import __version__
from rosette_ros.io.identity_file import Identity, format_identity
from rosette_ros.io.reading_checks import known_temperatures
from rosette_ros.presentation.json_output import CURVE_KEYS
from rosette_ros.presentation.report.provenance import Source, order_of
from rosette_ros.presentation.table_format import verdict_json
from rosette_ros.words.verdict_words import unexplained_words, verdict_text

AXES = 'xyz'
KEY = ('log_sha256', 'run_id', 'model_hash')
"""What a row is of: a run of a log under a model. Of several rows with one key the one that was added last counts."""
OF_EVERY_ROW = (*KEY, 'path', 'stamp', 'version', 'added_at', 'problem')
"""Columns that are never empty: which of several rows counts is decided by them."""
SERIALS = ('table', 'plate', 'cmm', 'probe')
"""Devices of the identity whose serial numbers are columns."""
STATED = ('measured_at', 'ended_at', 'place', 'identity', *(f'{one}_serial' for one in SERIALS))
"""Columns that follow from the identity, wherever it was stated."""

_TEXT, _REAL, _WHOLE, _REALS = pa.string(), pa.float64(), pa.int32(), pa.list_(pa.float64())
_TIME = pa.timestamp('us', 'UTC')
_PARAMETER = pa.struct([('name', _TEXT), ('value', _REAL), ('U', _REAL), ('unit', _TEXT)])
_EFFECT = pa.struct([('effect', _TEXT), ('in_model', pa.bool_()), ('rms_m', _REAL), ('setting', _TEXT),
                     ('parameters', pa.list_(_PARAMETER))])

COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ('log_sha256', _TEXT, 'SHA-256 of the content of the log, hex: that of its one file, or of the digests of its '
                          'files in the order of their names; empty where it could not be read at all'),
    ('run_id', _TEXT, 'name of the run in the log; empty where a table states none, or if the log is no good'),
    ('model_hash', _TEXT, 'SHA-256 of the model, hex, as rosette evaluate shows it'),
    ('model', _TEXT, 'the model as JSON, rosette-model/1'),
    ('version', _TEXT, 'version of rosette that evaluated the run'),
    ('path', _TEXT, 'where the log was found first: absolute path or URL'),
    ('stamp', _TEXT, 'size and time of the files of the log: while they stay, it is not read again'),
    ('added_at', _TIME, 'when the row was made'),
    ('problem', _TEXT, 'why there is no evaluation, in a line; empty where there is one. With a problem all columns '
                       'below are null'),
    ('measured_at', _TIME, 'first entry of the log or, where that is not dated, the first day of measuring that the '
                           'identity states; null where neither is known'),
    ('ended_at', _TIME, 'last entry of the log, or the last day of measuring; null where neither is known'),
    ('cell', _TEXT, 'namespace of the cell on the graph; empty for a table'),
    ('place', _TEXT, 'place of the calibration by the identity; empty where not stated'),
    *((f'{device}_serial', _TEXT, f'serial number of the {device} by the identity; empty where not stated')
      for device in SERIALS),
    ('identity', _TEXT, 'all that the identity states, tolerances too, as YAML, rosette-identity/1; may be empty'),
    ('simulated', pa.bool_(), 'whether no real CMM measured the run'),
    ('n', _WHOLE, 'balls of the plate and positions of the table'),
    ('radius_m', _REAL, 'nominal radius of the circle of ball centres'),
    ('mean_radius_m', _REAL, 'mean radius as measured'),
    ('readings', _WHOLE, 'ball centres'),
    ('completeness', _REAL, 'measured part of the n × n pairs of table position and ball'),
    ('plan', _TEXT, 'order of measurement in words'),
    ('temperature_mean_C', _REAL, 'mean temperature of the readings; null where not recorded'),
    ('temperature_min_C', _REAL, 'lowest temperature; null where not recorded'),
    ('temperature_max_C', _REAL, 'highest temperature; null where not recorded'),
    ('repeatability_m', _REAL, 'standard deviation of a coordinate from repeated readings; null where not known'),
    ('rms_m', _REAL, 'residual under the model, root of the square sum per degree of freedom'),
    ('sigma_m', _REAL, 'standard deviation of a coordinate on which the uncertainties rest'),
    ('environment', _TEXT, 'name of the environment of which U contains what the order hides; empty where none is '
                           'stated'),
    ('dof', _WHOLE, 'degrees of freedom of the residual'),
    ('lack_of_fit_p', _REAL, 'p-value of the lack-of-fit test; null where not known'),
    ('final_rms_m', _REAL, 'residual with all that the diagnosis names; null where there was none'),
    ('outcome', _TEXT, 'what the run decides about the model; null on plates too large to be judged unasked'),
    ('level', _TEXT, 'good, doubtful or bad; null likewise'),
    ('verdict', _TEXT, 'the verdict in a sentence; null likewise'),
    ('action', _TEXT, 'what to do next; null likewise'),
    ('missing', pa.list_(_TEXT), 'effects that the diagnosis names and the model lacks, strongest first'),
    ('unexplained', _TEXT, 'what is left that no named effect explains, in words; empty where nothing is'),
    ('effects', pa.list_(_EFFECT), 'effects with their rms and parameters (value, U: k = 2, unit): in_model says '
                                   'whether it stands in the model or the diagnosis names it'),
    ('causes', _TEXT, 'what the run says of causes, for archive experience: hypotheses that its search visited, with '
                      'their log evidence (JSON, rosette-run-causes/1); null on plates too large to be judged unasked'),
    ('rotation', _REALS, 'of the table frame in the machine frame, 9 values row by row; null where not known'),
    ('result', _TEXT, 'which curves these are: all explanations averaged where something is missing, else as modelled; '
                      'null where a version wrote the row that kept those as modelled'),
    ('angle_rad', _REALS, 'the n table angles of the curves'),
    *((key, _REALS, f'error motion at the n angles, {key.partition("_")[0]} (VDI/VDE 2617): the result')
      for key in CURVE_KEYS),
    *((f'U_{key}', _REALS, f'its expanded uncertainty at each angle, k = {COVERAGE_FACTOR}') for key in CURVE_KEYS),
    *((f'range_{key}', _REAL, 'range of the curve, the synchronous error motion value (ISO 230-7)')
      for key in CURVE_KEYS),
    *((f'U_range_{key}', _REAL, f'its expanded uncertainty, k = {COVERAGE_FACTOR}') for key in CURVE_KEYS),
    ('doubt', _TEXT, 'why U does not say how large the errors are, so that no tolerance is decided; empty where it '
                     'does; null where a version wrote the row that did not keep it'),
    *((f'{prefix}{what}_{axis}_m', _REALS, f'{words} {axis} at the n {places}, in the order of their numbers')
      for what, places in (('plate', 'balls'), ('cmm', 'CMM positions'))
      for prefix, words in (('', f'deviation of the {"plate" if what == "plate" else "CMM"} along'),
                            ('U_', f'expanded uncertainty, k = {COVERAGE_FACTOR}, of the deviation along'))
      for axis in AXES),
)
"""Name, type and meaning of every column, SI units."""
SCHEMA = pa.schema([pa.field(name, kind, metadata={'meaning': meaning}) for name, kind, meaning in COLUMNS])
"""Of the Parquet files."""

Row = dict[str, Any]
"""A value by the name of each column; a column that is not there is null."""


def heading(log_sha256: str, path: str, stamp: str, model: Model, added_at: datetime.datetime, run_id: str = '',
            problem: str = '') -> Row:
    """Return what a row says without an evaluation."""
    return {'log_sha256': log_sha256, 'run_id': run_id, 'model_hash': model.hash,
            'model': json.dumps(model.to_mapping(), ensure_ascii=False), 'version': __version__, 'path': path,
            'stamp': stamp, 'added_at': added_at, 'problem': problem}


def evaluation_row(fit: Fit, finding: Diagnosis | None = None, source: Source | None = None, cell: str = '',
                   identity: Identity | None = None, environment: Environment | None = None,
                   causes: str | None = None) -> Row:
    """Return what a row says of an evaluation.

    finding: None where the run was not diagnosed; source: of the run, None where it comes from no file; identity: in
    place of that of the source; environment: that is stated, which curves and U are taken in; causes: the column of
    that name."""
    run, stated = fit.run, BudgetInputs(environment=environment if fit.run.n <= MOST_BALLS else None)
    result = RunResult(fit, finding, stated)
    known = known_temperatures(run)
    identity = identity or (source.identity if source else Identity())
    verdict, in_model = result.verdict, len(fit.effects)
    motions, lines = result.curves.motions, result.curves.lines()
    return {
        'measured_at': _time(source.begun if source else '', identity['measured.begin']),
        'ended_at': _time(source.ended if source else '', identity['measured.end']), 'cell': cell,
        'place': identity['place.name'], **{f'{one}_serial': identity[f'{one}.serial'] for one in SERIALS},
        'identity': format_identity(identity), 'simulated': run.simulated, 'n': run.n, 'radius_m': run.radius,
        'mean_radius_m': fit.mean_radius, 'readings': run.size, 'completeness': run.completeness,
        'plan': order_of(run, source),
        **dict(zip((f'temperature_{name}_C' for name in ('mean', 'min', 'max')),
                   (float(one) for one in (known.mean(), known.min(), known.max())) if known.size else (None,) * 3)),
        'repeatability_m': run.repeatability, 'rms_m': fit.rms, 'sigma_m': fit.sigma,
        'environment': stated.environment.name if stated.environment else '', 'dof': fit.dof,
        'lack_of_fit_p': fit.lack_of_fit_p, 'final_rms_m': finding.final.rms if finding else None,
        **verdict_json(verdict_text(verdict) if verdict else None),
        'missing': list(finding.missing) if finding else None,
        'unexplained': unexplained_words(verdict) if verdict else None,
        'effects': [{
            'effect': one.name, 'in_model': place < in_model, 'rms_m': one.rms,
            'setting': json.dumps(one.setting, ensure_ascii=False),
            'parameters': [{'name': each.name, 'value': each.value, 'U': COVERAGE_FACTOR * each.u, 'unit': each.unit}
                           for each in one.parameters]}
            for place, one in enumerate((*fit.effects, *(finding.final.effects[in_model:] if finding else ())))],
        'causes': causes,
        'rotation': None if run.rotation is None else run.rotation.ravel().tolist(),
        'result': str(result.curves.which),
        'angle_rad': motions.angle.tolist(), **_lists('{}', CURVE_KEYS, motions.values),
        **_lists('U_{}', CURVE_KEYS, COVERAGE_FACTOR * motions.u),
        **{f'range_{key}': line.range for key, line in zip(CURVE_KEYS, lines, strict=True)},
        **{f'U_range_{key}': line.expanded for key, line in zip(CURVE_KEYS, lines, strict=True)},
        'doubt': doubt_of(verdict),
        **_lists('plate_{}_m', AXES, fit.plate), **_lists('U_plate_{}_m', AXES, COVERAGE_FACTOR * fit.deviation_u[0]),
        **_lists('cmm_{}_m', AXES, fit.cmm), **_lists('U_cmm_{}_m', AXES, COVERAGE_FACTOR * fit.deviation_u[1])}


def decided_by(row: Mapping[str, Any], limits: Mapping[str, float]) -> dict[str, Conformity]:
    """Return what a row decides on each tolerance, m and rad by curve: nothing where its U is in doubt, or may be."""
    return {curve: conformity(row[f'range_{key}'], row[f'U_range_{key}'], limits[curve]) if row['doubt'] == '' else
            Conformity.UNDECIDED for curve, key in zip(CURVES, CURVE_KEYS, strict=True) if curve in limits}


def table_of(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table of SCHEMA."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=SCHEMA)


def _lists(name: str, keys: Sequence[str], values: Floats) -> Row:
    """Return the columns of an array (n, k) as lists by the names of the k keys."""
    return {name.format(key): column.tolist() for key, column in zip(keys, values.T, strict=True)}


def _time(logged: str, day: str) -> datetime.datetime | None:
    """Return the time of a log as `instant` writes it, else the beginning of a day, else None."""
    text = logged.removesuffix(' UTC') or day
    return datetime.datetime.fromisoformat(text).replace(tzinfo=datetime.UTC) if text else None

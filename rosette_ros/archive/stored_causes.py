# SPDX-License-Identifier: Apache-2.0
"""What a run says of causes, as an archive keeps it, and the experience of a cell from the rows of its runs."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.core.joint.cell_diagnosis import experience_of
from rosette_ros.core.joint.cell_rates import CellRates
from rosette_ros.core.joint.run_causes import CauseShape, RunCauses
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, counted, unknown

SCHEMA = 'rosette-run-causes/1'
PLACES = 2
"""Decimals of log evidence and log likelihoods that are kept."""
NAMED = {'cell': 'cell', 'table_serial': 'table'}
"""Columns by which runs are asked for, in words."""
_ROWS = '''SELECT causes, measured_at, table_serial, cmm_serial, cell FROM runs
    WHERE problem = '' AND causes <> '' AND model_hash = ? AND {where}
    QUALIFY row_number() OVER (PARTITION BY log_sha256, run_id ORDER BY added_at DESC) = 1 ORDER BY measured_at'''


def causes_text(causes: RunCauses) -> str:
    """Return what a run says of causes as a text."""
    names = sorted({name for some in causes.hypotheses for name in some})
    number = {name: k for k, name in enumerate(names)}
    return json.dumps({
        'schema': SCHEMA, 'names': names, 'log_prior': [round(causes.log_prior[name], 4) for name in names],
        'hypotheses': [[number[name] for name in some] for some in causes.hypotheses],
        'log_evidence': np.round(causes.log_evidence - causes.log_evidence.max(), PLACES).tolist(),
        'silent': sorted(causes.silent),
        'shapes': {name: {'unit': one.unit, 'sizes': _rounded(one.sizes),
                          'constants': {what: [list(values), _rounded(line)]
                                        for what, (values, line) in one.constants.items()}}
                   for name, one in causes.shapes.items()}}, separators=(',', ':'), ensure_ascii=False)


def causes_of_text(text: str) -> RunCauses:
    """Return what a run says of causes from its text; raises InvalidData where it is none."""
    try:
        found: Mapping[str, Any] = json.loads(text)
        if found['schema'] != SCHEMA:
            raise InvalidData(f'causes of a run: expected {SCHEMA}, found {found["schema"]!r:.60}')
        names = found['names']
        shapes = {name: CauseShape(one['unit'], np.array(one['sizes']), {
            what: (tuple(values), np.array(line)) for what, (values, line) in one['constants'].items()})
            for name, one in found['shapes'].items()}
        return RunCauses(tuple(tuple(map(names.__getitem__, some)) for some in found['hypotheses']),
                         np.array(found['log_evidence']), dict(zip(names, found['log_prior'])),
                         frozenset(found['silent']), shapes)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InvalidData(f'causes of a run: expected {SCHEMA}, found {text!r:.60}; add the runs again with --force'
                          ) from error


def _rounded(line: Any) -> list[float]:
    out: list[float] = np.round(np.maximum(line, -99.0), PLACES).tolist()
    return out


def experience_of_cell(archive: RunArchive, cell: str = '', table: str = '') -> Experience:
    """Return what the rows of a cell, of a table or of both have taught, under the base model, without a search.

    Raises InvalidData where there are fewer than two, or where they are of several tables or CMMs."""
    asked = [(column, value) for column, value in (('cell', cell), ('table_serial', table)) if value]
    where = ' AND '.join(f'{column} = ?' for column, _ in asked) or 'true'
    rows: Sequence[Mapping[str, Any]] = archive.query(
        _ROWS.format(where=where), (Model().hash, *(value for _, value in asked))).to_pylist()
    who = ' and '.join(f'{NAMED[column]} {value}' for column, value in asked)
    for column, value in asked:
        known = [one['name'] for one in archive.query(
            f"SELECT DISTINCT {column} AS name FROM runs WHERE {column} <> '' ORDER BY 1").to_pylist()]
        if known and value not in known:
            raise InvalidData(f'{archive.folder}: {NAMED[column]}: {unknown(value, known)}')
    if len(rows) < 2:
        raise InvalidData(f'{archive.folder}: expected at least two runs of {who} with what they say of causes, found '
                          f'{counted(len(rows), "run")}; runs that were added before are added again with: rosette '
                          'archive add --force')
    stated = {}
    for column, words in (('table_serial', 'table'), ('cmm_serial', 'CMM')):
        serials = sorted({row[column] for row in rows} - {''})
        if len(serials) > 1:
            raise InvalidData(f'{archive.folder}: expected runs of one {words}, found {", ".join(serials[:4])} in '
                              f'{who}; name one with --table')
        stated[column] = serials[0] if serials else ''
    days = [f'{row["measured_at"]:%Y-%m-%d}' for row in rows if row['measured_at']]
    rates = CellRates([causes_of_text(row['causes']) for row in rows])
    return experience_of(rates, cell or rows[-1]['cell'], stated['table_serial'], stated['cmm_serial'],
                         *((days[0], days[-1]) if days else ('', '')))

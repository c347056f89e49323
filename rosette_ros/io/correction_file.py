# SPDX-License-Identifier: Apache-2.0
"""Corrections as files: rosette-correction/1 (YAML), and a table (CSV)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.number_limits import is_number
from rosette_ros.core.run.records import CURVES, SI_UNITS, ErrorMotions, Floats
from rosette_ros.core.table.correction import Correction
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.io.safe_yaml import PlainDumper, known_keys, of_schema, read_yaml

SCHEMA = 'rosette-correction/1'
MOST_BYTES, MOST_ANGLES = 4 << 20, 4000
_KEYS = ('schema', 'run_id', 'table', 'simulated', 'corrected', 'forward', 'backward')
_NAMES = ('angle', *CURVES, *(f'u_{curve}' for curve in CURVES))


def format_correction(correction: Correction, table: str = '') -> str:
    """Return the text of a correction file; angles in rad, translations in m, rotations in rad, u: standard; table: its
    serial number, '' where it is not known."""
    values: dict[str, Any] = {'schema': SCHEMA, 'run_id': correction.run_id, 'table': table,
                              'simulated': correction.simulated, 'corrected': [*correction.corrected],
                              'forward': _lists(correction.forward)}
    if correction.backward is not correction.forward:
        values['backward'] = _lists(correction.backward)
    return ('# Errors of a rotary table at its angles: rad, m (ctx cty ctz), rad (crx cry crz), u standard '
            'uncertainties.\n# Deviations actual minus nominal; compensation = -deviation.\n'
            + str(yaml.dump(values, Dumper=PlainDumper, sort_keys=False, width=120, default_flow_style=None)))


def read_correction(path: str | Path) -> tuple[Correction, str]:
    """Return the Correction of a file and the table's serial number; raises InvalidData, naming file and key."""
    values = of_schema(read_yaml(path, 'a correction file', MOST_BYTES, InvalidData), SCHEMA, str(path), InvalidData,
                       'a file of rosette correct RUN --for ros')
    known_keys(values, _KEYS, str(path), InvalidData)
    corrected = values.get('corrected', [*CURVES])
    if not isinstance(corrected, list) or not corrected or any(one not in CURVES for one in corrected):
        raise InvalidData(f'{path}: corrected: expected a list of {", ".join(CURVES)}, found {corrected!r:.80}')
    for key, kind, words in (('run_id', str, 'a text'), ('table', str, 'a text'),
                             ('simulated', bool, 'true or false')):
        if not isinstance(values.get(key, kind()), kind):
            raise InvalidData(f'{path}: {key}: expected {words}, found {values[key]!r:.80}')
    forward = _motions(values.get('forward'), f'{path}: forward')
    backward = _motions(values['backward'], f'{path}: backward') if 'backward' in values else forward
    try:
        return Correction(forward, backward, tuple(corrected), values.get('run_id', ''),
                          values.get('simulated', False)), values.get('table', '')
    except InvalidData as error:
        raise InvalidData(f'{path}: {error}') from None


def _lists(motions: ErrorMotions) -> dict[str, list[float]]:
    columns = (motions.angle, *motions.values.T, *motions.u.T)
    return {name: one.tolist() for name, one in zip(_NAMES, columns, strict=True)}


def _motions(values: object, where: str) -> ErrorMotions:
    if not isinstance(values, Mapping) or sorted(map(str, values)) != sorted(_NAMES):
        raise InvalidData(f'{where}: expected a mapping of {", ".join(_NAMES)}, found {values!r:.80}')
    columns = []
    for name in _NAMES:
        one = values[name]
        if not isinstance(one, list) or len(one) > MOST_ANGLES or not all(map(is_number, one)):
            raise InvalidData(f'{where}: {name}: expected a list of at most {MOST_ANGLES} finite numbers, found '
                              f'{one!r:.80}')
        columns.append(one)
    if len({len(one) for one in columns}) > 1:
        raise InvalidData(f'{where}: expected as many values of each error as angles, found '
                          f'{", ".join(f"{name} {len(one)}" for name, one in zip(_NAMES, columns))}')
    return ErrorMotions.from_curves(columns[0], columns[1:7], columns[7:])


def correction_csv(correction: Correction, angles: Floats) -> str:
    """Return a table of the errors at angles (m,), rad: degrees, µm and µrad, U (k = 2) in the head."""
    u = COVERAGE_FACTOR * 1e6 * correction.forward.u.max(axis=0)
    head = (
        f'# errors of a rotary table, run: {correction.run_id}\n'
        '# sign: deviations actual minus nominal; compensation = -deviation\n'
        '# at angle_deg the body that was turned by it stands at c + (1 + [r]x) R_z p, c = (ctx, cty, ctz), '
        'r = (crx, cry, crz), in the table frame\n'
        '# forward, backward: sense of the last move of the table\n'
        f'# harmonics: up to {correction.harmonics} of the angle\n'
        f'# U (k = {COVERAGE_FACTOR}) of a single value: '
        + ', '.join(f'{curve} {value:.4g} µ{SI_UNITS[curve]}' for curve, value in zip(CURVES, u))
        + '\n' + '# simulated: the run was measured by the simulated machine\n' * correction.simulated)
    names = [f'{curve}_u{unit}' for curve, unit in SI_UNITS.items()]
    both = correction.backward is not correction.forward
    columns = ['angle_deg', *(f'{name}_forward' if both else name for name in names),
               *(f'{name}_backward' for name in names if both)]
    rows = [1e6 * correction.errors(angles, sense) for sense in ((1, -1) if both else (1,))]
    cells = ([f'{angle:.9g}', *(f'{value + 0.0:.6f}' for part in values for value in part)]
             for angle, *values in zip(np.rad2deg(angles), *rows, strict=True))
    return head + ''.join(','.join(row) + '\n' for row in (columns, *cells))

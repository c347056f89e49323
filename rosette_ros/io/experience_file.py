# SPDX-License-Identifier: Apache-2.0
"""What earlier runs of a cell have taught, in YAML, schema rosette-experience/1."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.free import OF
from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.run.errors import InvalidData, unknown_name
from rosette_ros.core.run.number_limits import is_number, is_size
from rosette_ros.io.safe_yaml import PlainDumper, known_keys, of_schema, read_yaml

SCHEMA = 'rosette-experience/1'
MOST_BYTES = 1_000_000
_KEYS = ('schema', 'cell', 'table', 'cmm', 'runs', 'begin', 'end', 'causes')
_OF_CAUSE = ('effect', 'rate', 'property', 'in_runs', 'judged_runs', 'size_um', 'size_spread', 'constants')
HEAD = '''# What earlier runs of a cell have taught: rosette diagnose RUN --experience FILE
# rate: probability that a run has the cause; property: that it comes again in this cell; in_runs of judged_runs: how
# often it was there; size: rms over all coordinates; constants of the law in SI units, u: standard uncertainty
'''
DIGITS = 4
"""Significant digits of what is written: more would say nothing."""


def read_experience(path: str | Path) -> Experience:
    """Return the Experience of a file; raises InvalidData, naming it."""
    where = str(path)
    values = of_schema(read_yaml(path, 'a file of experience', MOST_BYTES, InvalidData), SCHEMA, where, InvalidData)
    known_keys(values, _KEYS, where, InvalidData)
    every = values.get('causes') or []
    if not isinstance(every, list):
        raise InvalidData(f'{where}: causes: expected a list, found {every!r:.80}')
    causes = tuple(_cause(one, f'{where}: causes: {place}') for place, one in enumerate(every, 1))
    runs = values.get('runs', 0)
    if not isinstance(runs, int) or isinstance(runs, bool) or runs < 0:
        raise InvalidData(f'{where}: runs: expected how many runs have taught this, found {runs!r:.80}')
    texts = {key: str(values.get(key) or '') for key in ('cell', 'table', 'cmm', 'begin', 'end')}
    return Experience(causes, runs=runs, **texts)


def format_experience(known: Experience) -> str:
    """Return an Experience as YAML."""
    stated = {key: value for key in ('cell', 'table', 'cmm', 'begin', 'end') if (value := getattr(known, key))}
    causes = []
    for one in known.causes:
        entry: dict[str, Any] = {'effect': one.name, 'rate': _short(one.rate), 'property': _short(one.again),
                                 'in_runs': _short(one.expected), 'judged_runs': one.judged}
        if math.isfinite(one.size):
            entry |= {'size_um': _short(1e6 * one.size), 'size_spread': _short(one.spread)}
        if one.constants:
            entry['constants'] = {name: {'value': _short(value), 'u': _short(u)} for name, value, u in one.constants}
        causes.append(entry)
    values = {'schema': SCHEMA, **stated, 'runs': known.runs, 'causes': causes}
    return HEAD + str(yaml.dump(values, Dumper=PlainDumper, sort_keys=False, allow_unicode=True))


def _short(value: float) -> float:
    return float(f'{value:.{DIGITS}g}')


def _cause(entry: object, where: str) -> KnownCause:
    if not isinstance(entry, Mapping):
        raise InvalidData(f'{where}: expected a mapping with effect and rate, found {entry!r:.80}')
    known_keys(dict(entry), _OF_CAUSE, where, InvalidData)
    name, numbers = entry.get('effect'), dict[str, float]()
    if not isinstance(name, str) or (name not in LAWS and OF not in name):
        raise InvalidData(f'{where}: {unknown_name("effect", str(name), tuple(LAWS), "rosette effects")}')
    for key, default in (('rate', None), ('property', 1.0), ('in_runs', 0.0), ('judged_runs', 0)):
        value = entry.get(key, default)
        is_share = key in ('rate', 'property')
        if not is_number(value) or value < 0 or (is_share and not 0 < value < 1 + (key == 'property') * 1e-9):
            wanted = 'a probability above 0 and below 1' if is_share else 'a number of runs'
            raise InvalidData(f'{where}: {key}: expected {wanted}, found {value!r:.80}')
        numbers[key] = float(value)
    size, spread = entry.get('size_um', math.nan), entry.get('size_spread', math.nan)
    for key, value in (('size_um', size), ('size_spread', spread)):
        if key in entry and not is_size(value):
            raise InvalidData(f'{where}: {key}: expected a positive number, found {value!r:.80}')
    constants = entry.get('constants') or {}
    if not isinstance(constants, Mapping) or not all(
            isinstance(one, Mapping) and is_number(one.get('value')) and is_number(one.get('u'))
            for one in constants.values()):
        raise InvalidData(f'{where}: constants: expected value and u of each, found {constants!r:.80}')
    return KnownCause(name, numbers['rate'], numbers['property'], numbers['in_runs'], int(numbers['judged_runs']),
                      1e-6 * size, spread,
                      tuple((str(what), float(one['value']), float(one['u'])) for what, one in constants.items()))

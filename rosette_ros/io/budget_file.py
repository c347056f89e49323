# SPDX-License-Identifier: Apache-2.0
"""Inputs of an uncertainty budget, schema rosette-budget/1: YAML with a section for each influence."""

from pathlib import Path
from typing import Any

from rosette_ros.core.budget_inputs import BOUNDS, SECTIONS, BudgetInputs, Entry
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.errors import InvalidData
from rosette_ros.io.safe_yaml import is_finite, known_keys, of_schema, read_yaml

SCHEMA = 'rosette-budget/1'
MOST_BYTES, LONGEST = 1 << 16, 300


def read_budget(path: str | Path) -> BudgetInputs:
    """Return the BudgetInputs of a file; raises InvalidData, naming file and entry, where it is none."""
    return budget_inputs(read_stated(path), str(path))


def read_stated(path: str | Path) -> dict[str, Any]:
    """Return what a file of budget inputs says, as YAML; raises InvalidData as read_budget."""
    given = read_yaml(path, 'a file of budget inputs', MOST_BYTES, InvalidData)
    budget_inputs(given, str(path))
    return dict(given)


def budget_inputs(given: Any, source: str = 'budget inputs') -> BudgetInputs:
    """Return the BudgetInputs of what YAML says; source: its name in errors."""
    of_schema(given, SCHEMA, source, InvalidData)
    values: dict[str, dict[str, float]] = {}
    words: dict[str, str] = {}
    dof: dict[str, float] = {}
    bounds: dict[str, float] = {}
    known_keys((one for one in given if one != 'schema'), (*SECTIONS, BOUNDS), source, InvalidData)
    for section, entries in given.items():
        where = f'{source}: {section}'
        if section == 'schema' or entries is None:
            continue
        if not isinstance(entries, dict):
            raise InvalidData(f'{where}: wanted a mapping, got {entries!r:.80}')
        if section == BOUNDS:
            known_keys(entries, EFFECTS, where, InvalidData)
            bounds = {name: 1e-6 * _number(size, Entry(''), f'{where}: {name}')
                      for name, size in entries.items()}
            continue
        known = SECTIONS[section][1]
        known_keys(entries, (*known, 'dof', 'words'), where, InvalidData)
        values[section] = {name: one.factor * _number(entries[name], one, f'{where}: {name}')
                           for name, one in known.items() if entries.get(name) is not None}
        lacking = [name for name, one in known.items() if one.default is None and name not in values[section]]
        if lacking:
            raise InvalidData(f'{where}: wanted {lacking[0]} ({known[lacking[0]].words}), got none')
        if entries.get('dof') is not None:
            dof[section] = _number(entries['dof'], Entry(''), f'{where}: dof')
            if dof[section] < 1:
                raise InvalidData(f'{where}: dof: wanted 1 or more degrees of freedom, got {dof[section]:g}')
        if entries.get('words') is not None:
            words[section] = _text(entries['words'], f'{where}: words')
    return BudgetInputs(values, words, dof, bounds)


def _number(value: object, entry: Entry, where: str) -> float:
    if not is_finite(value) or (value < 0 and not entry.signed):
        raise InvalidData(f'{where}: wanted a {"" if entry.signed else "positive "}number, got {value!r:.40}')
    if entry.chosen and value not in entry.chosen:
        raise InvalidData(f'{where}: wanted one of {", ".join(map(str, entry.chosen))}, got {value!r:.40}')
    return float(value)


def _text(value: object, where: str) -> str:
    text = ' '.join(value.split()) if isinstance(value, str) else ''
    if not text or len(text) > LONGEST or not text.isprintable():
        raise InvalidData(f'{where}: wanted a text of at most {LONGEST} characters, got {value!r:.40}')
    return text

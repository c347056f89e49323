# SPDX-License-Identifier: Apache-2.0
"""Inputs of an uncertainty budget, schema rosette-budget/1: YAML with a section for each influence."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.errors import InvalidData, unknown
from rosette_ros.core.run.number_limits import is_number
from rosette_ros.core.uncertainty.budget_inputs import BOUNDS, ENVIRONMENT, SECTIONS, BudgetInputs, Entry
from rosette_ros.core.uncertainty.stated_environment import CLASSES, KINDS, Environment, Size
from rosette_ros.io.safe_yaml import known_keys, of_schema, read_yaml

SCHEMA = 'rosette-budget/1'
EFFECTS_OF = 'effects'
"""The entry of an environment for single effects."""
EXAMPLE = 'EXAMPLE'
"""With this the words of config/budget.yaml begin, which are of no cell."""
MOST_BYTES, LONGEST = 1 << 16, 300


def read_budget(path: str | Path) -> BudgetInputs:
    """Return the BudgetInputs of a file; raises InvalidData, naming file and entry, where it is none."""
    return budget_inputs(read_yaml(path, 'a file of budget inputs', MOST_BYTES, InvalidData), str(path))


def read_stated(inputs: Mapping[str, Any] | str | Path | None, environment: str | None = None) -> dict[str, Any] | None:
    """Return what budget inputs say, a file or as it says them, None where nothing is; raises InvalidData as
    read_budget.

    environment: a class that takes the place of what they say of the environment."""
    stated: dict[str, Any] = {}
    if inputs:
        stated = ({'schema': SCHEMA, **inputs} if isinstance(inputs, Mapping) else
                  read_yaml(inputs, 'a file of budget inputs', MOST_BYTES, InvalidData))
        budget_inputs(stated, source_of(inputs))
    within = {ENVIRONMENT: {'class': environment}} if environment else {}
    return {'schema': SCHEMA, **stated, **within} if stated or within else None


def source_of(inputs: Mapping[str, Any] | str | Path | None) -> str:
    """Return the name of budget inputs in errors: of their file, where they are from one."""
    return str(inputs) if isinstance(inputs, str | Path) else 'budget inputs'


def refuse_examples(given: Any, source: str) -> None:
    """Raise InvalidData where what YAML states has words of the example file, which are of no cell."""
    words = budget_inputs(given, source).words if given else {}
    if examples := [section for section, text in words.items() if text.startswith(EXAMPLE)]:
        raise InvalidData(f'{source}: expected words that say whence the numbers of this cell are, found those of the '
                          f'example in {", ".join(examples)}; state numbers and words of the cell, or leave these '
                          'sections out')


def environment_of(given: Any, source: str = 'budget inputs') -> Environment | None:
    """Return the Environment that YAML states for several runs as one; raises InvalidData where it states more."""
    if not given:
        return None
    if more := [section for section, entries in given.items() if section not in ('schema', ENVIRONMENT) and entries]:
        raise InvalidData(f'{source}: expected the section {ENVIRONMENT} only with several runs as one, found '
                          f'{more[0]}; '
                          'leave it out')
    return budget_inputs(given, source).environment


def format_environment(environment: Environment) -> str:
    """Return an Environment as a file of budget inputs, YAML."""
    def told(size: Size, unit: str) -> dict[str, Any]:
        return {unit: float(f'{1e6 * size.value:.3g}'), 'words': size.source}
    section: dict[str, Any] = {kind: told(one, KINDS[kind].unit) for kind, one in environment.sizes.items()}
    if environment.effects:
        section[EFFECTS_OF] = {name: told(one, 'um') for name, one in environment.effects.items()}
    return yaml.safe_dump({'schema': SCHEMA, ENVIRONMENT: section}, sort_keys=False, allow_unicode=True, width=110)


def format_inputs(given: Mapping[str, Any]) -> str:
    """Return budget inputs, as YAML states them, as the text of a file."""
    return yaml.safe_dump({'schema': SCHEMA, **given}, sort_keys=False, allow_unicode=True, width=110)


def budget_inputs(given: Any, source: str = 'budget inputs') -> BudgetInputs:
    """Return the BudgetInputs of what YAML says; source: its name in errors."""
    of_schema(given, SCHEMA, source, InvalidData)
    values: dict[str, dict[str, float]] = {}
    words: dict[str, str] = {}
    dof: dict[str, float] = {}
    bounds: dict[str, float] = {}
    environment = None
    known_keys((one for one in given if one != 'schema'), (*SECTIONS, BOUNDS, ENVIRONMENT), source, InvalidData)
    for section, entries in given.items():
        where = f'{source}: {section}'
        if section == 'schema' or entries is None:
            continue
        if not isinstance(entries, dict):
            raise InvalidData(f'{where}: expected a mapping, found {entries!r:.80}')
        if section == BOUNDS:
            known_keys(entries, EFFECTS, where, InvalidData)
            bounds = {name: 1e-6 * _number(size, Entry(''), f'{where}: {name}')
                      for name, size in entries.items()}
            continue
        if section == ENVIRONMENT:
            environment = _environment(entries, where)
            continue
        known = SECTIONS[section][1]
        known_keys(entries, (*known, 'dof', 'words'), where, InvalidData)
        values[section] = {name: one.factor * _number(entries[name], one, f'{where}: {name}')
                           for name, one in known.items() if entries.get(name) is not None}
        lacking = [name for name, one in known.items() if one.default is None and name not in values[section]]
        if lacking:
            raise InvalidData(f'{where}: expected {lacking[0]} ({known[lacking[0]].words}), found none')
        if entries.get('dof') is not None:
            dof[section] = _number(entries['dof'], Entry(''), f'{where}: dof')
            if dof[section] < 1:
                raise InvalidData(f'{where}: dof: expected 1 or more degrees of freedom, found {dof[section]:g}')
        if entries.get('words') is not None:
            words[section] = _text(entries['words'], f'{where}: words')
    return BudgetInputs(values, words, dof, bounds, environment)


def _environment(entries: dict[str, Any], where: str) -> Environment:
    """Return the Environment that a section states: a class, numbers in place of its own, single effects."""
    known_keys(entries, ('class', *KINDS, EFFECTS_OF), where, InvalidData)
    name, single = entries.get('class'), entries.get(EFFECTS_OF) or {}
    if name is not None and (not isinstance(name, str) or name not in CLASSES):
        raise InvalidData(f'{where}: class: {unknown(f"{name!s:.40}", CLASSES)}')
    if not isinstance(single, dict):
        raise InvalidData(f'{where}: {EFFECTS_OF}: expected a mapping, found {single!r:.80}')
    known_keys(single, EFFECTS, f'{where}: {EFFECTS_OF}', InvalidData)
    own = {kind: _size(entries[kind], KINDS[kind].unit, f'{where}: {kind}') for kind in KINDS
           if entries.get(kind) is not None}
    effects = {one: _size(size, 'um', f'{where}: {EFFECTS_OF}: {one}') for one, size in single.items()}
    if name is None:
        if not (own or effects):
            raise InvalidData(f'{where}: expected a class ({", ".join(CLASSES)}) or some of {", ".join(KINDS)}, found '
                              'none')
        return Environment(sizes=own, effects=effects)
    changed = f'{name}, with numbers of the cell' if own or effects else name
    return Environment(changed, {**CLASSES[name].sizes, **own}, effects)


def _size(given: object, unit: str, where: str) -> Size:
    if not isinstance(given, dict):
        raise InvalidData(f"{where}: expected {{{unit}: 0.3, words: 'whence it is'}}, found {given!r:.40}")
    known_keys(given, (unit, 'words'), where, InvalidData)
    return Size(1e-6 * _number(given.get(unit), Entry(''), f'{where}: {unit}'),
                _text(given.get('words'), f'{where}: words'))


def _number(value: object, entry: Entry, where: str) -> float:
    if not is_number(value) or (value < 0 and not entry.signed):
        raise InvalidData(f'{where}: expected a {"" if entry.signed else "positive "}number, found {value!r:.40}')
    if entry.chosen and value not in entry.chosen:
        raise InvalidData(f'{where}: expected one of {", ".join(map(str, entry.chosen))}, found {value!r:.40}')
    return float(value)


def _text(value: object, where: str) -> str:
    text = ' '.join(value.split()) if isinstance(value, str) else ''
    if not text or len(text) > LONGEST or not text.isprintable():
        raise InvalidData(f'{where}: expected a text of at most {LONGEST} characters, found {value!r:.40}')
    return text

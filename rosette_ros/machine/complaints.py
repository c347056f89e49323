# SPDX-License-Identifier: Apache-2.0
"""Turns what pydantic found wrong into one line: file, key, what was wanted, what came."""

import difflib
from typing import get_args

from pydantic import BaseModel

_WORDS = {
    'missing': 'a value',
    'model_type': 'a mapping of settings',
    'model_attributes_type': 'a mapping with a `kind`',
    'tuple_type': 'a list',
    'bool_type': 'true or false',
    'int_type': 'a whole number',
    'float_type': 'a number',
    'string_type': 'a text',
}
"""What pydantic's types of fault want, in the words of someone who edits YAML."""


def complaint(error, source, model):
    """Return one line on the first fault of a ValidationError of `model` read from `source`."""
    faults = error.errors(include_url=False)
    # A misspelt key also leaves the right one missing: the misspelling is the cause.
    fault = min(faults, key=lambda fault: fault['type'] != 'extra_forbidden')
    key = _key(fault['loc'])
    rest = f' (and {len(faults) - 1} more)' if len(faults) > 1 else ''
    if fault['type'] == 'value_error':
        text = str(fault['ctx']['error'])
        return f'{source}: {key + ": " if key else ""}{text}{rest}'
    return f'{source}: {key}: wanted {_wanted(fault, model)}, got {_got(fault)}{rest}'


def _key(loc):
    """Return the dotted key as it stands in the file, items counted from one."""
    parts = []
    for before, part in zip((None, *loc), loc, strict=False):
        if isinstance(part, int):
            parts.append(str(part + 1))
        elif isinstance(before, int) and loc[0] == 'hidden':
            continue  # the kind, by which pydantic tells the classes apart
        else:
            parts.append('hidden' if part == 'hidden_draw' else str(part))
    return '.'.join(parts)


def _wanted(fault, model):
    if fault['type'] == 'extra_forbidden':
        known = sorted(_fields(model, fault['loc'][:-1]))
        near = difflib.get_close_matches(str(fault['loc'][-1]), known, 1)
        return f'{near[0]!r}' if near else f'one of {", ".join(known)}'
    if fault['type'] == 'union_tag_invalid':
        return f'kind: one of {fault["ctx"]["expected_tags"]}'
    if fault['type'] == 'union_tag_not_found':
        return 'an effect with its `kind`'
    text = fault['msg'].removeprefix('Input should be ').removeprefix('a valid ')
    return _WORDS.get(fault['type'], text)


def _got(fault):
    if fault['type'] == 'extra_forbidden':
        return f'{fault["loc"][-1]!r}'
    if fault['type'] == 'missing':
        return 'nothing'
    if fault['type'] == 'union_tag_invalid':
        return f'{fault["ctx"]["tag"]!r}'
    return f'{fault["input"]!r:.80}'


def _fields(model, loc):
    """Return the names that the group at `loc` knows."""
    groups = [model]
    for part in loc:
        if isinstance(part, int):
            continue
        deeper = [inner for group in groups for inner in _groups_at(group, part)]
        groups = deeper or [group for group in groups if _kind_of(group) == part]
    return {name for group in groups for name in group.model_fields}


def _groups_at(group, name):
    field = group.model_fields.get(name)
    return [] if field is None else list(_models_in(field.annotation))


def _models_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _kind_of(group):
    kind = group.model_fields.get('kind')
    return None if kind is None else kind.default

# SPDX-License-Identifier: Apache-2.0
"""What every group of settings shares: frozen, no unknown keys, no infinities, errors in one line."""

import difflib
from collections.abc import Iterator
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError
from pydantic_core import ErrorDetails

from rosette_ros.core.run.axes import unit_axis
from rosette_ros.core.run.errors import InvalidConfig, InvalidData, plain


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    try:
        unit_axis(value)
    except InvalidData as error:
        raise ValueError(str(error)) from error
    return value


Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Strict(), Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Vector = Annotated[tuple[Number, Number, Number], Strict(False)]
Axis = Annotated[Vector, AfterValidator(_direction)]
Pair = Annotated[tuple[Number, Number], Strict(False)]
Seed = Annotated[int, Strict(), Field(ge=0, lt=2**63)]

_WORDS = {
    'missing': 'a value', 'tuple_type': 'a list', 'bool_type': 'true or false', 'int_type': 'a whole number',
    'float_type': 'a number', 'string_type': 'a text', 'model_type': 'a mapping of settings',
    'model_attributes_type': 'a mapping with a `kind`', 'union_tag_not_found': 'an effect with its `kind`'}
"""What pydantic's types of error want, in the words of someone who edits YAML."""


class Settings(BaseModel):
    """A group of settings."""

    model_config = ConfigDict(frozen=True, extra='forbid', strict=True, allow_inf_nan=False)


_Group = TypeVar('_Group', bound=Settings)


def checked(group: type[_Group], values: Any, source: str) -> _Group:
    """Return settings from a mapping as read from YAML; raises InvalidConfig, naming `source` and the key."""
    if not isinstance(values, dict):
        raise InvalidConfig(f'{source}: expected a mapping of settings, found {values!r:.60}')
    try:
        return group.model_validate(values)
    except ValidationError as error:
        raise InvalidConfig(_complaint(error, source, group)) from error


def _complaint(error: ValidationError, source: str, model: type[BaseModel]) -> str:
    """Return one line on the first error in settings of `model` read from `source`: key, wanted, got."""
    found = error.errors(include_url=False)
    # A misspelt key also leaves the right one missing: the misspelling is the cause.
    first = min(found, key=lambda one: one['type'] != 'extra_forbidden')
    key = plain(_key(first['loc']))
    rest = f' (and {len(found) - 1} more)' if len(found) > 1 else ''
    if first['type'] == 'value_error':
        return f'{source}: {key + ": " if key else ""}{first["ctx"]["error"]}{rest}'
    wanted, got = _wanted_and_got(first, model)
    return f'{source}: {key}: expected {wanted}, found {got}{rest}'


def _key(loc: tuple[int | str, ...]) -> str:
    """Return the dotted key as it stands in the file, items counted from one."""
    parts = []
    for before, part in zip((None, *loc), loc, strict=False):
        if isinstance(part, int):
            parts.append(str(part + 1))
        elif isinstance(before, int) and loc[0] == 'hidden':
            continue  # the kind, by which pydantic distinguishes the classes
        else:
            parts.append('hidden' if part == 'hidden_draw' else part)
    return '.'.join(parts)


def _wanted_and_got(error: ErrorDetails, model: type[BaseModel]) -> tuple[str, str]:
    kind, got = error['type'], f'{error["input"]!r:.80}'
    if kind == 'extra_forbidden':
        known = sorted(_fields(model, error['loc'][:-1]))
        near = difflib.get_close_matches(str(error['loc'][-1]), known, 1)
        return f'{near[0]!r}' if near else f'one of {", ".join(known)}', f'{error["loc"][-1]!r}'
    if kind == 'union_tag_invalid':
        return f'kind: one of {error["ctx"]["expected_tags"]}', f'{error["ctx"]["tag"]!r}'
    if kind == 'literal_error':
        return 'one of ' + error['ctx']['expected'].replace(' or ', ', ').replace("'", ''), got
    wanted = _WORDS.get(kind, error['msg'].removeprefix('Input should be ').removeprefix('a valid '))
    return wanted, 'nothing' if kind == 'missing' else got


def _fields(model: type[BaseModel], loc: tuple[int | str, ...]) -> set[str]:
    groups = [model]
    for part in (part for part in loc if not isinstance(part, int)):
        inner = [found for group in groups if (field := group.model_fields.get(part)) is not None
                 for found in _models_in(field.annotation)]
        groups = inner or [group for group in groups if 'kind' in group.model_fields
                           and group.model_fields['kind'].default == part]
    return {field.alias or name for group in groups for name, field in group.model_fields.items()}


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)

# SPDX-License-Identifier: Apache-2.0
"""YAML from outside: no aliases, no deep nesting, no key twice, and one kind of error whatever is wrong with it.

Whole numbers beside floats in a list are floats: a person who writes [0.35, 0.26, 0] means no other kind of number.
13e-2 and 2e1 are numbers, as in YAML 1.2; a text that looks like one is written in quotes. Numbers that YAML 1.1 reads
otherwise than they are written are refused: 010 as 8, 1:30 as 90, 0x10 as 16, 1_000 as 1000.

A few hundred bytes of aliases within aliases stand for more than fits into a memory, and nesting of some ten
thousand levels ends the whole process in the loader: both are refused before anything is built."""

import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.run.errors import RosetteError, plain, unknown
from rosette_ros.io.text_file import read_limited

DEEPEST = 20  # collections nested deeper than this are refused
BAD_VALUE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What the constructors of the loader raise besides YAMLError, such as for `!!int ""` or 2001-13-45."""

_DECIMAL = re.compile(r'[-+]?((0|[1-9]\d*)(\.\d*)?|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)')

_CLoader: type[yaml.SafeLoader] = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class NotPlain(yaml.YAMLError):
    """YAML that is refused although it may be some."""


class _Loader(_CLoader):  # type: ignore[valid-type, misc]  # which of the two is known at run time only
    """The safe loader, which also refuses a key that stands twice, and gives the numbers of a list one type."""

    def construct_sequence(self, node: yaml.SequenceNode, deep: bool = False) -> list[Any]:
        values: list[Any] = super().construct_sequence(node, deep)
        return list(map(float, values)) if {*map(type, values)} == {int, float} else values

    def construct_decimal(self, node: yaml.ScalarNode) -> Any:
        """Return a number that is written as decimal digits; raises NotPlain for any other."""
        if not _DECIMAL.fullmatch(node.value):
            raise NotPlain(f'line {node.start_mark.line + 1}: expected a number in decimal digits, without leading '
                           f'zeros, found {node.value!r:.40}; write a text in quotes')
        is_whole = node.tag.endswith(':int')
        return self.construct_yaml_int(node) if is_whole else self.construct_yaml_float(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set[str]()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(None, None, f'key {key.value!r} stands twice',
                                                            key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)  # type: ignore[no-any-return]


class PlainDumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]  # see above
    """The safe dumper, which quotes the texts that the loader would take for numbers."""


for _kind in ('int', 'float'):
    _Loader.add_constructor(f'tag:yaml.org,2002:{_kind}', _Loader.construct_decimal)
for _one in (_Loader, PlainDumper):
    _one.add_implicit_resolver('tag:yaml.org,2002:float', re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
                               list('-+.0123456789'))


def read_yaml(path: str | Path, wanted: str, most: int, kind: type[RosetteError]) -> Any:
    """Return what a YAML file of at most `most` bytes says; raises a `kind` that names it as `wanted`."""
    return parse_yaml(read_limited(path, wanted, most, kind), str(path), kind)


def parse_yaml(data: bytes, source: str, kind: type[RosetteError]) -> Any:
    """Return what YAML text says; raises an error of a kind, which names `source`, where it is none, or not plain."""
    try:
        return load_plain(data.decode('utf-8-sig'))
    except UnicodeDecodeError as error:
        at = error.start
        raise kind(f'{source}: expected UTF-8 text, found byte {data[at]:#04x} at position {at}') from None
    except NotPlain as error:
        raise kind(f'{source}: {error}') from None
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        place = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
        problem = getattr(error, 'problem', None) or ' '.join(str(error).split())
        raise kind(f'{source}: expected YAML, found text that is none: {place}{problem}') from None


def of_schema(values: Any, schema: str, source: str, kind: type[RosetteError], wanted: str = 'a mapping') -> Any:
    """Return what a file says where it is a mapping of a schema; raises an error of a kind, which names `source`."""
    if not isinstance(values, dict) or values.get('schema') != schema:
        got = 'nothing' if values is None else f'{values!r:.80}'
        add = '; add that line' if isinstance(values, dict) and 'schema' not in values else ''
        raise kind(f'{source}: expected {wanted} with "schema: {schema}", found {got}{add}')
    return values


def known_keys(names: Iterable[object], known: Collection[str], where: str, kind: type[RosetteError]) -> None:
    """Raise an error of a kind, which says where, at the first name that is none of those known."""
    for name in names:
        if name not in known:
            raise kind(f'{where}: {unknown(plain(str(name), 40), known)}')


def parse_mapping(text: str, source: str, most: int, example: str, kind: type[RosetteError]) -> dict[Any, Any]:
    """Return the YAML mapping in a text of at most `most` characters, {} for an empty one; raises as parse_yaml."""
    if len(text) > most:
        raise kind(f'{source}: expected at most {most} characters, found {len(text)}')
    mapping = parse_yaml(text.encode(errors='replace'), source, kind)
    if not isinstance(mapping, (dict, type(None))):
        raise kind(f'{source}: expected a YAML mapping such as "{example}", found {text!r:.80}')
    return mapping or {}


def load_plain(text: str) -> Any:
    """Return what YAML text says; raise yaml.YAMLError where it is none, or not plain."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_Loader):
            line = event.start_mark.line + 1 if event.start_mark else 1
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):
                raise NotPlain(f'line {line}: expected plain YAML, found an alias (*name); write it out')
            if depth > DEEPEST:
                raise NotPlain(f'line {line}: expected at most {DEEPEST} levels of nesting, found more')
        return yaml.load(text, Loader=_Loader)
    except BAD_VALUE as error:
        raise NotPlain('expected YAML values, found one that is none, such as a date that does not exist; write a '
                       'text in '
                       'quotes') from error

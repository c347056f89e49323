# SPDX-License-Identifier: Apache-2.0
"""Reading a ros2msg schema: which fields a message has, in the order of the wire.

A log is decoded by the schemas it carries, not by what is installed: a log of an older or a newer
version of a message still opens. Source: MCAP registry `ros2msg`, rosidl interface definition.
"""

import re
from dataclasses import dataclass

from rosette_ros.core.errors import InvalidData

PRIMITIVES = {
    'bool': 1, 'byte': 1, 'char': 1, 'int8': 1, 'uint8': 1, 'int16': 2, 'uint16': 2, 'int32': 4,
    'uint32': 4, 'int64': 8, 'uint64': 8, 'float32': 4, 'float64': 8, 'string': 0, 'wstring': 0}
"""Built-in types and their sizes in bytes, 0 for texts."""

MAX_DEPTH = 32
"""Messages nested deeper than this are refused."""
_MAX_DIGITS = 9

_FIELD = re.compile(
    r'(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+'
    r'(?P<name>[A-Za-z][A-Za-z0-9_]*)\s*(?P<rest>.*)')


@dataclass(frozen=True)
class Field:
    """One field of a message.

    type_name: a key of PRIMITIVES or `package/Type`; length: None for a single value, a number for
    a fixed array, -1 for a sequence.
    """

    name: str
    type_name: str
    length: int | None = None


@dataclass(frozen=True)
class Schema:
    """A message type with all it contains: types maps `package/Type` to its fields."""

    name: str
    types: dict

    @property
    def fields(self):
        """Fields of the message itself."""
        return self.types[self.name]


def parse_schema(type_name, text):
    """Return the Schema of a ros2msg text.

    Raises InvalidData where a line is no field, or a type is missing or contains itself.
    """
    root = _short(type_name)
    types = {}
    for index, block in enumerate(re.split(r'^={3,}[ \t]*\r?$', text, flags=re.MULTILINE)):
        name, body = root, block
        heading = re.match(r'\s*MSG:[ \t]*(\S+)', block)
        if heading:
            name, body = _short(heading.group(1)), block[heading.end():]
        elif index:
            raise InvalidData(f'schema of {type_name}: wanted "MSG: package/Type" after the line '
                              'of "=", got none; the log was written wrongly')
        types[name] = _fields(type_name, name, body)
    schema = Schema(root, types)
    _check(type_name, types, root, (), set())
    return schema


def _short(type_name):
    parts = type_name.split('/')
    return f'{parts[0]}/{parts[-1]}'


def _fields(type_name, owner, body):
    fields = []
    for raw in body.splitlines():
        line = raw.split('#', 1)[0].strip()
        if not line:
            continue
        match = _FIELD.fullmatch(line)
        if not match:
            raise InvalidData(f'schema of {type_name}: wanted "type name", got {line[:80]!r}; '
                              'the log was written wrongly')
        if match['rest'].startswith('='):
            continue  # a constant
        if len(match['array'] or '') > _MAX_DIGITS + 2 or any(field.name == match['name'] for field in fields):
            raise InvalidData(f'schema of {type_name}: wanted each field once and arrays of less than 1e9 values, '
                              f'got {line[:80]!r}; the log was written wrongly')
        fields.append(Field(match['name'], _resolved(match['type'], owner),
                            _length(match['array'])))
    return tuple(fields)


def _resolved(name, owner):
    if name in PRIMITIVES:
        return name
    return _short(name) if '/' in name else f'{owner.split("/")[0]}/{name}'


def _length(array):
    if array is None:
        return None
    digits = array[1:-1]
    return int(digits) if digits.isdigit() else -1


def _check(type_name, types, name, above, checked):
    if name in above or len(above) > MAX_DEPTH:
        raise InvalidData(f'schema of {type_name}: {name} contains itself; '
                          'the log was written wrongly')
    if name not in types:
        raise InvalidData(f'schema of {type_name}: the definition of {name} is missing; '
                          'the log was written wrongly')
    for field in types[name]:
        if field.type_name not in PRIMITIVES and field.type_name not in checked:
            _check(type_name, types, field.type_name, (*above, name), checked)
    checked.add(name)

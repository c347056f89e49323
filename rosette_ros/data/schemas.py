# SPDX-License-Identifier: Apache-2.0
"""Message definitions of a ROS installation as a log holds them: complete text and type hash.

A ROS package installs its definitions (.msg, .srv, .action) and their type descriptions (.json)
below `share/<package>/`. A log needs for every type the text of the type and of all it contains
(encoding `ros2msg`, MCAP registry), also for the types that have no file of their own: service
events, action feedback. Source: REP-2011, rosidl_generator_type_description.
"""

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from rosette_ros.core.errors import InvalidConfig

DELIMITER = '=' * 80
"""The line between the parts of a ros2msg schema."""

_NESTED = 1
_PRIMITIVES = {
    2: 'int8', 3: 'uint8', 4: 'int16', 5: 'uint16', 6: 'int32', 7: 'uint32', 8: 'int64',
    9: 'uint64', 10: 'float32', 11: 'float64', 13: 'char', 15: 'bool', 16: 'byte', 17: 'string',
    18: 'wstring', 21: 'string', 22: 'wstring'}
_IDL_PRIMITIVES = {
    **_PRIMITIVES, 10: 'float', 11: 'double', 13: 'char', 15: 'boolean', 16: 'octet'}
_BUILT_IN = frozenset(_PRIMITIVES.values())
_ARRAY, _BOUNDED, _SEQUENCE = 48, 96, 144  # added to the type id, type_description_interfaces
_PLACEHOLDER = 'structure_needs_at_least_one_member'  # the byte an empty structure has on the wire
_PARTS = {'srv': ('_Request', '_Response'), 'action': ('_Goal', '_Result', '_Feedback')}


@dataclass(frozen=True)
class TypeDefinition:
    """A type as a log describes it.

    name: `package/kind/Type`; text: ros2msg schema with all dependencies; hash: RIHS01 type hash;
    idl: for service events the same as ros2idl schema, else empty. Not every reader of ros2msg can
    name a type of a service; ros2idl says the full name.
    """

    name: str
    text: str
    hash: str
    idl: str = ''


class TypeLibrary:
    """The definitions installed below the `share` folders of some prefixes, the first one wins."""

    def __init__(self, prefixes):
        """Take the prefixes, the folders that AMENT_PREFIX_PATH lists."""
        self.prefixes = tuple(Path(prefix) for prefix in prefixes)
        self._descriptions = {}
        self._hashes = {}

    @staticmethod
    def from_environment(environ):
        """Return the library of the prefixes in AMENT_PREFIX_PATH of a mapping."""
        paths = environ.get('AMENT_PREFIX_PATH', '')
        return TypeLibrary(path for path in paths.split(os.pathsep) if path)

    def definition(self, type_name):
        """Return the TypeDefinition of `package/kind/Type`.

        Besides messages: `package/srv/Name_Event`, `package/action/Name_FeedbackMessage` and the
        other parts of services and actions.

        Raises InvalidConfig where the type is not installed.
        """
        names = self._closure(type_name)
        parts = [self._text(type_name)]
        for name in names[1:]:
            text = self._text(name)
            for heading in _headings(name):
                parts += [DELIMITER, f'MSG: {heading}', text]
        idl = ''
        if type_name.endswith('_Event'):
            idl = '\n'.join(self._idl(name) for name in names)
        return TypeDefinition(type_name, '\n'.join(parts) + '\n', self._hashes[type_name], idl)

    def _closure(self, type_name):
        """Return the type and all types it contains, each once, in order of appearance."""
        names = [type_name]
        for name in names:
            for field in self._fields(name):
                nested = field['type']['nested_type_name']
                if nested and nested not in names:
                    names.append(nested)
        return names

    def _fields(self, type_name):
        if type_name not in self._descriptions:
            self._load(type_name)
        return self._descriptions[type_name]

    def _load(self, type_name):
        path = self._find(type_name, '.json')
        try:
            content = json.loads(path.read_text(encoding='utf-8'))
            message = content['type_description_msg']
            described = [message['type_description'], *message['referenced_type_descriptions']]
            hashes = {entry['type_name']: entry['hash_string'] for entry in content['type_hashes']}
            fields = {entry['type_name']: entry['fields'] for entry in described}
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidConfig(
                f'{path}: wanted a type description with type_description_msg and type_hashes, '
                f'got {error!r}; build the package again') from error
        if type_name not in fields or type_name not in hashes:
            raise InvalidConfig(f'{path}: wanted a description of {type_name}, '
                                f'got {", ".join(sorted(fields))}')
        self._descriptions.update(fields)
        self._hashes.update(hashes)

    def _find(self, type_name, suffix):
        """Return the installed file that defines a type: its name up to the first `_`."""
        if not re.fullmatch(r'[a-z][a-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*', type_name):
            raise InvalidConfig('message type: wanted package/msg/Type, package/srv/Type_Event or '
                                f'package/action/Type_FeedbackMessage, got {type_name!r}')
        package, kind, name = type_name.split('/')
        relative = Path('share', package, kind, name.split('_')[0] + suffix)
        for prefix in self.prefixes:
            if (prefix / relative).is_file():
                return prefix / relative
        looked = ', '.join(map(str, self.prefixes)) or 'no prefix: AMENT_PREFIX_PATH is empty'
        raise InvalidConfig(f'{type_name}: wanted its definition in {relative}, not found below '
                            f'{looked}; install the package, or source the workspace it is in')

    def _text(self, type_name):
        """Return the ros2msg text of one type, without what it contains."""
        _, kind, name = type_name.split('/')
        if kind == 'msg':
            return self._find(type_name, '.msg').read_text(encoding='utf-8').rstrip()
        suffix = name[name.find('_'):]
        fields = self._fields(type_name)
        if suffix in _PARTS[kind] and fields[0]['name'] != _PLACEHOLDER:
            text = self._find(type_name, f'.{kind}').read_text(encoding='utf-8')
            part = re.split(r'^---[ \t]*$', text, flags=re.MULTILINE)[_PARTS[kind].index(suffix)]
            return _qualified(part.strip(), type_name)
        return '\n'.join(f'{_field_type(field["type"], type_name)} {field["name"]}'
                         for field in fields)

    def _idl(self, type_name):
        """Return the ros2idl text of one type: three nested modules and a struct."""
        package, kind, name = type_name.split('/')
        members = ''.join(f'      {_idl_member(field)};\n' for field in self._fields(type_name))
        path = f'{package}/{kind}/{name}'
        return (f'{DELIMITER}\nIDL: {path}\nmodule {package} {{\n  module {kind} {{\n'
                f'    struct {name} {{\n{members}    }};\n  }};\n}};\n')


def _headings(type_name):
    """Return the names of a part as in `MSG: package/Type`.

    Parts of actions stand under two: with their middle, by which the type hash is checked, and
    without it, by which readers find them from `Type` alone.
    """
    package, kind, name = type_name.split('/')
    short = f'{package}/{name}'
    return (type_name, short) if kind == 'action' else (short,)


def _reference(nested, owner):
    """Return how the text of type `owner` refers to a nested type."""
    package, kind, name = nested.split('/')
    if kind != 'msg' and owner.startswith(f'{package}/{kind}/'):
        return name
    return f'{package}/{name}'


def _split_id(type_id):
    """Return (id of the element, what is added for arrays and sequences)."""
    for added in (_SEQUENCE, _BOUNDED, _ARRAY):
        if type_id > added:
            return type_id - added, added
    return type_id, 0


def _field_type(described, owner):
    """Return the ros2msg spelling of a described field type."""
    element, added = _split_id(described['type_id'])
    if element == _NESTED:
        spelling = _reference(described['nested_type_name'], owner)
    else:
        spelling = _PRIMITIVES[element]
        if described['string_capacity']:
            spelling += f'<={described["string_capacity"]}'
    capacity = described['capacity']
    return spelling + {0: '', _ARRAY: f'[{capacity}]', _BOUNDED: f'[<={capacity}]',
                       _SEQUENCE: '[]'}[added]


def _idl_member(field):
    """Return the ros2idl spelling of a described field."""
    described = field['type']
    element, added = _split_id(described['type_id'])
    if element == _NESTED:
        spelling = described['nested_type_name'].replace('/', '::')
    else:
        spelling = _IDL_PRIMITIVES[element]
        if described['string_capacity']:
            spelling += f'<{described["string_capacity"]}>'
    capacity = described['capacity']
    if added == _ARRAY:
        return f'{spelling} {field["name"]}[{capacity}]'
    if added == _BOUNDED:
        return f'sequence<{spelling}, {capacity}> {field["name"]}'
    if added == _SEQUENCE:
        return f'sequence<{spelling}> {field["name"]}'
    return f'{spelling} {field["name"]}'


def _qualified(text, type_name):
    """Return a part of a service or action with its package before every bare message name.

    A bare name there means `package/msg/Name`; outside its file it would be looked for beside the
    service.
    """
    package = type_name.split('/')[0]

    def qualify(match):
        name = match.group(2)
        return match.group(0) if name in _BUILT_IN else f'{match.group(1)}{package}/{name}'

    return re.sub(r'^([ \t]*)([A-Za-z][A-Za-z0-9_]*)(?=[\[< \t])', qualify, text,
                  flags=re.MULTILINE)

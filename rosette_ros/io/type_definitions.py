# SPDX-License-Identifier: Apache-2.0
"""Message definitions of a ROS installation as a log holds them: complete text and type hash.

A ROS package installs its definitions (.msg, .srv, .action) and their type descriptions (.json) below
`share/<package>/`. A log needs for every type the text of the type and of all it contains (encoding `ros2msg`, MCAP
registry), also for the types that have no file of their own: service events, action feedback. Source: REP-2011,
rosidl_generator_type_description."""

import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosette_ros.core.run.errors import InvalidConfig

DELIMITER = '=' * 80  # the line between the parts of a ros2msg schema

_NESTED = 1
_PRIMITIVES = {
    2: 'int8', 3: 'uint8', 4: 'int16', 5: 'uint16', 6: 'int32', 7: 'uint32', 8: 'int64', 9: 'uint64', 10: 'float32',
    11: 'float64', 13: 'char', 15: 'bool', 16: 'byte', 17: 'string', 18: 'wstring', 21: 'string', 22: 'wstring'}
_IDL_PRIMITIVES = {**_PRIMITIVES, 10: 'float', 11: 'double', 13: 'char', 15: 'boolean', 16: 'octet'}
_BUILT_IN = frozenset(_PRIMITIVES.values())
_ARRAY, _BOUNDED, _SEQUENCE = 48, 96, 144  # added to the type id, type_description_interfaces
_PLACEHOLDER = 'structure_needs_at_least_one_member'  # the byte an empty structure has on the wire
_PARTS = {'srv': ('_Request', '_Response'), 'action': ('_Goal', '_Result', '_Feedback')}


@dataclass(frozen=True)
class TypeDefinition:
    """A type as a log describes it.

    name: `package/kind/Type`; text: ros2msg schema with all dependencies; hash: RIHS01 type hash; idl: for service
    events the same as ros2idl schema, else empty: not every reader of ros2msg can name a type of a service."""

    name: str
    text: str
    hash: str
    idl: str = ''


class TypeLibrary:
    """The definitions installed below the `share` folders of some prefixes, the first one wins."""

    def __init__(self, prefixes: Iterable[str | Path]) -> None:
        self.prefixes = tuple(Path(prefix) for prefix in prefixes)
        self._descriptions: dict[str, list[dict[str, Any]]] = {}
        self._hashes: dict[str, str] = {}

    @staticmethod
    def from_environment(environ: Mapping[str, str]) -> 'TypeLibrary':
        """Return the library of the prefixes in AMENT_PREFIX_PATH of a mapping."""
        paths = environ.get('AMENT_PREFIX_PATH', '')
        return TypeLibrary(path for path in paths.split(os.pathsep) if path)

    def definition(self, type_name: str) -> TypeDefinition:
        """Return the TypeDefinition of `package/kind/Type`; raises InvalidConfig where the type is not installed.

        Besides messages: `package/srv/Name_Event`, `package/action/Name_FeedbackMessage` and the other parts of
        services and actions."""
        names = [type_name]  # and all types it contains, each once, in order of appearance
        for name in names:
            nested = (field['type']['nested_type_name'] for field in self._fields(name))
            names += [one for one in dict.fromkeys(nested) if one and one not in names]
        parts = [self._text(type_name)]
        for name in names[1:]:
            package, kind, short = name.split('/')
            # By the full name rosbags checks the type hash of an action's parts; with a second definition under the
            # short one, readers that find types by their last part (Foxglove) have two to choose from.
            parts += [DELIMITER, f'MSG: {name if kind == "action" else f"{package}/{short}"}', self._text(name)]
        idl = '\n'.join(self._idl(name) for name in names) if type_name.endswith('_Event') else ''
        return TypeDefinition(type_name, '\n'.join(parts) + '\n', self._hashes[type_name], idl)

    def _fields(self, type_name: str) -> list[dict[str, Any]]:
        if type_name in self._descriptions:
            return self._descriptions[type_name]
        path = self._find(type_name, '.json')
        try:
            content = json.loads(path.read_text(encoding='utf-8'))
            message = content['type_description_msg']
            described = [message['type_description'], *message['referenced_type_descriptions']]
            hashes = {entry['type_name']: entry['hash_string'] for entry in content['type_hashes']}
            fields = {entry['type_name']: entry['fields'] for entry in described}
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidConfig(f'{path}: expected a type description with type_description_msg and type_hashes, found '
                                'something else; build the package again') from error
        if type_name not in fields or type_name not in hashes:
            raise InvalidConfig(f'{path}: expected a description of {type_name}, found {", ".join(sorted(fields))}')
        self._descriptions.update(fields)
        self._hashes.update(hashes)
        return self._descriptions[type_name]

    def _find(self, type_name: str, suffix: str) -> Path:
        """Return the installed file that defines a type: its name up to the first `_`."""
        if not re.fullmatch(r'[a-z][a-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*', type_name):
            raise InvalidConfig('message type: expected package/msg/Type, package/srv/Type_Event or '
                                f'package/action/Type_FeedbackMessage, found {type_name!r}')
        package, kind, name = type_name.split('/')
        relative = Path('share', package, kind, name.split('_')[0] + suffix)
        for prefix in self.prefixes:
            if (prefix / relative).is_file():
                return prefix / relative
        searched = ', '.join(map(str, self.prefixes)) or 'no prefix: AMENT_PREFIX_PATH is empty'
        raise InvalidConfig(f'{type_name}: expected its definition in {relative}, not found below {searched}; install '
                            'the package, or source the workspace it is in')

    def _text(self, type_name: str) -> str:
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
        return '\n'.join(f'{_field_type(field["type"], type_name)} {field["name"]}' for field in fields)

    def _idl(self, type_name: str) -> str:
        """Return the ros2idl text of one type: three nested modules and a struct."""
        package, kind, name = type_name.split('/')
        members = ''.join(f'      {_idl_member(field)};\n' for field in self._fields(type_name))
        return (f'{DELIMITER}\nIDL: {type_name}\nmodule {package} {{\n  module {kind} {{\n'
                f'    struct {name} {{\n{members}    }};\n  }};\n}};\n')


class StoredTypes:
    """The definitions of what a table becomes in a log, as this package has them: ROS is not needed."""

    def __init__(self) -> None:
        self._known: dict[str, dict[str, str]] = json.loads(
            Path(__file__).with_name('definitions.json').read_text(encoding='utf-8'))

    def definition(self, type_name: str) -> TypeDefinition:
        """Return the TypeDefinition of `package/msg/Type`."""
        return TypeDefinition(type_name, **self._known[type_name])


def _element(described: dict[str, Any], primitives: dict[int, str], nested: str, bound: str) -> tuple[str, int]:
    """Return (spelling of a described field without its array, what its type id has more than that of the element)."""
    added = next((added for added in (_SEQUENCE, _BOUNDED, _ARRAY) if described['type_id'] > added), 0)
    element, capacity = described['type_id'] - added, described['string_capacity']
    if element == _NESTED:
        return nested, added
    return primitives[element] + (bound.format(capacity) if capacity else ''), added


def _field_type(described: dict[str, Any], owner: str) -> str:
    package, kind, name = (described['nested_type_name'] or '//').split('/')
    is_sibling = kind != 'msg' and owner.startswith(f'{package}/{kind}/')
    element, added = _element(described, _PRIMITIVES, name if is_sibling else f'{package}/{name}', '<={}')
    capacity = described['capacity']
    return element + {0: '', _ARRAY: f'[{capacity}]', _BOUNDED: f'[<={capacity}]', _SEQUENCE: '[]'}[added]


def _idl_member(field: dict[str, Any]) -> str:
    described, name = field['type'], field['name']
    element, added = _element(described, _IDL_PRIMITIVES, described['nested_type_name'].replace('/', '::'), '<{}>')
    capacity = described['capacity']
    return {0: f'{element} {name}', _ARRAY: f'{element} {name}[{capacity}]', _SEQUENCE: f'sequence<{element}> {name}',
            _BOUNDED: f'sequence<{element}, {capacity}> {name}'}[added]


def _qualified(text: str, type_name: str) -> str:
    """Return a part of a service or action with its package before every bare message name.

    A bare name there means `package/msg/Name`; outside its file it would be searched beside the service."""
    package = type_name.split('/')[0]

    def qualify(match: re.Match[str]) -> str:
        name = match.group(2)
        return match.group(0) if name in _BUILT_IN else f'{match.group(1)}{package}/{name}'

    return re.sub(r'^([ \t]*)([A-Za-z][A-Za-z0-9_]*)(?=[\[< \t])', qualify, text, flags=re.MULTILINE)

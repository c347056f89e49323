# SPDX-License-Identifier: Apache-2.0
"""Model files: YAML, schema rosette-model/1."""

import contextlib
import os
from pathlib import Path

import yaml

from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.model import Model
from rosette_ros.data.plain_yaml import BAD_VALUE

MOST_BYTES = 100_000
DEEPEST = 20


def read_model(path):
    """Return the Model of a YAML file; raise InvalidModel, naming the file, if it holds none."""
    path = Path(path)
    try:
        with path.open('rb') as file:
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise InvalidModel(f'{path}: wanted a model file, found nothing there') from None
    except OSError as error:
        raise InvalidModel(
            f'{path}: wanted a readable model file, got: {error.strerror}') from error
    return parse_model(data, str(path))


def parse_model(data, source='model'):
    """Return the Model of YAML text (bytes); raise InvalidModel, naming `source`, if none."""
    return Model.from_mapping(_load(data, source), source)


def _load(data, source):
    if len(data) > MOST_BYTES:
        raise InvalidModel(
            f'{source}: wanted a model file of at most {MOST_BYTES} bytes, got more')
    try:
        text = data.decode('utf-8-sig')
        _refuse_tricks(text, source)
        return yaml.load(text, Loader=_Loader)
    except UnicodeDecodeError as error:
        raise InvalidModel(f'{source}: wanted UTF-8 text, got byte {data[error.start]:#04x} at '
                           f'position {error.start}') from None
    except yaml.YAMLError as error:
        raise InvalidModel(f'{source}: wanted YAML, got text that is none: {_words(error)}') \
            from None
    except BAD_VALUE as error:
        raise InvalidModel(f'{source}: wanted YAML values, got one that is none: '
                           f'{" ".join(str(error).split())}') from None


def parse_entry(text, source):
    """Return the mapping of YAML text that describes one effect: settings, or an own term.

    Raises InvalidModel, naming `source`, for text that is no mapping; {} for an empty one.
    """
    mapping = _load(text.encode(), source)
    if mapping is None:
        return {}
    if not isinstance(mapping, dict) or not all(isinstance(key, str) for key in mapping):
        raise InvalidModel(
            f'{source}: wanted a YAML mapping such as "tau: 600.0", got {text!r:.80}')
    return mapping


def format_entry(entry):
    """Return an effect's mapping as one line of YAML."""
    return yaml.safe_dump(entry, default_flow_style=True, sort_keys=False, allow_unicode=True,
                          width=10_000).strip()


def format_model(model):
    """Return the YAML text of a model."""
    return yaml.safe_dump(model.to_mapping(), sort_keys=False, allow_unicode=True)


def write_model(model, path, force=False):
    """Write a model file; raise InvalidModel where one stands already and `force` is not set."""
    path = Path(path)
    beside = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        if path.exists() and not force:
            raise InvalidModel(f'{path}: exists already; take another name or use --force')
        beside.write_text(format_model(model), encoding='utf-8')
        beside.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise InvalidModel(f'{path}: cannot be written: {error.strerror}') from error


class _Loader(yaml.SafeLoader):
    """The safe loader, which also refuses a key that stands twice."""

    def construct_mapping(self, node, deep=False):
        """Build a mapping; raise a YAMLError where two keys are equal."""
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f'key {key.value!r} stands twice', key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _refuse_tricks(text, source):
    """Raise InvalidModel for aliases and for deep nesting before anything is built from them."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise InvalidModel(f'{source}: line {event.start_mark.line + 1}: wanted plain YAML, '
                               'got an alias (*name); write it out')
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise InvalidModel(f'{source}: line {event.start_mark.line + 1}: wanted at most '
                               f'{DEEPEST} levels of nesting, got more')


def _words(error):
    """Return what a YAMLError says as one line with its place."""
    mark = getattr(error, 'problem_mark', None)
    place = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
    return place + (getattr(error, 'problem', None) or ' '.join(str(error).split()))

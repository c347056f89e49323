# SPDX-License-Identifier: Apache-2.0
"""Model files: YAML, schema rosette-model/1."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidModel
from rosette_ros.io.safe_yaml import PlainDumper, parse_mapping, read_yaml
from rosette_ros.io.text_file import write_text

MOST_BYTES = 100_000


def read_model(path: str | Path | None) -> Model:
    """Return the Model of a YAML file, without a file the base model; raise InvalidModel, naming the file, if none."""
    if path is None:
        return Model()
    return Model.from_mapping(read_yaml(path, 'a model file', MOST_BYTES, InvalidModel), str(path))


def parse_entry(text: str, source: str) -> dict[str, Any]:
    """Return the mapping of YAML text that describes one effect: settings, or a custom term; {} for an empty text.

    Raises InvalidModel, naming `source`, for text that is no mapping or too long."""
    mapping = parse_mapping(text, source, MOST_BYTES, 'tau: 600.0', InvalidModel)
    if not all(isinstance(key, str) for key in mapping):
        raise InvalidModel(f'{source}: expected a YAML mapping of names, found {text!r:.80}')
    return mapping


def format_entry(entry: Mapping[str, Any]) -> str:
    """Return an effect's mapping as one line of YAML."""
    return str(yaml.dump(entry, Dumper=PlainDumper, default_flow_style=True, sort_keys=False, allow_unicode=True,
                         width=10_000)).strip()


def format_model(model: Model) -> str:
    """Return the YAML text of a model."""
    return str(yaml.dump(model.to_mapping(), Dumper=PlainDumper, sort_keys=False, allow_unicode=True))


def write_model(model: Model, path: str | Path, force: bool = False) -> None:
    """Write a model file; raise InvalidData where one exists, unless `force`, or it cannot be written."""
    write_text(path, format_model(model), force)

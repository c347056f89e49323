# SPDX-License-Identifier: Apache-2.0
"""A sealed envelope: what a machine hides, written so that nobody reads it by accident.

The digest can be published first; when the envelope is opened later, it proves that nothing was changed. Base64 is no
encryption: it only keeps the answer from being read unintentionally.
"""

import base64
import hashlib
import json
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.text_file import regular, replace_file
from rosette_ros.simulation.machine import Machine
from rosette_ros.simulation.motion import MachineState

SCHEMA = 'rosette-envelope/1'


@dataclass(frozen=True)
class Envelope:
    """An opened envelope: sha256 of the sealed text, hex; seed of the machine; effects as in a configuration.

    state: where the machine stood before the run, None where it was just switched on.
    """

    digest: str
    seed: int
    hidden: tuple[dict[str, Any], ...]
    state: MachineState | None


def seal_envelope(path: Path, machine: Machine) -> str:
    """Write what a machine hides, and where it stands, into a new file; return its sha256, hex.

    Raises InvalidData if that fails.
    """
    hidden = [effect.model_dump(mode='json') for effect in machine.hidden]
    # The salt keeps anyone from finding the content by trying out configurations.
    content = {'seed': machine.config.seed, 'hidden': hidden, 'salt': secrets.token_hex(16),
               'state': {name: np.asarray(value).tolist() for name, value in vars(machine.state).items()}}
    text = json.dumps(content, sort_keys=True).encode()
    digest = hashlib.sha256(text).hexdigest()
    envelope = {'schema': SCHEMA, 'sha256': digest, 'sealed': base64.b64encode(text).decode()}
    try:
        replace_file(path, (json.dumps(envelope, indent=1) + '\n').encode(), force=False)
    except FileExistsError as error:
        raise InvalidData(f'{path}: expected a new file for the envelope, found one that exists; '
                          'name another, an envelope is never overwritten') from error
    except OSError as error:
        raise InvalidData(f'{path}: expected an envelope that can be written, found: {error}') from error
    return digest


def open_envelope(path: Path) -> Envelope:
    """Return what is in an envelope; raises InvalidData where it cannot be read, or does not agree with its digest."""
    try:
        with open(path, encoding='utf-8', opener=regular) as stream:
            outer = json.load(stream)
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidData(f'{path}: expected an envelope file, found: {error}') from error
    if not isinstance(outer, dict) or outer.get('schema') != SCHEMA:
        raise InvalidData(f'{path}: expected an envelope of schema {SCHEMA}, found something else')
    try:
        text = base64.b64decode(outer['sealed'], validate=True)
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidData(f'{path}: sealed: expected base64 text, found something else') from error
    digest = hashlib.sha256(text).hexdigest()
    if digest != outer.get('sha256'):
        raise InvalidData(f'{path}: expected content of sha256 {outer.get("sha256")!s:.64}, found '
                          f'{digest}; the envelope was changed after it was sealed')
    try:
        content = json.loads(text)
        return Envelope(digest, content['seed'], tuple(content['hidden']), _state(content.get('state')))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InvalidData(f'{path}: sealed: expected seed and hidden effects, found something else') from error


def _state(values: dict[str, Any] | None) -> MachineState | None:
    """Return the state of a machine as it was sealed; envelopes of earlier versions have none."""
    if values is None:
        return None
    made: dict[str, Any] = {name: np.array(value) if isinstance(value, list) else value
                            for name, value in dict(values).items()}
    return MachineState(**made)

# SPDX-License-Identifier: Apache-2.0
"""What the recorder knows of earlier runs: finding the log of a run, and reading it back."""

import re
from pathlib import Path

from rosette_msgs.srv import Recall

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.log_files import find_files, iter_log
from rosette_ros.data.log_reader import TF_STATIC
from rosette_ros.nodes import names
from rosette_ros.nodes.interfaces import decoded, interface_class

_LONGEST_NAME = 255  # bytes, of a folder
_PART = re.compile(r'(?P<run>.+)_part(?P<number>[1-9]\d{0,5})')
_FIELDS = {'rosette_msgs/msg/ProbeTarget': 'targets', 'rosette_msgs/msg/BallCentre': 'answers',
           'rosette_msgs/msg/CalibrationEvent': 'events', 'rosette_msgs/msg/ErrorMotions': 'error_motions'}
_TF_MESSAGE = 'tf2_msgs/msg/TFMessage'
_COPIED = {'rosette_msgs/msg/ProbeTarget': names.PROBE_TARGET, 'rosette_msgs/msg/BallCentre': names.BALL_CENTRE}
"""What of an earlier part stands at the head of the log that goes on from it; and its table frames."""


def find_part(log_dir, wanted):
    """Return the folder of the log to go on from.

    log_dir: Path of the recorder's logs; wanted: name of a folder in it, or its path. A bare run_id means its
    last part. Raises InvalidData where there is none, it lies elsewhere, or was gone on from already.
    """
    path = Path(wanted)
    longest = max(map(len, wanted.encode(errors='replace').split(b'/')))
    if not path.name.strip('.') or longest > _LONGEST_NAME or '\0' in wanted:
        raise InvalidData(f'resume: wanted the name of a log in {log_dir}, got {wanted!r:.100}')
    if path.name != wanted and path.absolute().parent.resolve() != log_dir.resolve():
        raise InvalidData(f'resume: wanted a log in the folder of the recorder, {log_dir}, got {wanted!r:.100}; '
                          'copy it there')
    match = _PART.fullmatch(path.name)
    run_id = match['run'] if match else path.name
    parts = parts_of(log_dir, run_id)
    if not parts or (match and log_dir / path.name not in parts):
        raise InvalidData(f'resume: wanted the log of a run in {log_dir}, got none named {path.name!r}; check the '
                          'name')
    if match and log_dir / path.name != parts[-1]:
        raise InvalidData(f'resume: {path.name} was gone on from already; resume {parts[-1].name}')
    return parts[-1]


def parts_of(log_dir, run_id):
    """Return the folders of a run's logs in order: the run, `_part2`, `_part3` and so on."""
    found = [log_dir / run_id] if (log_dir / run_id).is_dir() else []
    number = 2
    while (log_dir / f'{run_id}_part{number}').is_dir():
        found.append(log_dir / f'{run_id}_part{number}')
        number += 1
    return found


def next_part(log_dir, run_id):
    """Return the folder of the next part of a run."""
    return log_dir / f'{run_id}_part{max(len(parts_of(log_dir, run_id)), 1) + 1}'


def recall(folder, library):
    """Return the Recall.Response with what a log holds of the run it belongs to.

    library: schemas.TypeLibrary of the installed messages. Raises InvalidData where the log cannot be read or
    was written with another version of the messages.
    """
    response = Recall.Response(success=True, log=folder.name)
    match = _PART.fullmatch(folder.name)
    response.run_id = match['run'] if match else folder.name
    if not any(file.stat().st_size for file in find_files(folder).files):
        return response
    for message in iter_log(folder):
        if message.type_name in _FIELDS:
            _check_version(message, library, folder)
            found = decoded(message.data, interface_class(message.type_name))
            if found.run_id == response.run_id:
                getattr(response, _FIELDS[message.type_name]).append(found)
        elif _is_frames(message):
            response.frames += decoded(message.data, interface_class(_TF_MESSAGE)).transforms
    return response


def iter_copied(folder):
    """Yield (name of the topic, LoggedMessage) for what of a log stands at the head of the next part."""
    for message in iter_log(folder):
        if message.type_name in _COPIED:
            yield _COPIED[message.type_name], message
        elif _is_frames(message):
            yield names.TF_STATIC, message


def _is_frames(message):
    return message.type_name == _TF_MESSAGE and message.topic.rpartition('/')[2] == TF_STATIC


def _check_version(message, library, folder):
    installed = library.definition(message.type_name).hash
    if message.type_hash and message.type_hash != installed:
        raise InvalidData(f'resume: {folder.name}: was written with another version of {message.type_name}; it can '
                          'be evaluated, not gone on with')

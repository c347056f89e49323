# SPDX-License-Identifier: Apache-2.0
"""Logs of earlier runs, as the recorder finds them and reads them back."""

import os
import re
from collections.abc import Iterator
from itertools import count, takewhile
from pathlib import Path

from rosette_msgs.msg import CalibrationEvent
from rosette_msgs.srv import Recall
from tf2_msgs.msg import TFMessage

from rosette_ros.core.errors import InvalidData
from rosette_ros.io.bag_metadata import find_files
from rosette_ros.io.log_reader import MAGIC, LoggedMessage, iter_log
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes import names
from rosette_ros.nodes.interfaces import decoded, interface_class

_PART = re.compile(r'(?P<run>.+)_part(?P<number>[1-9]\d{0,5})')
_FIELDS = {'rosette_msgs/msg/ProbeTarget': 'targets', 'rosette_msgs/msg/BallCentre': 'answers',
           'rosette_msgs/msg/CalibrationEvent': 'events', 'rosette_msgs/msg/ErrorMotions': 'error_motions'}
_COPIED = {'rosette_msgs/msg/ProbeTarget': names.PROBE_TARGET, 'rosette_msgs/msg/BallCentre': names.BALL_CENTRE,
           'rosette_msgs/msg/Touches': names.TOUCHES}
"""What of an earlier part opens the log that continues it; and the table frames after its first target: those before it
are of earlier runs, whatever their stamps are."""


def find_part(log_dir: Path, wanted: str) -> Path:
    """Return the folder of the log to continue from; wanted: its name in `log_dir`, its path or that of its .mcap file,
    or a run_id (last part).

    Raises InvalidData where there is none, it lies elsewhere, or was continued already."""
    path = Path(os.path.expanduser(wanted))
    if path.suffix == '.mcap' and path.parent.name and path.name.startswith(f'{path.parent.name}_'):
        path, wanted = path.parent, str(path.parent)
    longest = max(map(len, wanted.encode(errors='replace').split(b'/')))
    if not path.name.strip('.') or longest > 255 or '\0' in wanted:
        raise InvalidData(f'resume: wanted the name of a log in {log_dir}, got {wanted!r:.100}')
    if path.name != wanted and path.absolute().parent.resolve() != log_dir.resolve():
        raise InvalidData(f'resume: wanted a log in the folder of the recorder, {log_dir}, got {wanted!r:.100}; '
                          'copy it there')
    parts = parts_of(log_dir, run_of(path.name))
    is_part = run_of(path.name) != path.name
    if not parts or (is_part and log_dir / path.name not in parts):
        raise InvalidData(f'resume: wanted the log of a run in {log_dir}, got none named {path.name!r}; check the name')
    if is_part and log_dir / path.name != parts[-1]:
        raise InvalidData(f'resume: {path.name} was continued already; resume {parts[-1].name}')
    return parts[-1]


def run_of(name: str) -> str:
    """Return the run_id in the name of a log."""
    match = _PART.fullmatch(name)
    return match['run'] if match else name


def parts_of(log_dir: Path, run_id: str) -> list[Path]:
    """Return the folders of a run's logs in order: the run, `_part2`, `_part3` and so on."""
    first = [log_dir / run_id] if (log_dir / run_id).is_dir() else []
    return first + list(takewhile(Path.is_dir, (log_dir / f'{run_id}_part{number}' for number in count(2))))


def next_part(log_dir: Path, run_id: str) -> Path:
    """Return the folder of the next part of a run."""
    return log_dir / f'{run_id}_part{max(len(parts_of(log_dir, run_id)), 1) + 1}'


def recall(folder: Path, library: TypeLibrary) -> Recall.Response:
    """Return what a log holds of its run; library: of the installed messages.

    Of a log that was not closed no success is returned: its run can be resumed, and ends from what is in the log.
    Raises InvalidData where the log cannot be read or was written with another version of the messages."""
    response = Recall.Response(success=True, log=folder.name, run_id=run_of(folder.name))
    files = find_files(folder).files
    if not any(file.stat().st_size for file in files):
        return response
    for message in iter_log(folder):
        if message.type_name in _FIELDS:
            if message.channel.type_hash not in ('', library.definition(message.type_name).hash):
                raise InvalidData(f'resume: {folder.name}: was written with another version of {message.type_name}; '
                                  'it can be evaluated, not continued')
            found = decoded(message.data, interface_class(message.type_name))
            if found.run_id == response.run_id:
                getattr(response, _FIELDS[message.type_name]).append(found)
        elif message.channel.is_static_frames and response.targets:
            response.frames += decoded(message.data, TFMessage).transforms
    with open(files[-1], 'rb') as stream:
        stream.seek(-len(MAGIC), os.SEEK_END)
        is_closed = stream.read() == MAGIC
    if not is_closed:
        response.events = [event for event in response.events if event.kind != CalibrationEvent.SUCCEEDED]
    return response


def iter_copied(folder: Path) -> Iterator[tuple[str, LoggedMessage]]:
    """Yield (name of the topic, message) for what of a log opens the next part."""
    has_begun = False
    for message in iter_log(folder):
        if message.type_name in _COPIED:
            has_begun = True
            yield _COPIED[message.type_name], message
        elif message.channel.is_static_frames and has_begun:
            yield names.TF_STATIC, message

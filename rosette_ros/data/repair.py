# SPDX-License-Identifier: Apache-2.0
"""A log that was cut short or lost its metadata.yaml, written anew beside the old one."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.bag_metadata import FILE_NAME, parse_qos
from rosette_ros.data.log_files import custom_data, file_number, find_files, open_files
from rosette_ros.data.schemas import TypeDefinition
from rosette_ros.data.whole_log import whole_log

FROM_KEY = 'rosette.repaired_from'
"""Entry of custom_data that names the log from which a repaired one was made."""


@dataclass(frozen=True)
class Repair:
    """What a repair did: where the new log is, its messages, and what was wrong with the old one."""

    directory: Path
    messages: int
    problems: tuple[str, ...]


def repaired_name(path):
    """Return where a repaired log goes unless asked otherwise: `<log>_repaired` beside it."""
    path = Path(path).absolute()
    return path.with_name(f'{path.stem if path.suffix == ".mcap" else path.name}_repaired')


def repair_log(path, directory=None):
    """Write every message that can be read of a log as a whole new log; return what was done.

    The new log has a summary, indexes and metadata.yaml, schemas, QoS and times as they were; the old
    one is not touched. directory: of the new log, repaired_name(path) if None.

    Raises InvalidData where the log is whole, holds nothing, is none, or the directory holds a log, CellError where
    the disk refuses; nothing is left then.
    """
    path = Path(path)
    listing, problems = _files(path)
    directory = repaired_name(path) if directory is None else Path(directory)
    if path.is_dir() and not (path / FILE_NAME).is_file():
        problems.append(f'{path}: {FILE_NAME} is missing')
    read = [_read(file) for file in open_files(listing)]
    problems += [problem for file in read for problem in file.problems]
    if not problems:
        raise InvalidData(f'{path}: is whole; there is nothing to repair')
    _refuse_inside(path, directory)
    with whole_log(directory, directory.name, compression='lz4',
                   custom_data={**custom_data(read), FROM_KEY: path.name}) as writer:
        kinds, left_out = {}, Counter()
        for file in open_files(listing):
            left_out += _copy(file, writer, kinds)
        problems += [f'{path}: topic {topic!r} is of more than one type: {count} messages were left out'
                     for topic, count in left_out.items()]
        return Repair(directory, writer.message_count, tuple(problems))


def _files(path):
    """Return (.mcap files of a log, problems): all that are there where metadata.yaml is none or lacks some."""
    found = sorted(path.glob('*.mcap'), key=file_number) if path.is_dir() else []
    try:
        listing = find_files(path)
    except InvalidData as error:
        if not found:
            raise
        return tuple(found), [str(error)]
    return (tuple(found), list(listing.problems)) if listing.problems else (listing.files, [])


def _read(file):
    """Return a file that was read to its end: its problems and metadata are known."""
    for _ in file.batches():
        pass
    return file


def _refuse_inside(path, directory):
    home = path.absolute() if path.is_dir() else path.absolute().parent
    if directory.absolute() == home:
        raise InvalidData(f'{directory}: is the folder of the log itself; wanted another one for the '
                          'repaired log')


def _copy(file, writer, kinds):
    """Write the messages of a file; topics are added to `kinds` as they are met, with what they are.

    Return by topic how many messages are left out: those of another type than the topic's first.
    """
    left_out = Counter()
    for batch in file.batches():
        rows = zip(batch.channel.tolist(), batch.log_time.tolist(), batch.publish_time.tolist(),
                   batch.start.tolist(), batch.end.tolist(), strict=True)
        for identifier, log_time, publish_time, start, end in rows:
            channel = file.channels.get(identifier)
            if channel is None:
                continue
            kind = (channel.type_name, channel.schema_text, channel.message_encoding)
            if channel.topic not in kinds:
                kinds[channel.topic] = kind
                writer.add_topic(channel.topic, _definition(file, channel),
                                 parse_qos(channel.metadata.get('offered_qos_profiles', '')))
            if kinds[channel.topic] == kind:
                writer.write(channel.topic, batch.buffer[start:end].tobytes(), log_time, publish_time)
            else:
                left_out[channel.topic] += 1
    return left_out


def _definition(file, channel):
    """Return the TypeDefinition that the channels of a topic carry."""
    idl = [other.schema_text for other in file.channels.values()
           if other.topic == channel.topic and other.schema_encoding == 'ros2idl']
    return TypeDefinition(channel.type_name, channel.schema_text,
                          channel.metadata.get('topic_type_hash', ''), idl[0] if idl else '')

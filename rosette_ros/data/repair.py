# SPDX-License-Identifier: Apache-2.0
"""A log that was cut short or lost its metadata.yaml, written anew beside the old one."""

from dataclasses import dataclass
from pathlib import Path

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.bag_metadata import FILE_NAME, parse_qos
from rosette_ros.data.log_files import custom_data, find_files
from rosette_ros.data.log_writer import LogWriter
from rosette_ros.data.mcap_scan import McapFile
from rosette_ros.data.schemas import TypeDefinition

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

    Raises InvalidData where the log is whole, holds nothing, is none, or the directory holds a log.
    """
    path = Path(path)
    listing = _files(path)
    directory = repaired_name(path) if directory is None else Path(directory)
    problems = [] if not path.is_dir() or (path / FILE_NAME).is_file() else [
        f'{path}: {FILE_NAME} is missing']
    read = [_read(name) for name in listing]
    problems += [problem for file in read for problem in file.problems]
    if not problems:
        raise InvalidData(f'{path}: is whole; there is nothing to repair')
    _refuse_inside(path, directory)
    with LogWriter(directory, directory.name, compression='lz4',
                   custom_data={**custom_data(read), FROM_KEY: path.name}) as writer:
        for name in listing:
            _copy(McapFile(name), writer)
        return Repair(directory, writer.message_count, tuple(problems))


def _files(path):
    """Return the .mcap files of a log; those that are there where metadata.yaml cannot be read."""
    try:
        return find_files(path).files
    except InvalidData:
        found = sorted(path.glob('*.mcap')) if path.is_dir() else []
        if not found:
            raise
        return tuple(found)


def _read(name):
    """Return a file that was read to its end: its problems and metadata are known."""
    file = McapFile(name)
    for _ in file.batches():
        pass
    return file


def _refuse_inside(path, directory):
    home = path.absolute() if path.is_dir() else path.absolute().parent
    if directory.absolute() == home:
        raise InvalidData(f'{directory}: is the folder of the log itself; wanted another one for the '
                          'repaired log')


def _copy(file, writer):
    """Write the messages of a file; topics are added as they are met."""
    known = set(writer.counts)
    for batch in file.batches():
        rows = zip(batch.channel.tolist(), batch.log_time.tolist(), batch.publish_time.tolist(),
                   batch.start.tolist(), batch.end.tolist(), strict=True)
        for identifier, log_time, publish_time, start, end in rows:
            channel = file.channels.get(identifier)
            if channel is None:
                continue
            if channel.topic not in known:
                known.add(channel.topic)
                writer.add_topic(channel.topic, _definition(file, channel),
                                 parse_qos(channel.metadata.get('offered_qos_profiles', '')))
            writer.write(channel.topic, batch.buffer[start:end].tobytes(), log_time, publish_time)


def _definition(file, channel):
    """Return the TypeDefinition that the channels of a topic carry."""
    idl = [other.schema_text for other in file.channels.values()
           if other.topic == channel.topic and other.schema_encoding == 'ros2idl']
    return TypeDefinition(channel.type_name, channel.schema_text,
                          channel.metadata.get('topic_type_hash', ''), idl[0] if idl else '')

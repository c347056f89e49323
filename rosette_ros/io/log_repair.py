# SPDX-License-Identifier: Apache-2.0
"""A log that was cut short or lost its metadata.yaml, written anew beside the old one."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from rosette_ros.core.errors import InvalidData
from rosette_ros.io.bag_metadata import FILE_NAME, BagListing, files_in, find_files
from rosette_ros.io.log_reader import READ_WITHIN, LogFile, open_files, read_log
from rosette_ros.io.log_writer import LogWriter, whole_log
from rosette_ros.io.type_definitions import TypeDefinition

FROM_KEY = 'rosette.repaired_from'  # entry of custom_data, name of the log from which a repaired one was made


@dataclass(frozen=True)
class Repair:
    """What a repair did: where the new log is, its messages, and what was wrong with the old one."""

    directory: Path
    messages: int
    problems: tuple[str, ...]


def repair_log(path: str | Path, directory: str | Path | None = None) -> Repair:
    """Write every message that can be read of a log as a whole new log; return what was done.

    The new log has a summary, indexes and metadata.yaml, schemas, QoS and times as they were; the old one is not
    touched. directory: of the new log, `<log>_repaired` beside the old one if None.

    Raises InvalidData where the log is whole, cannot be read, is none, or the directory holds a log, CellError where
    the disk refuses; nothing is left then."""
    path = Path(path)
    listing = _listing(path)
    if directory is None:
        full = path.absolute()
        directory = full.with_name(f'{full.stem if full.suffix == ".mcap" else full.name}_repaired')
    directory = Path(directory)
    log = read_log(path, listing)
    problems = [*log.problems]
    if path.is_dir() and not (path / FILE_NAME).is_file():
        problems.append(f'{path}: {FILE_NAME} is missing')
    if not problems:
        raise InvalidData(f'{path}: is whole; there is nothing to repair')
    if directory.absolute() == (path.absolute() if path.is_dir() else path.absolute().parent):
        raise InvalidData(f'{directory}: is the folder of the log itself; wanted another one for the repaired log')
    with whole_log(directory, directory.name, compression='lz4',
                   custom_data={**log.custom_data, FROM_KEY: path.name}) as writer:
        problems += [f'{path}: topic {topic!r} is of more than one type: {count} messages were left out'
                     for topic, count in _copy(open_files(listing, READ_WITHIN), writer).items()]
        return Repair(directory, writer.message_count, tuple(problems))


def _listing(path: Path) -> BagListing:
    """Return the files of a log and its problems: all that are there where metadata.yaml is none or lacks some."""
    found = files_in(path) if path.is_dir() else ()
    try:
        listing = find_files(path)
    except InvalidData as error:
        if not found:
            raise
        return BagListing(found, problems=(str(error),))
    return replace(listing, files=found) if listing.problems else listing


def _copy(files: list[LogFile], writer: LogWriter) -> Counter[str]:
    """Write the messages of files; return by topic how many were left out, being of another type than its first."""
    topics, left_out = dict[str, tuple[str, str, str]](), Counter[str]()
    for file in files:
        for message in file.messages():
            channel = message.channel
            kind = (channel.type_name, channel.schema_text, channel.message_encoding)
            if channel.topic not in topics:
                topics[channel.topic] = kind
                idl = next((other.schema_text for other in file.channels.values()
                            if other.topic == channel.topic and other.schema_encoding == 'ros2idl'), '')
                writer.add_topic(channel.topic, TypeDefinition(*kind[:2], channel.type_hash, idl), channel.qos)
            if topics[channel.topic] == kind:
                writer.write(channel.topic, message.data, message.log_time, message.publish_time)
            else:
                left_out[channel.topic] += 1
    return left_out

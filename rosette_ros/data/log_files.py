# SPDX-License-Identifier: Apache-2.0
"""Which files make up a log, and walking through all their messages."""

import re
from dataclasses import dataclass
from pathlib import Path

import yaml

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.bag_metadata import FILE_NAME, MAX_BYTES, BagListing, read_bag_metadata
from rosette_ros.data.log_writer import METADATA_KEY, METADATA_RECORD
from rosette_ros.data.mcap_scan import McapFile
from rosette_ros.data.plain_yaml import BAD_VALUE, load_plain


@dataclass(frozen=True)
class LoggedMessage:
    """One message as it stands in the log: CDR bytes, times in ns; type_hash: '' where the log has none."""

    topic: str
    type_name: str
    log_time: int
    publish_time: int
    data: bytes
    type_hash: str = ''


def find_files(path):
    """Return the BagListing of a log: paths of its .mcap files in order, and its custom_data.

    path: a log directory or one .mcap file. Raises InvalidData where there is none, or
    metadata.yaml names a file that is missing.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            if not path.exists():
                raise InvalidData(f'{path}: wanted a log directory or an .mcap file, got nothing '
                                  'there; check the path')
            return BagListing((path,), {})
        if (path / FILE_NAME).is_file():
            return _listed(path)
        found = sorted(path.glob('*.mcap'), key=file_number)
    except OSError as error:
        raise InvalidData(f'{path}: wanted a log that can be read, got {error.strerror}; '
                          'check the path and its rights') from error
    if not found:
        raise InvalidData(f'{path}: wanted a log directory with .mcap files, got none in it')
    return BagListing(tuple(found), {})


def _listed(path):
    listing = read_bag_metadata(path / FILE_NAME)
    for name in listing.files:
        if not (path / name).is_file():
            raise InvalidData(f'{path / FILE_NAME}: names {name}, which is missing; put the file '
                              'back, or delete metadata.yaml to read the files that are there')
    others = sorted({one.name for one in path.glob('*.mcap')} - {*listing.files})
    problems = (f'{path / FILE_NAME}: does not name {", ".join(others)}, which was not read; delete metadata.yaml to '
                'read all files that are there',) if others else ()
    return BagListing(tuple(path / name for name in listing.files), listing.custom_data, problems)


def file_number(path):
    """Return the sorting key of `<name>_<number>.mcap`."""
    match = re.fullmatch(r'(.*)_(\d{1,9})', path.stem)
    return (match[1], int(match[2])) if match else (path.stem, 0)


def open_files(names):
    """Return a McapFile of each file of a log; what a later one repeats of an earlier one is passed over."""
    return [McapFile(name, skip_repeated=row > 0) for row, name in enumerate(names)]


def custom_data(files):
    """Return the custom_data that rosbag2's metadata record in read McapFiles tells."""
    for file in reversed(files):
        text = file.metadata.get(METADATA_RECORD, {}).get(METADATA_KEY, '')
        if not text or len(text) > MAX_BYTES:
            continue
        try:
            found = (load_plain(text) or {}).get('custom_data') or {}
            return {str(key): str(value) for key, value in found.items()}
        except (yaml.YAMLError, *BAD_VALUE):
            continue
    return {}


def iter_log(path):
    """Yield every message of a log as LoggedMessage, in the order of recording."""
    for file in open_files(find_files(path).files):
        for batch in file.batches():
            rows = zip(batch.channel.tolist(), batch.log_time.tolist(),
                       batch.publish_time.tolist(), batch.start.tolist(), batch.end.tolist(),
                       strict=True)
            for identifier, log_time, publish_time, start, end in rows:
                channel = file.channels.get(identifier)
                if channel is not None:
                    yield LoggedMessage(channel.topic, channel.type_name, log_time, publish_time,
                                        batch.buffer[start:end].tobytes(),
                                        channel.metadata.get('topic_type_hash', ''))

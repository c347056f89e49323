# SPDX-License-Identifier: Apache-2.0
"""rosbag2's description of a log: metadata.yaml version 9, and quality of service in its words.

Every key is mandatory for rosbag2. The same mapping, without the top-level key, stands in each
.mcap file as metadata record `rosbag2`. Source: rosbag2_storage (jazzy), metadata_io and yaml.hpp.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import yaml

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.plain_yaml import BAD_VALUE, load_plain

VERSION = 9
FILE_NAME = 'metadata.yaml'
TOP_KEY = 'rosbag2_bagfile_information'
INFINITE = 9223372036 * 10**9 + 854775807
"""Duration that rosbag2 writes for "no limit", ns."""
MAX_BYTES = 1 << 20
"""A larger metadata.yaml is refused: a log of a cell needs some ten thousand bytes."""

_Dumper = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offers, policies as rosbag2's words, durations in ns."""

    history: str = 'keep_last'
    depth: int = 10
    reliability: str = 'reliable'
    durability: str = 'volatile'
    deadline_ns: int = INFINITE
    lifespan_ns: int = INFINITE
    liveliness: str = 'automatic'
    liveliness_lease_ns: int = INFINITE
    avoid_ros_namespace_conventions: bool = False

    def as_mapping(self):
        """Return the nine keys that rosbag2 wants."""
        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': _duration(self.deadline_ns),
            'lifespan': _duration(self.lifespan_ns),
            'liveliness': self.liveliness,
            'liveliness_lease_duration': _duration(self.liveliness_lease_ns),
            'avoid_ros_namespace_conventions': self.avoid_ros_namespace_conventions,
        }

    @staticmethod
    def from_mapping(mapping):
        """Return the Qos of a mapping that rosbag2 wrote; KeyError or TypeError if it is none."""
        return Qos(
            str(mapping['history']), int(mapping['depth']), str(mapping['reliability']),
            str(mapping['durability']), _nanoseconds(mapping['deadline']),
            _nanoseconds(mapping['lifespan']), str(mapping['liveliness']),
            _nanoseconds(mapping['liveliness_lease_duration']),
            bool(mapping['avoid_ros_namespace_conventions']))


def _duration(nanoseconds):
    return {'sec': nanoseconds // 10**9, 'nsec': nanoseconds % 10**9}


def _nanoseconds(duration):
    return int(duration['sec']) * 10**9 + int(duration['nsec'])


def qos_text(profiles):
    """Return offered QoS profiles as the YAML text of a channel's metadata."""
    if not profiles:
        return ''
    return yaml.dump([profile.as_mapping() for profile in profiles], Dumper=_Dumper,
                     sort_keys=False)


def parse_qos(text):
    """Return the tuple of Qos in a channel's metadata; empty where the text is none."""
    if len(text) > MAX_BYTES:
        return ()
    try:
        return tuple(Qos.from_mapping(entry) for entry in load_plain(text) or ())
    except (yaml.YAMLError, *BAD_VALUE):
        return ()  # without it a replay takes its own defaults


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a log: its name, type, RIHS01 type hash, offered Qos, number of messages."""

    name: str
    type_name: str
    hash: str
    qos: tuple = ()
    messages: int = 0


@dataclass(frozen=True)
class FileSummary:
    """One file of a log: its name, first and last log time in ns, number of messages."""

    path: str
    start_ns: int = 0
    end_ns: int = 0
    messages: int = 0


def bag_mapping(topics, files, custom_data=None, ros_distro='jazzy'):
    """Return rosbag2's BagMetadata of a log as a mapping.

    topics: TopicSummary each; files: FileSummary each; custom_data: mapping of texts or None.
    """
    used = [entry for entry in files if entry.messages]
    start = min((entry.start_ns for entry in used), default=0)
    end = max((entry.end_ns for entry in used), default=start)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(entry.messages for entry in files),
        'topics_with_message_count': [_topic_mapping(topic) for topic in topics],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [entry.path for entry in files],
        'files': [{
            'path': entry.path,
            'starting_time': {'nanoseconds_since_epoch': entry.start_ns},
            'duration': {'nanoseconds': entry.end_ns - entry.start_ns},
            'message_count': entry.messages,
        } for entry in files],
        'custom_data': dict(custom_data) if custom_data else None,
        'ros_distro': ros_distro,
    }


def _topic_mapping(topic):
    return {
        'topic_metadata': {
            'name': topic.name,
            'type': topic.type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': [profile.as_mapping() for profile in topic.qos],
            'type_description_hash': topic.hash,
        },
        'message_count': topic.messages,
    }


def bag_text(mapping):
    """Return a BagMetadata mapping as YAML."""
    return yaml.dump(mapping, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def write_bag_metadata(directory, mapping):
    """Write `directory`/metadata.yaml as a whole or not at all: a killed writer leaves the old."""
    target = Path(directory, FILE_NAME)
    temporary = target.with_suffix('.yaml.part')
    with open(temporary, 'w', encoding='utf-8') as stream:
        stream.write(bag_text({TOP_KEY: mapping}))
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(temporary, target)
    synchronise_folder(directory)


def synchronise_folder(directory):
    """Bring the names in a folder to the disk: a file of which only the content is there is lost without power."""
    folder = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


@dataclass(frozen=True)
class BagListing:
    """What a reader needs of metadata.yaml: files: names in order; custom_data: mapping; problems: in words."""

    files: tuple
    custom_data: dict
    problems: tuple = ()


def read_bag_metadata(path):
    """Return the BagListing of a metadata.yaml.

    Raises InvalidData where it is not one, or names files outside its folder.
    """
    path = Path(path)
    if path.stat().st_size > MAX_BYTES:
        raise InvalidData(f'{path}: wanted at most {MAX_BYTES} bytes, got {path.stat().st_size}; '
                          'give the .mcap file itself')
    try:
        bag = load_plain(path.read_text(encoding='utf-8'))[TOP_KEY]
        storage, names = bag['storage_identifier'], bag['relative_file_paths']
        custom_data = bag.get('custom_data') or {}
        named = isinstance(names, list) and all(isinstance(name, str) for name in names)
        custom_data = {str(key): str(value) for key, value in custom_data.items()}
    except (yaml.YAMLError, *BAD_VALUE) as error:
        raise InvalidData(
            f'{path}: wanted a rosbag2 description with {TOP_KEY}, storage_identifier and '
            f'relative_file_paths, got {type(error).__name__}; give the .mcap file itself, or '
            'delete metadata.yaml') from error
    if storage != 'mcap':
        raise InvalidData(f'{path}: storage_identifier: wanted mcap, got {storage!r:.80}; '
                          'convert the log with `ros2 bag convert`')
    if not named or not names or any(Path(name).name != name for name in names) or len({*names}) < len(names):
        raise InvalidData(f'{path}: relative_file_paths: wanted names of files in the same '
                          f'folder, got {names!r:.200}; each is named once')
    return BagListing(tuple(names), custom_data)

# SPDX-License-Identifier: Apache-2.0
"""rosbag2's description of a log: metadata.yaml version 9, quality of service in its words, the files of a log.

Every key is mandatory for rosbag2. The same mapping, without the top-level key, stands in each .mcap file as metadata
record `rosbag2`. Source: rosbag2_storage (jazzy), metadata_io and yaml.hpp."""

import re
import shlex
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.safe_yaml import BAD_VALUE, PlainDumper, load_plain
from rosette_ros.io.text_file import is_regular, read_limited, replace_file

VERSION = 9
FILE_NAME = 'metadata.yaml'
TOP_KEY = 'rosbag2_bagfile_information'
METADATA_RECORD, METADATA_KEY = 'rosbag2', 'serialized_metadata'
"""Name and key of the metadata record of an .mcap file that holds the description."""
CHECKSUM_KEY = 'rosette.checksum'
"""Entry of custom_data: CRC-32 of the other entries."""
INFINITE = 9223372036 * 10**9 + 854775807  # duration that rosbag2 writes for "no limit", ns
MOST_LOST = 20  # missing files that are named
MAX_BYTES = 1 << 20  # a larger metadata.yaml is refused: a log of a cell needs some ten thousand bytes

_TIMES = ('deadline', 'lifespan', 'liveliness_lease_duration')


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offers, policies as rosbag2's words, durations in ns; rosbag2's nine keys."""

    history: str = 'keep_last'
    depth: int = 10
    reliability: str = 'reliable'
    durability: str = 'volatile'
    deadline: int = INFINITE
    lifespan: int = INFINITE
    liveliness: str = 'automatic'
    liveliness_lease_duration: int = INFINITE
    avoid_ros_namespace_conventions: bool = False

    def as_mapping(self) -> dict[str, Any]:
        """Return the nine keys that rosbag2 wants, in its order."""
        times = {name: dict(zip(('sec', 'nsec'), divmod(getattr(self, name), 10**9), strict=True)) for name in _TIMES}
        return {**vars(self), **times}

    @staticmethod
    def from_mapping(mapping: Mapping[str, Any]) -> 'Qos':
        """Return the Qos of a mapping that rosbag2 wrote; KeyError or TypeError if it is none."""
        times = {name: int(mapping[name]['sec']) * 10**9 + int(mapping[name]['nsec']) for name in _TIMES}
        return Qos(**{name: kind({**mapping, **times}[name]) for name, kind in Qos.__annotations__.items()})


def qos_text(profiles: Iterable[Qos]) -> str:
    """Return offered QoS profiles as the YAML text of a channel's metadata, '' for none."""
    entries = [profile.as_mapping() for profile in profiles]
    return yaml.dump(entries, Dumper=PlainDumper, sort_keys=False) if entries else ''


@lru_cache(maxsize=256)
def parse_qos(text: str) -> tuple[Qos, ...]:
    """Return the Qos in a channel's metadata; empty where the text is none: a replay then takes its own defaults."""
    if len(text) > MAX_BYTES:
        return ()
    try:
        return tuple(Qos.from_mapping(entry) for entry in load_plain(text) or ())
    except (yaml.YAMLError, *BAD_VALUE):
        return ()


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a log: its name, type, RIHS01 type hash, offered Qos, number of messages."""

    name: str
    type_name: str
    hash: str
    qos: tuple[Qos, ...] = ()
    messages: int = 0


@dataclass
class FileSummary:
    """One file of a log: its name, first and last log time in ns, number of messages."""

    path: str
    start_ns: int = 0
    end_ns: int = 0
    messages: int = 0

    def count(self, log_time: int) -> None:
        """Count one message more."""
        self.start_ns = min(self.start_ns, log_time) if self.messages else log_time
        self.end_ns = max(self.end_ns, log_time) if self.messages else log_time
        self.messages += 1


def span(files: Iterable[FileSummary]) -> tuple[int, int]:
    """Return first and last log time in files, ns; zeros where they hold nothing."""
    used = [entry for entry in files if entry.messages]
    return min((entry.start_ns for entry in used), default=0), max((entry.end_ns for entry in used), default=0)


def bag_mapping(topics: Iterable[TopicSummary], files: Sequence[FileSummary],
                custom_data: Mapping[str, str]) -> dict[str, Any]:
    """Return rosbag2's BagMetadata of a log as a mapping."""
    start, end = span(files)
    return {
        'version': VERSION, 'storage_identifier': 'mcap', 'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start}, 'message_count': sum(entry.messages for entry in files),
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name, 'type': topic.type_name, 'serialization_format': 'cdr',
                'offered_qos_profiles': [profile.as_mapping() for profile in topic.qos],
                'type_description_hash': topic.hash},
            'message_count': topic.messages} for topic in topics],
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': [entry.path for entry in files],
        'files': [{
            'path': entry.path, 'starting_time': {'nanoseconds_since_epoch': entry.start_ns},
            'duration': {'nanoseconds': entry.end_ns - entry.start_ns},
            'message_count': entry.messages} for entry in files],
        'custom_data': {CHECKSUM_KEY: _checksum(custom_data), **custom_data} if custom_data else None,
        'ros_distro': 'jazzy'}


def bag_text(mapping: Mapping[str, Any]) -> str:
    """Return a BagMetadata mapping as YAML."""
    return str(yaml.dump(mapping, Dumper=PlainDumper, sort_keys=False, allow_unicode=True))


def _checksum(custom_data: Mapping[str, str]) -> str:
    return f'{zlib.crc32(repr(sorted(custom_data.items())).encode()):08x}'


def _custom_data(bag: Any) -> dict[str, str] | None:
    """Return the custom_data of a mapping without its checksum, None where that is wrong."""
    found = {str(key): str(value) for key, value in ((bag or {}).get('custom_data') or {}).items()}
    stated = found.pop(CHECKSUM_KEY, None)
    return found if stated in (None, _checksum(found)) else None


def custom_data_in(record: Mapping[str, str]) -> dict[str, str]:
    """Return the custom_data in the metadata record of an .mcap file, empty where there is none.

    Raises ValueError where its checksum is wrong."""
    text = record.get(METADATA_KEY, '')
    block = re.search(r'^custom_data:.*\n(?:[ \t-].*\n|\n)*', text, re.MULTILINE)  # of 25 kB it is most often one line
    try:
        found = load_plain(block[0] if block else text) if len(text) <= MAX_BYTES else None
        custom_data = _custom_data(found)
    except (yaml.YAMLError, *BAD_VALUE):
        return {}
    if custom_data is None:
        raise ValueError('custom_data with a wrong checksum')
    return custom_data


def write_bag_metadata(directory: Path, mapping: Mapping[str, Any], is_first: bool) -> None:
    """Write `directory`/metadata.yaml as a whole or not at all; raises FileExistsError where the first is there."""
    replace_file(directory / FILE_NAME, bag_text({TOP_KEY: mapping}).encode(), force=not is_first)


_OTHERS = {b'rosbag2_bagfile_information:': 'describes a log; name the folder that it is in',
           b'SQLite format 3\0': 'is an sqlite3 log; expected MCAP: convert it with `ros2 bag convert`',
           b'#ROSBAG V': 'is a bag of ROS 1; expected MCAP: convert it with `rosbags-convert --src BAG --dst FOLDER '
                         '--dst-storage mcap` (pip install rosbags)',
           b'PK\x03\x04': 'is a workbook or an archive; expected a table: save it as CSV, UTF-8, or unpack it'}
_PACKED = b'\x28\xb5\x2f\xfd'  # zstd
_UNPACK = ((b'\x1f\x8b', 0, 'gzip -dk'), (b'\xfd7zXZ\0', 0, 'xz -dk'), (b'BZh', 0, 'bzip2 -dk'),
           (b'ustar', 257, 'tar -xf'))
"""What stands in a packed file, at which byte, and what unpacks it."""


@dataclass(frozen=True)
class BagListing:
    """The .mcap files of a log in order, and of its metadata.yaml: custom_data, what is wrong, messages by file."""

    files: tuple[Path, ...]
    custom_data: dict[str, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    messages: dict[Path, int] = field(default_factory=dict)


def is_hidden(name: str) -> bool:
    """Return whether a file or folder is none that a person has put there: hidden, the lock of a spreadsheet, of macOS
    or a NAS, in the trash."""
    return name.casefold().startswith(('.', '~$', '$recycle.bin', '__macosx', '#recycle', '@recycle', '@eadir'))


def is_one_log(names: Iterable[str]) -> bool:
    """Return whether files in a folder are one log: they are described, a single one, or numbered as rosbag2 does."""
    names = list(names)
    return FILE_NAME in names or len({numbered(name)[0] for name in names if name.endswith('.mcap')}) == 1


def is_named_as_log(directory: Path) -> bool:
    """Return whether a folder is one log by the names of its files, sound or not, compressed or not."""
    names = [one.name for one in files_in(directory)] + [one.stem for one in packed_in(directory)]
    return is_one_log([*names, *([FILE_NAME] if (directory / FILE_NAME).is_file() else [])])


def numbered(name: str) -> tuple[str, int]:
    """Return the name of a file without its number, and that: `x_12.mcap`: x and 12; `x_000001` and times have none."""
    match = re.fullmatch(r'(.*)_(0|[1-9]\d{0,4})', Path(name).stem)
    return (match[1], int(match[2])) if match else (Path(name).stem, 0)


def files_in(directory: Path) -> tuple[Path, ...]:
    """Return the .mcap files in a directory, `<name>_<number>.mcap` in the order of their numbers."""
    return tuple(sorted(_shown(directory, '*.mcap'), key=lambda path: numbered(path.name)))


def packed_in(directory: Path) -> list[Path]:
    """Return the files that rosbag2 has compressed as a whole and nobody has unpacked beside."""
    return sorted(path for path in _shown(directory, '*.mcap.zst*') if not path.with_suffix('').is_file())


def _shown(directory: Path, pattern: str) -> list[Path]:
    return [path for path in directory.glob(pattern) if not is_hidden(path.name) and is_regular(path)]


def refuse_other(path: Path, begin: bytes) -> None:
    """Raise InvalidData where a file, by its first bytes, is packed or of another kind that is known."""
    if begin.startswith(_PACKED):
        raise packed_error([path])
    for magic, at, command in _UNPACK:
        if begin.startswith(magic, at):
            raise InvalidData(f'{path}: is a packed file; unpack it: {command} {shlex.quote(str(path))}')
    for magic, words in _OTHERS.items():
        if begin.startswith(magic):
            raise InvalidData(f'{path}: {words}')


def packed_error(paths: Sequence[Path]) -> InvalidData:
    """Return the error about compressed files of a folder, with the command that unpacks them."""
    path, *others = paths
    if others:
        return InvalidData(f'{path.parent}: its files are compressed; unpack them: for f in '
                           f'{shlex.quote(str(path.parent))}/*.mcap.zst*; do zstd -d "$f" -o "${{f%.*}}"; done')
    command = shlex.join(['zstd', '-d', str(path), '-o', str(path.with_suffix(''))])
    return InvalidData(f'{path}: is a compressed file; unpack it: {command}')


def rest_words(end: int, size: int) -> str:
    """Return in words what lies behind the end of a file of `size` bytes, '' where nothing does."""
    return (f'ends at byte {end}; {size - end} bytes behind it were not read: was another log put behind it? Cut them '
            'off, and read what they are by itself') if size > end else ''


def _bare(name: str) -> str:
    """Return the name of a file without the folders that it was in."""
    return re.split(r'[/\\]', name)[-1]


def read_bag_metadata(path: Path) -> BagListing:
    """Return the BagListing of a metadata.yaml.

    A file is looked for beside it, wherever a path says that it was. Raises InvalidData where it is none, or names
    files that are missing."""
    data = read_limited(path, 'a log description', MAX_BYTES)
    try:
        bag = load_plain(data.decode())[TOP_KEY]
        storage, names = bag.get('storage_identifier') or 'mcap', bag['relative_file_paths']  # else what the files are
        custom_data = _custom_data(bag)
        messages = {path.parent / _bare(entry['path']).removesuffix('.zstd'): int(entry['message_count'])
                    for entry in bag.get('files') or ()}
    except (yaml.YAMLError, *BAD_VALUE) as error:
        raise InvalidData(
            f'{path}: expected a rosbag2 description with {TOP_KEY} and relative_file_paths, found '
            'another text; give the .mcap file itself, or delete metadata.yaml') from error
    if storage != 'mcap':
        raise InvalidData(f'{path}: storage_identifier: expected mcap, found {storage!r:.80}; convert the log with '
                          '`ros2 bag convert`')
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    names = list(map(_bare, names)) if is_list else names
    if not (is_list and names and all(names) and not {'.', '..'} & {*names} and len({*names}) == len(names)):
        raise InvalidData(f'{path}: relative_file_paths: expected names of files in the same folder, found '
                          f'{names!r:.200}; '
                          'each is named once')
    files = tuple(path.parent / name.removesuffix('.zstd') for name in names)  # as they are when unpacked
    for file in files:
        if not file.is_file():
            raise InvalidData(f'{path}: names {file.name}, which is missing; put the file back, or delete '
                              'metadata.yaml to read the files that are there')
    others = [one.name for one in files_in(path.parent) if one not in files]
    problems = []
    if others:
        problems.append(f'{path}: does not name {", ".join(others)}, which was not read; delete metadata.yaml to read '
                        'all files that are there')
    if custom_data is None:
        problems.append(f'{path}: custom_data: its checksum is wrong; that in the .mcap files is used')
    return BagListing(files, custom_data or {}, tuple(problems), messages)

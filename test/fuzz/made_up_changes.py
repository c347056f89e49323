# SPDX-License-Identifier: Apache-2.0
"""Changes to the records of a log: lengths, checksums, schemas, channels, messages, order."""

import struct
from copy import copy

from hypothesis import strategies as st
from made_up import TRICKS, WORDS, dumped, mutated, trees
from made_up_log import (
    CHANNEL,
    CHUNK,
    MESSAGE,
    METADATA,
    SCHEMA,
    U4,
    U8,
    Chunk,
    Fields,
    loose,
    mapping,
    parsed,
    small_log,
    text,
    unparsed,
)

LENGTHS = st.one_of(
    st.sampled_from([0, 1, 8, 21, 22, 2**31 - 1, 2**31, 2**32, 2**40, 2**60, 2**63 - 1, 2**63, 2**64 - 1]),
    st.integers(0, 300),
    st.integers(0, 2**64 - 1),
)
TEXTS = st.one_of(
    WORDS,
    st.binary(max_size=6),
    st.sampled_from(
        [
            '/ball_centre', '/tf_static', '/probe_target', '/run_state', 'rosette_msgs/msg/BallCentre',
            'tf2_msgs/msg/TFMessage', 'rosette_msgs/msg/ProbeTarget', 'rosette_msgs/msg/RunState',
            'rosette_msgs/msg/ErrorMotions', 'cdr', 'ros2msg', 'ros2idl', 'json', '/', 'a/b/c/d', 'x' * 300,
        ]
    ),
)
KINDS = [
    'bool', 'byte', 'char', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'int64', 'uint64', 'float32',
    'float64', 'string', 'wstring', 'string<=3', 'std_msgs/Header', 'Header', 'geometry_msgs/Point', 'X',
    'nowhere/X',
]
LINES = st.one_of(
    WORDS,
    TRICKS,
    st.builds(
        '{}{} {}{}'.format,
        st.sampled_from(KINDS),
        st.sampled_from(
            [
                '', '', '[]', '[3]', '[0]', '[<=3]', '[1000000000]', '[' + '9' * 30 + ']', '[' + '9' * 5000 + ']',
                '[', '[-1]',
            ]
        ),
        st.sampled_from(['x', 'seq', 'run_id', 'header', 'status', '9x', 'x=3', 'x "y"', '']),
        st.sampled_from(['', ' # x', '=1', ' 5']),
    ),
    st.sampled_from(
        [
            '=' * 80, '===', 'MSG: std_msgs/Header', 'MSG: rosette_msgs/BallCentre', 'MSG: a/X', 'X x', 'X[100] x',
            'MSG: ', '=' * 80 + '\nMSG: rosette_msgs/X\nX x', '=' * 80 + '\nMSG: rosette_msgs/X\nfloat64[0] x',
        ]
    ),
)
QOS = trees(
    st.sampled_from(
        [
            'history', 'depth', 'reliability', 'durability', 'deadline', 'sec', 'nsec', 'lifespan', 'liveliness',
            'liveliness_lease_duration', 'avoid_ros_namespace_conventions',
        ]
    )
)
BAG = trees(
    st.sampled_from(
        [
            'version', 'storage_identifier', 'relative_file_paths', 'custom_data', 'message_count', 'files',
            'rosbag2_bagfile_information', 'rosette.repeatability_m', 'rosette.repeated_balls',
        ]
    )
)
YAMLS = st.one_of(
    TRICKS,
    QOS.map(dumped),
    BAG.map(dumped),
    BAG.map(lambda tree: dumped({'custom_data': tree})),
    WORDS,
    st.builds('custom_data: {{rosette.repeatability_m: {!r}}}'.format, WORDS),
    TRICKS.map(lambda trick: f'custom_data:\n {trick}'),
)


@st.composite
def changed_schema(draw, content):
    """Return a schema record with another number, name, encoding or text."""
    fields = Fields(content)
    parts = [fields.number('<H'), fields.text(), fields.text(), fields.text()]
    part = draw(st.sampled_from([0, 1, 2, 3, 3, 3, 3]))
    if part == 0:
        parts[0] = draw(st.integers(0, 8))
    elif part < 3:
        parts[part] = draw(TEXTS)
    else:
        lines = [line for line in parts[3].decode().split('\n') if line.strip() and line[0] != '#'] or ['']
        for _ in range(draw(st.integers(1, 3))):
            at, how = (
                draw(st.integers(0, len(lines) - 1)),
                draw(st.sampled_from(['line', 'kind', 'kind', 'kind', 'drop', 'twice', 'swap', 'end'])),
            )
            words = lines[at].split(' ', 1)
            if how == 'kind' and len(words) == 2:
                lines[at] = (
                    f'{draw(st.sampled_from(KINDS))}{draw(st.sampled_from(["", "", "[]", "[2]", "[0]"]))} {words[1]}'
                )
            elif how == 'drop':
                del lines[at]
            elif how == 'twice':
                lines.insert(draw(st.integers(0, len(lines))), lines[at])
            elif how == 'swap':
                other = draw(st.integers(0, len(lines) - 1))
                lines[at], lines[other] = lines[other], lines[at]
            elif how == 'end':
                lines.append(draw(LINES))
            else:
                lines[at] = draw(LINES)
            lines = lines or ['']
        parts[3] = '\n'.join(lines)
    return struct.pack('<H', parts[0]) + b''.join(map(text, parts[1:]))


@st.composite
def changed_channel(draw, content):
    """Return a channel record with another number, schema, topic, encoding or metadata."""
    fields = Fields(content)
    parts = [fields.number('<H'), fields.number('<H'), fields.text(), fields.text(), fields.mapping()]
    part = draw(st.sampled_from([0, 1, 2, 3, 4, 4]))
    if part < 2:
        parts[part] = draw(st.one_of(st.integers(0, 8), st.just(65535)))
    elif part < 4:
        parts[part] = draw(TEXTS)
    else:
        key = draw(st.one_of(st.sampled_from([b'offered_qos_profiles', b'topic_type_hash']), TEXTS))
        parts[4] = {**parts[4], key: draw(YAMLS)}
    return struct.pack('<HH', *parts[:2]) + text(parts[2]) + text(parts[3]) + mapping(parts[4])


EXTREME = st.one_of(
    st.sampled_from(
        [U4.pack(0), U4.pack(1), U4.pack(2**31), U4.pack(2**32 - 1), U4.pack(10_000), U4.pack(10_001)]
    ),
    st.floats().map(lambda value: struct.pack('<d', value)),
    st.sampled_from([0.0, -0.0, 1e308, -1e308, 5e-324, float('nan'), float('inf'), float('-inf')]).map(
        lambda value: struct.pack('<d', value)
    ),
    st.integers(0, 255).map(lambda value: bytes([value])),
    st.binary(min_size=1, max_size=8),
)


@st.composite
def changed_message(draw, content):
    """Return a message record with another channel, number, time, or other data."""
    part = draw(st.sampled_from(['channel', 'sequence', 'time', 'data', 'data', 'data', 'data', 'cut', 'more']))
    if part == 'channel':
        return struct.pack('<H', draw(st.one_of(st.integers(0, 8), st.just(65535)))) + content[2:]
    if part == 'sequence':
        return content[:2] + U4.pack(draw(st.integers(0, 2**32 - 1))) + content[6:]
    if part == 'time':
        return content[:6] + U8.pack(draw(LENGTHS)) + content[14:]
    if part == 'cut':
        return content[: draw(st.integers(0, len(content)))]
    if part == 'more':
        return content + draw(st.binary(max_size=9))
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        new = draw(EXTREME)
        at = 22 + 4 + len(new) * draw(st.integers(0, max((len(content) - 26) // len(new) - 1, 0)))
        at = draw(st.sampled_from([at, 22])) if draw(st.integers(0, 9)) == 0 else at
        changed[at : at + len(new)] = new
    return bytes(changed)


@st.composite
def changed_metadata(draw, content):
    """Return a metadata record with another name or mapping."""
    name = draw(st.sampled_from([b'rosbag2', b'rosbag2', b'x']))
    return text(name) + mapping({draw(st.sampled_from([b'serialized_metadata', b'x'])): draw(YAMLS)})


CHANGES = {SCHEMA: changed_schema, CHANNEL: changed_channel, MESSAGE: changed_message, METADATA: changed_metadata}


def _places(records):
    """Return where every record stands: (list that holds it, position)."""
    return [
        (home, at)
        for record in [None, *records]
        if record is None or isinstance(record, Chunk)
        for home in [records if record is None else record.records]
        for at in range(len(home))
    ]


@st.composite
def changed_records(draw, records, most=3):
    """Return records of which some are changed, doubled, moved, dropped, or tell a wrong length."""
    records = [copy(record) for record in records]
    for record in records:
        if isinstance(record, Chunk):
            record.records = [copy(inner) for inner in record.records]
    for _ in range(draw(st.integers(1, most))):
        places = _places(records)
        wanted = draw(
            st.sampled_from(
                [None, None, SCHEMA, SCHEMA, SCHEMA, CHANNEL, CHANNEL, MESSAGE, MESSAGE, MESSAGE, METADATA, CHUNK]
            )
        )
        some = [place for place in places if wanted in (None, place[0][place[1]].opcode)] or places
        home, at = some[draw(st.integers(0, len(some) - 1))]
        how = draw(st.sampled_from(['content'] * 14 + ['drop', 'twice', 'move', 'length', 'opcode', 'bytes']))
        _change(draw, records, home, at, how)
        if not records:
            break
    return records


def _change(draw, records, home, at, how):
    record = home[at]
    if how == 'drop':
        del home[at]
    elif how == 'twice':
        home.insert(draw(st.integers(0, len(home))), record)
    elif how == 'move':
        home.remove(record)
        others = [records] + [one.records for one in records if isinstance(one, Chunk) and one is not record]
        other = others[draw(st.integers(0, len(others) - 1))]
        other.insert(draw(st.integers(0, len(other))), record)
    elif how == 'length':
        record.length = draw(LENGTHS)
    elif isinstance(record, Chunk):
        what = draw(st.sampled_from(['size', 'crc', 'packed', 'compression']))
        if what == 'compression':
            record.compression = draw(st.one_of(st.sampled_from(['lz4', 'zstd', '', 'bz2']), st.text(max_size=4)))
        else:
            setattr(record, what, draw(st.integers(0, 2**32 - 1)) if what == 'crc' else draw(LENGTHS))
    elif how == 'opcode':
        record.opcode = draw(st.integers(0, 255))
    elif how == 'content' and record.opcode in CHANGES:
        try:
            record.content = draw(CHANGES[record.opcode](record.content))
        except (struct.error, UnicodeDecodeError):
            pass  # a change before has left nothing that can be taken apart
    else:
        record.content = draw(mutated(record.content))


@st.composite
def changed_logs(draw):
    """Return the bytes of a log that was changed: records, their order, and then perhaps bytes."""
    compression = draw(st.sampled_from(['none', 'lz4', 'zstd']))
    records = parsed(small_log(compression, draw(st.sampled_from([700, 2500, 100_000]))))
    if draw(st.integers(0, 4)) == 0:
        records = loose(records)
    how = draw(st.sampled_from(['records'] * 9 + ['bytes', 'both', 'cut']))
    if how != 'bytes':
        records = draw(changed_records(records))
    data = unparsed(records, draw(st.booleans()))
    if how == 'cut':
        return data[: draw(st.integers(0, len(data)))]
    return data if how == 'records' else draw(mutated(data))

# SPDX-License-Identifier: Apache-2.0
"""Files of our own writer, record by record, against those of the mcap library for the same calls."""

import io
import itertools
import zlib

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex, DataEnd, Footer, Header, MetadataIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from rosette_ros.data.mcap_writer import COMPRESSIONS, McapWriter

THEIRS = {'none': CompressionType.NONE, 'lz4': CompressionType.LZ4, 'zstd': CompressionType.ZSTD}
MESSAGES = [(1 + number % 2, number, 10**18 + 10**6 * (number ^ 5), 10**18 + number, bytes([number]) * (7 * number))
            for number in range(40)]
"""(channel, sequence, log time, publish time, data); log times do not always rise."""
TEXT = 'string data  # µm\n'.encode()


def ours(compression='none', chunk_size=500, messages=MESSAGES):
    """Return a file by our writer."""
    stream = io.BytesIO()
    writer = McapWriter(stream, 'test', chunk_size, compression)
    writer.add_metadata('first', {'key': 'µ', 'other': ''})
    for topic in ('/a', '/b'):
        schema = writer.add_schema('std_msgs/msg/String', 'ros2msg', TEXT)
        writer.add_channel(topic, 'cdr', schema, {'topic_type_hash': 'RIHS01_0'})
    for row, message in enumerate(messages):
        writer.add_message(*message)
        if row % 11 == 10:
            writer.flush()
    writer.flush()
    writer.flush()
    writer.add_metadata('last', {})
    writer.finish()
    return stream.getvalue()


def theirs(compression='none', chunk_size=500, messages=MESSAGES):
    """Return a file by the mcap library."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size, THEIRS[compression])
    writer.start('ros2', 'test')
    writer.add_metadata('first', {'key': 'µ', 'other': ''})
    for topic in ('/a', '/b'):
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', TEXT)
        writer.register_channel(topic, 'cdr', schema, {'topic_type_hash': 'RIHS01_0'})
    for row, (channel, sequence, log_time, publish_time, data) in enumerate(messages):
        writer.add_message(channel, log_time, data, publish_time, sequence)
        if row % 11 == 10:
            writer.flush()
    writer.flush()
    writer.add_metadata('last', {})
    writer.finish()
    return stream.getvalue()


def records(data, chunks):
    """Return all records that the mcap library finds; chunks: as they are, instead of what is in them."""
    return list(StreamReader(io.BytesIO(data), emit_chunks=chunks, validate_crcs=True).records)


@pytest.mark.parametrize('compression', COMPRESSIONS)
@pytest.mark.parametrize('chunks', [False, True])
def test_every_record_is_that_of_the_mcap_library(compression, chunks):
    """Chunks, their indexes, statistics and metadata, with the same offsets; summary offsets where a group is."""
    own, other = records(ours(compression), chunks), records(theirs(compression), chunks)
    other = [record for record in other if not isinstance(record, SummaryOffset) or record.group_length]
    assert [record for record in own if not isinstance(record, Footer)] == [
        record for record in other if not isinstance(record, Footer)]
    assert any(isinstance(record, ChunkIndex) for record in own)
    assert any(isinstance(record, Chunk) for record in own) == chunks
    assert isinstance(own[0], Header)


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_the_seeking_reader_finds_every_message_in_order_of_time(compression):
    """By the indexes, with all checksums verified."""
    reader = make_reader(io.BytesIO(ours(compression)), validate_crcs=True)
    found = [(channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
             for _, channel, message in reader.iter_messages()]
    wanted = [('/ab'[0] + ' ab'[channel], *rest) for channel, *rest in MESSAGES]
    assert found == sorted(wanted, key=lambda entry: entry[2])
    assert [record.name for record in reader.iter_metadata()] == ['first', 'last']


def test_the_summary_and_its_checksum_are_where_the_footer_says():
    """By the specification: CRC-32 from the start of the summary to the checksum itself."""
    data = ours()
    footer = records(data, True)[-1]
    assert zlib.crc32(data[footer.summary_start:-12]) == footer.summary_crc
    groups = [record for record in records(data, True) if isinstance(record, SummaryOffset)]
    assert groups[0].group_start == footer.summary_start
    for before, after in itertools.pairwise(groups):
        assert before.group_start + before.group_length == after.group_start
    assert groups[-1].group_start + groups[-1].group_length == footer.summary_offset_start
    assert all(data[group.group_start] == group.group_opcode for group in groups)


def test_a_file_without_messages_tells_its_topics():
    """They stand before the end of the data and in the summary, as the specification wants it."""
    data = ours(messages=[])
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert [channel.topic for channel in summary.channels.values()] == ['/a', '/b']
    assert summary.statistics.message_count == summary.statistics.chunk_count == 0
    found = records(data, True)
    end = next(row for row, record in enumerate(found) if isinstance(record, DataEnd))
    assert sum(type(record).__name__ == 'Channel' for record in found[:end]) == 2
    assert sum(isinstance(record, MetadataIndex) for record in found) == 2


def test_size_is_that_of_the_file():
    """What is written, and the open chunk."""
    stream = io.BytesIO()
    writer = McapWriter(stream, 'test', 500)
    schema = writer.add_schema('std_msgs/msg/String', 'ros2msg', TEXT)
    writer.add_channel('/a', 'cdr', schema, {})
    before = writer.size
    writer.add_message(1, 0, 1, 1, bytes(100))
    assert writer.size == before + 31 + 100
    writer.finish()
    assert writer.size == len(stream.getvalue())
    assert writer.chunks == 1

# SPDX-License-Identifier: Apache-2.0
"""Damaged logs: flipped bytes, cuts, and damage aimed at lengths, checksums and kinds of records.

Each is refused in one line, or read with a problem that is reported; where nothing is reported, every number of the
run is that of the undamaged log, bit for bit. Time and memory are bounded.
"""

import resource
import time
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Header, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io import log_reader
from rosette_ros.io.ball_centre_table import read_csv
from rosette_ros.io.log_reader import MAGIC, iter_log, read_log
from rosette_ros.io.message_decoder import message_decoder
from rosette_ros.io.run_to_log import write_log

TABLE = Path(__file__).parents[1] / 'golden' / 'tables' / 'table_clean_n6_row.csv'
FLIPS, CUTS = 40, 20
MOST_SECONDS, MOST_BYTES = 2.0, 70e6
LENGTHS = (0, 1, 22, 2**28, 2**28 + 1, 2**31, 2**40, 2**63, 2**64 - 1)


@pytest.fixture(params=['none', 'lz4', 'zstd'])
def sound(make_cell, tmp_path, request):
    """Return the bytes of a log of several chunks."""
    make_cell().write(tmp_path / 'log', chunk_size=1500, compression=request.param)
    return (tmp_path / 'log' / 'log_0.mcap').read_bytes()


def numbers(run):
    """Return every number of a run as bytes."""
    return [np.asarray(getattr(run, name)).tobytes() for name in (
        'table_position', 'ball', 'centre', 'table_angle', 'time', 'temperature', 'approach', 'table_travel')] + [
            run.radius, run.repeatability, run.repeatability_dof, run.run_id]


def records(data):
    """Return (opcode, where its length stands, its length) of each record of a whole file."""
    found, at = [], 8
    while at < len(data) - 8:
        length = int.from_bytes(data[at + 1:at + 9], 'little')
        found.append((data[at], at + 1, length))
        at += 9 + length
    return found


def replaced(data, at, new):
    """Return the bytes with others from `at` on."""
    return data[:at] + new + data[at + len(new):]


def flipped(data, rng):
    """Yield logs of which one to four bytes are others."""
    for _ in range(FLIPS):
        changed = bytearray(data)
        for _ in range(rng.integers(1, 5)):
            changed[rng.integers(8, len(data))] ^= 1 << rng.integers(8)
        yield bytes(changed)


def cut(data, rng):
    """Yield logs that end early, or lack a piece."""
    for _ in range(CUTS):
        begin = int(rng.integers(len(data)))
        yield data[:begin]
        yield data[:begin] + data[begin + int(rng.integers(1, 3000)):]


def aimed(data, rng):
    """Yield logs with another length, kind, checksum or size of a record."""
    for opcode, at, _ in records(data):
        yield replaced(data, at - 1, bytes([rng.choice([0, 5, 7, 8, 10, 128 + opcode])]))
        yield replaced(data, at, int(rng.choice(np.array(LENGTHS, dtype=np.uint64))).to_bytes(8, 'little'))
        if opcode == Opcode.CHUNK:
            for place, size in ((24, 8), (32, 4), (36, 4)):  # size when uncompressed, checksum, length of a name
                yield replaced(data, at + place, bytes(rng.integers(0, 256, size, dtype=np.uint8)))
            yield replaced(data, at + 24, int(rng.choice(LENGTHS[:6])).to_bytes(8, 'little'))
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            place = 8 + (2 if opcode == Opcode.SCHEMA else 4 if opcode == Opcode.CHANNEL else 0)
            yield replaced(data, at + place, int(rng.choice([0, 1, 2**31, 2**32 - 1])).to_bytes(4, 'little'))


@pytest.mark.parametrize('damage', [flipped, cut, aimed])
def test_damage_is_reported_or_without_effect(sound, tmp_path, damage):
    """Never another error, never other numbers in silence."""
    path = tmp_path / 'some.mcap'
    path.write_bytes(sound)
    log = read_log(path)
    wanted, whole = numbers(log.to_run()), log.messages
    assert log.problems == ()
    memory, reported = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0
    for data in damage(sound, np.random.default_rng(7)):
        path.write_bytes(data)
        begin = time.process_time()
        try:
            log = read_log(path)
            run = log.to_run()
            assert sum(1 for _ in iter_log(path)) <= log.messages
        except InvalidData as error:
            assert 'some.mcap' in str(error)
            assert '\n' not in str(error)
            reported += 1
            continue
        finally:
            assert time.process_time() - begin < MOST_SECONDS
        if log.problems:
            reported += 1
            assert all(str(path) in problem and '\n' not in problem for problem in log.problems)
            assert run.size <= 16
        else:
            assert numbers(run) == wanted
            assert log.messages == whole
    assert reported
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) < MOST_BYTES


@pytest.mark.parametrize('rest', ['', 'a text', 'zeros', 'another log'])
def test_data_behind_the_end_are_said(sound, tmp_path, rest):
    """Text, what a disk has padded, a second log: not read, and said with the place; the run is the same."""
    behind = {'': b'', 'a text': b'copied by hand', 'zeros': bytes(512), 'another log': sound}[rest]
    path = tmp_path / 'joined.mcap'
    path.write_bytes(sound + behind)
    found = read_log(path)
    path.write_bytes(sound)
    assert numbers(found.to_run()) == numbers(read_log(path).to_run())
    assert [f'ends at byte {len(sound)}; {len(behind)} bytes behind it were not read' in one
            for one in found.problems] == [True] * bool(behind)


@pytest.fixture
def many(make_cell, tmp_path):
    """Return a log of some 40 chunks, and the places of its chunks by the index of the mcap library."""
    log = make_cell(10).write(tmp_path / 'log', chunk_size=900)
    with open(log / 'log_0.mcap', 'rb') as stream:
        chunks = [(one.chunk_start_offset, one.chunk_length) for one in make_reader(stream).get_summary().chunk_indexes]
    assert len(chunks) > 30
    return log, chunks


@pytest.mark.parametrize('is_cut', [False, True], ids=['whole', 'killed'])
def test_a_chunk_whose_kind_is_damaged_is_missed(many, is_cut):
    """By the summary of the file, and where it was never written by metadata.yaml."""
    log, chunks = many
    path, (place, _) = log / 'log_0.mcap', chunks[20]
    data, whole = path.read_bytes(), read_log(log).messages
    for kind in (*range(18), 0x26, 0x80, 0x86):
        changed = bytearray(data if not is_cut else data[:chunks[-1][0] + chunks[-1][1]])
        changed[place] = kind
        path.write_bytes(changed)
        found = read_log(log)
        assert bool(found.problems) == (is_cut or kind != Opcode.CHUNK)
        if not is_cut:
            assert whole - 6 <= found.messages <= whole + 1
        elif kind not in (0, Opcode.CHUNK):  # 0 ends the file
            assert not all(': ends in the middle' in problem for problem in found.problems)


def test_a_cut_log_whose_chunk_is_hidden_is_not_whole(many, tmp_path):
    """Only metadata.yaml counts the messages of the chunk that is skipped."""
    log, chunks = many
    path, (place, _) = log / 'log_0.mcap', chunks[20]
    data = bytearray(path.read_bytes())
    data[place] = 0x80  # a private record is skipped
    for kind, at, _ in records(data):
        if kind == Opcode.STATISTICS:
            data[at - 1] = 0x80  # a private record; the checksum of the summary is then wrong, too
    path.write_bytes(data)
    [problem] = read_log(log).problems
    assert 'messages, as its summary or metadata.yaml says, found' in problem


@pytest.mark.parametrize('begin', [0, 3000, 5000, 9000, 12_000, 22_500])
def test_a_block_of_zeros_costs_only_the_chunks_that_it_touches(many, begin):
    """The summary points to the others, and has schemas and channels."""
    log, chunks = many
    path = log / 'log_0.mcap'
    with open(path, 'rb') as stream:
        messages = [sum(isinstance(one, Message) for one in breakup_chunk(record))
                    for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    data = bytearray(path.read_bytes())
    begin = 64 + begin
    kept = [count for count, (place, length) in zip(messages, chunks, strict=True)
            if begin >= place + length or place >= begin + 4096]
    assert begin + 4096 < chunks[-1][0]
    data[begin:begin + 4096] = bytes(4096)
    path.write_bytes(data)
    found = read_log(log)
    assert found.problems
    assert found.messages == sum(kept)


def test_the_repeatability_of_an_imported_log_has_a_checksum(library, tmp_path):
    """A flipped bit in what the log says of it is refused or told, or the copy elsewhere is used."""
    run = read_csv(TABLE).take(slice(12))
    log, silent = write_log(run, tmp_path / 'log', library), 0
    for path in (log / 'metadata.yaml', log / 'log_0.mcap'):
        data = path.read_bytes()
        begin = data.rindex(b'custom_data')
        for place in range(begin, data.index(b'ros_distro', begin), 3):
            path.write_bytes(replaced(data, place, bytes([data[place] ^ 1 << place % 8])))
            try:
                found = read_log(log if path.suffix == '.yaml' else path)
                got = found.to_run()
            except InvalidData:
                continue
            if not found.problems:
                silent += 1
                assert (got.repeatability, got.repeatability_dof) == (run.repeatability, run.repeatability_dof)
        path.write_bytes(data)
    assert silent  # a log without a checksum, or the copy beside it


HEAD = 22  # bytes of the header record


def chunked(data, compression='zstd', size=None):
    """Return a file that has one chunk of these bytes."""
    packed = {'zstd': zstandard.compress, 'lz4': lz4.frame.compress, '': bytes}[compression](data)
    builder = RecordBuilder()
    Header('ros2', 'x').write(builder)
    Chunk(compression, packed, 0, 0, 0, len(data) if size is None else size).write(builder)
    return builder.end()


def test_what_expands_beyond_measure_is_skipped_or_refused(tmp_path):
    """Before memory is asked for: chunks of 200 MB, 1 kB that are 5 MB, 15 kB that are 31 MB of messages."""
    path, part = tmp_path / 'bomb.mcap', chunked(bytes(200 << 20))
    path.write_bytes(MAGIC + part + 16 * part[HEAD:])
    memory, begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    assert read_log(path).problems[0].endswith('a chunk that expands to 209715200 bytes was skipped; expected at most '
                                               '33554432')
    part = chunked(bytes(1 << 18))
    path.write_bytes(MAGIC + part + 20 * part[HEAD:])
    with pytest.raises(InvalidData, match=r'bomb.mcap: expected a log that expands to at most 100 times its size, '
                                          r'found'):
        read_log(path)
    message = bytes([Opcode.MESSAGE]) + (22).to_bytes(8, 'little') + bytes(22)
    part = chunked(message * 100_000)
    path.write_bytes(MAGIC + part + 9 * part[HEAD:])
    with pytest.raises(InvalidData, match='expands to at most'):
        list(iter_log(path))
    assert time.process_time() - begin < 5 * MOST_SECONDS
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) < 100e6


def test_time_and_problems_are_bounded(make_cell, tmp_path, monkeypatch):
    """Each in words that name the log."""
    log = make_cell().write(tmp_path / 'log', chunk_size=400)
    path = log / 'log_0.mcap'
    data = path.read_bytes()
    part = chunked(b'', '', size=5)
    path.write_bytes(MAGIC + part + 500 * part[HEAD:])
    assert len(read_log(path).problems) == log_reader.MAX_PROBLEMS + 1
    assert read_log(path).problems[-1].endswith('has more problems')
    path.write_bytes(data)
    monkeypatch.setattr(log_reader, 'READ_WITHIN', -2.0)
    with pytest.raises(InvalidData, match='log_0.mcap: expected a log that is read within -1.* s, found a longer one'):
        read_log(log)


def test_a_log_may_be_as_long_as_a_run(make_cell, tmp_path, monkeypatch):
    """Only what it costs for each of its bytes is bounded: 12 messages a second are ten million in ten days."""
    log = make_cell().write(tmp_path / 'log')
    monkeypatch.setattr(log_reader, 'MAX_MESSAGES', 10, raising=False)
    monkeypatch.setattr(log_reader, 'READ_WITHIN', 0.0)
    monkeypatch.setattr(log_reader, 'PER_BYTE', 1e-3, raising=False)
    assert read_log(log).to_run().size == 16
    assert len(list(iter_log(log))) == read_log(log).messages


def deep(levels):
    """Return a schema whose one field holds messages that hold messages."""
    return ('\n' + '=' * 80 + '\n').join(
        ['p/T1[] a', *(f'MSG: p/T{level}\np/T{level + 1} a' for level in range(1, levels)),
         f'MSG: p/T{levels}\nuint8 x'])


@pytest.mark.parametrize(('levels', 'size', 'words'), [
    (300, 1 << 18, 'expected at most 12 types within it, found 300'),
    (12, 1 << 22, 'expected a message of at most 131072 bytes, found 4194304')])
def test_what_one_message_costs_is_bounded(levels, size, words):
    """Each byte of an array may be a message that holds messages: 4 MB took more than 120 s and 746 MB."""
    count = (size - 8).to_bytes(4, 'little')
    begin = time.process_time()
    with pytest.raises(InvalidData, match=words):
        message_decoder('p/msg/T0', deep(levels))(b'\0\1\0\0' + count + bytes(size - 8))
    assert time.process_time() - begin < MOST_SECONDS

# SPDX-License-Identifier: Apache-2.0
"""Damaged logs: flipped bytes, cuts, and damage aimed at lengths, checksums and kinds of records.

Each is refused in one line, or read with a problem that is reported; where nothing is reported, every number of the
run is that of the undamaged log, bit for bit. Time and memory are bounded.
"""

import resource
import time

import numpy as np
import pytest
from mcap.opcode import Opcode

from rosette_ros.core.errors import InvalidData
from rosette_ros.io.log_reader import iter_log, read_log

FLIPS, CUTS = 120, 60
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

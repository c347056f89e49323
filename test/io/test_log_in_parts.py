# SPDX-License-Identifier: Apache-2.0
"""Logs in several files, as other recorders write them, are one log; the index of a long log takes little memory."""

import tracemalloc

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from split_bag import split
from written_logs import HELLO, TEXT, Wall, again, files_of, serialised

from rosette_ros.io import bag_metadata, log_writer
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import LogWriter

PARTS = 11


@pytest.fixture
def parts(make_cell, tmp_path):
    """Return the messages of a cell, their log, and the same log in PARTS files."""
    cell = make_cell()
    return cell, cell.write(tmp_path / 'whole'), split(tmp_path / 'whole', tmp_path / 'log', PARTS)


def test_a_log_of_several_files_is_one_log(parts):
    """Everything once, in order, with the numbers of the log in one file."""
    cell, whole, log = parts
    with AnyReader([log]) as reader:
        read = [again(reader, data, connection.msgtype) for connection, _, data in reader.messages()]
    assert read == [serialised(cell, kind, message) for _, kind, message in cell.sent]
    found, wanted = read_log(log), read_log(whole)
    assert (found.problems, found.truncated, len(found.files)) == ((), False, PARTS)
    assert (found.messages, found.start_ns, found.end_ns) == (wanted.messages, wanted.start_ns, wanted.end_ns)
    assert {topic.name: topic.messages for topic in found.topics} == {
        topic.name: topic.messages for topic in wanted.topics}
    assert found.to_run().centre.tobytes() == wanted.to_run().centre.tobytes()


def test_without_metadata_the_files_are_read_by_their_numbers(parts):
    """The tenth after the ninth."""
    _, whole, log = parts
    (log / 'metadata.yaml').unlink()
    assert [one.data for one in iter_log(log)] == [one.data for one in iter_log(whole)]


@pytest.mark.parametrize('kept', [-60, 1000])
def test_a_last_file_without_an_end_costs_what_is_behind_it(parts, kept):
    """The files before it are whole."""
    _, whole, log = parts
    last = log / f'log_{PARTS - 1}.mcap'
    last.write_bytes(last.read_bytes()[:kept])
    found = read_log(log)
    assert found.truncated
    assert (found.messages == read_log(whole).messages) == (kept < 0)
    assert {problem.split(': ')[0] for problem in found.problems} == {str(last)}
    assert found.messages >= read_log(whole).messages * (PARTS - 1) // PARTS
    assert np.isfinite(found.to_run().centre).all()


def test_memory_of_an_index_is_bounded(tmp_path, monkeypatch):
    """One chunk a second of 13 topics: its index takes some 1400 bytes, and there are ever fewer."""
    monkeypatch.setattr('os.fsync', lambda _: None)
    monkeypatch.setattr(bag_metadata, 'write_bag_metadata', lambda *_: None)
    monkeypatch.setattr(log_writer, 'DOUBLING', 200)
    wall, seconds = Wall(), 1400
    with LogWriter(tmp_path / 'log', 'log', clock=wall) as log:
        topics = [f'/topic_{number}' for number in range(13)]
        for topic in topics:
            log.add_topic(topic, TEXT)
        tracemalloc.start()
        for second in range(seconds):
            wall.now = second
            for topic in topics:
                log.write(topic, HELLO, second, second)
        held, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    with open(files_of(log)[0], 'rb') as stream:
        statistics = make_reader(stream).get_summary().statistics
    assert statistics.message_count == 13 * seconds
    assert 550 < statistics.chunk_count < 650  # 200 of 1 s, 200 of 2 s, 200 of 4 s
    assert held / statistics.chunk_count * 40_000 < 60e6

# SPDX-License-Identifier: Apache-2.0
"""Logs in several files, as other recorders write them, are one log; the index of a long log takes little memory."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from split_bag import split
from written_logs import HELLO, TEXT, Wall, again, files_of, serialised

from rosette_ros.archive.run_adding import find_logs
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io import bag_metadata, log_writer
from rosette_ros.io.log_reader import iter_log, read_log, runs_in
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.words.reading_words import remark_words

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
    (log / 'log_0.mcap').unlink()  # of a rolling recording
    assert read_log(log).problems == ()
    (log / 'log_4.mcap').unlink()
    [damage] = map(remark_words, read_log(log).damage)
    assert damage == f'the log is damaged: {log}: log_4.mcap is missing; put it back'


@pytest.mark.parametrize('name', ['{}_run_2026', '{}', 'run_2026_11_28-04_{:02}_22', 'part {} of 11'])
def test_without_metadata_and_with_other_names_the_files_are_one_by_their_run(parts, name):
    """Numbered in front, alone or by the time: their order is that of their messages."""
    _, whole, log = parts
    (log / 'metadata.yaml').unlink()
    for number in range(PARTS):
        (log / f'log_{number}.mcap').rename(log / f'{name.format(number)}.mcap')
    assert [one.data for one in iter_log(log)] == [one.data for one in iter_log(whole)]
    found = read_log(log)
    assert (found.damage, len(found.files)) == ((), PARTS)
    assert found.to_run().centre.tobytes() == read_log(whole).to_run().centre.tobytes()


@pytest.mark.parametrize('name', [None, 'log_{}', '{}_run_2026', 'run_2026_11_28-04_{:02}_22'])
def test_the_parts_of_a_run_are_listed_as_one(parts, name):
    """By `rosette runs` and for an archive, described (None), numbered, or by their run; a table beside is another."""
    _, whole, log = parts
    if name:
        (log / 'metadata.yaml').unlink()
        for number in range(PARTS):
            (log / f'log_{number}.mcap').rename(log / f'{name.format(number)}.mcap')
    (table := log / 'beside.csv').touch()
    assert {*runs_in(log)} == {log, table}
    assert {*runs_in(log.parent)} == {log, whole}
    found = {one.path: len(one.files) for one in find_logs([str(log)])}
    assert found == {str(log): PARTS, str(table): 1}


def test_files_of_several_runs_and_copies_of_one_are_not_one_log(make_cell, tmp_path):
    """Which of them is meant is asked."""
    folder = tmp_path / 'folder'
    folder.mkdir()
    first, other = (make_cell(run_id=run_id).write(tmp_path / run_id) / 'log_0.mcap' for run_id in 'ab')
    (folder / 'b.mcap').write_bytes(other.read_bytes())
    for name in ('a.mcap', 'b copied.mcap'):
        (folder / name).write_bytes((first if name == 'a.mcap' else other).read_bytes())
        with pytest.raises(InvalidData, match='folder: expected a run, found a folder of 2: '):
            read_log(folder)
        assert len(runs_in(folder)) == len(find_logs([str(folder)])) == 2
        (folder / name).unlink()


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


def packed(log):
    """Compress the files of a log as rosbag2 does with compression_mode FILE."""
    for path in log.glob('*.mcap'):
        path.with_suffix('.mcap.zstd').write_bytes(zstandard.compress(path.read_bytes()))
        path.unlink()
    text = (log / 'metadata.yaml').read_text()
    (log / 'metadata.yaml').write_text(text.replace('.mcap\n', '.mcap.zstd\n'))


@pytest.mark.parametrize('described', [True, False])
def test_files_compressed_as_a_whole_name_the_command(parts, described):
    """And are read once they are unpacked beside."""
    _, whole, log = parts
    packed(log)
    (log / '._log_0.mcap.zstd').touch()
    if not described:
        (log / 'metadata.yaml').unlink()
    assert runs_in(log.parent) == sorted([log, whole], key=lambda path: -path.stat().st_mtime)
    for number in range(PARTS):
        with pytest.raises(InvalidData, match=r'zstd: is a compressed file; unpack it: zstd -d .*mcap.zstd -o .*mcap'
                           if number == PARTS - 1 else r'log: its files are compressed; unpack them: for f in \S*log/\*'
                           r'.mcap.zst\*; do zstd -d "\$f" -o "\${f%.\*}"; done'):
            read_log(log)
        assert [(one.path, len(one.files)) for one in find_logs([str(log)])] == [(str(log), PARTS)]
        one = log / f'log_{number}.mcap'
        one.write_bytes(zstandard.decompress(one.with_suffix('.mcap.zstd').read_bytes()))
    found = read_log(log)
    assert (found.problems, found.to_run().centre.tobytes()) == ((), read_log(whole).to_run().centre.tobytes())


def test_messages_compressed_one_by_one_are_read(make_cell, tmp_path):
    """As rosbag2 does with compression_mode MESSAGE."""
    class Packing(LogWriter):
        def write(self, topic, data, *times):
            super().write(topic, zstandard.compress(data), *times)

    cell = make_cell()
    found, wanted = (cell.write(tmp_path / name, writer=kind) for name, kind in (('a', Packing), ('b', LogWriter)))
    assert [one.data for one in iter_log(found)] == [one.data for one in iter_log(wanted)]
    assert read_log(found).to_run().centre.tobytes() == read_log(wanted).to_run().centre.tobytes()


def test_a_topic_without_a_definition_is_named(make_cell, tmp_path):
    """rosbag2 writes an empty one where the package is not installed."""
    cell = make_cell()
    define = cell.define
    cell.define = lambda kind: replace(define(kind), text='' if kind.endswith('BallCentre') else define(kind).text)
    with pytest.raises(InvalidData, match='topic /rosette/ball_centre: message 1: the log has no definition of '
                       'rosette_msgs/msg/BallCentre; record it where its package is installed'):
        read_log(cell.write(tmp_path / 'log'))

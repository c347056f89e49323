# SPDX-License-Identifier: Apache-2.0
"""Logs in several files: each can be read alone, together they hold everything once."""

import tracemalloc
from collections import Counter

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from written_logs import HELLO, TEXT, Wall, again, files_of, serialised, writer

from rosette_ros.io import bag_metadata, log_writer
from rosette_ros.io.bag_metadata import MAX_BYTES, read_bag_metadata
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import LogWriter


@pytest.mark.parametrize('options', [{'max_file_bytes': 4000, 'chunk_size': 500},
                                     {'max_file_seconds': 0.1}])
def test_split_log_is_one_log(make_cell, tmp_path, options):
    """Files are numbered; each is whole; together they hold everything once, in order."""
    cell = make_cell()
    cell.write(tmp_path / 'log', **options)
    names = tuple(path.name for path in read_bag_metadata(tmp_path / 'log' / 'metadata.yaml').files)
    assert len(names) > 2
    assert names == tuple(f'log_{number}.mcap' for number in range(len(names)))
    with AnyReader([tmp_path / 'log']) as reader:
        read = [again(reader, data, connection.msgtype)
                for connection, _, data in reader.messages()]
    assert read == [serialised(cell, kind, message) for _, kind, message in cell.sent]
    log = read_log(tmp_path / 'log')
    assert [answer.seq for answer in log.answers] == [message.seq for message in cell.answers()]
    assert not log.truncated


def mcap_messages(path):
    """Return (topic, sequence, log time, publish time, data) of a file in its order, by the mcap library."""
    with open(path, 'rb') as stream:
        return [(channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
                for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)]


def split_with_states(directory):
    """Write a log of four files, a new one every 10 s; return all that was written, in order, as LoggedMessage."""
    log = LogWriter(directory, 'log', max_file_seconds=10)
    log.add_topic('/text', TEXT)
    log.add_topic('/state', TEXT, state_of=lambda data: '')
    log.add_topic('/frames', TEXT, state_of=lambda data: data[8:9])
    written = []
    for second in range(40):
        rows = [('/text', b'text')]
        if second in (0, 3, 15):
            rows.append(('/state', b'%d' % second))
        if second in (1, 2, 12):
            rows.append(('/frames', (b'a', b'b', b'a')[(1, 2, 12).index(second)] + b'%d' % second))
        for topic, text in rows:
            data = b'\0\1\0\0' + (len(text) + 1).to_bytes(4, 'little') + text + b'\0'
            log.write(topic, data, second * 10**9, second * 10**9 + 5)
            written.append((topic, second * 10**9, second * 10**9 + 5, data))
    log.close()
    return log, written


def test_a_further_file_begins_with_what_holds(tmp_path):
    """The last message of each state, as it was, received when the file begins: it stands alone."""
    log, _ = split_with_states(tmp_path / 'log')
    heads = []
    for number, path in enumerate(files_of(log)):
        messages = mcap_messages(path)
        own = next(row for row, (_, _, log_time, publish_time, _) in enumerate(messages)
                   if publish_time == log_time + 5)
        assert {log_time for _, _, log_time, _, _ in messages[:own + 1]} == {number * 10 * 10**9}
        heads.append([(topic, sequence, publish_time, data[8:-1].decode())
                      for topic, sequence, _, publish_time, data in messages[:own]])
    second = 10**9
    assert heads == [
        [],
        [('/frames', 0, second + 5, 'a1'), ('/frames', 1, 2 * second + 5, 'b2'), ('/state', 1, 3 * second + 5, '3')],
        [('/frames', 1, 2 * second + 5, 'b2'), ('/frames', 2, 12 * second + 5, 'a12'),
         ('/state', 2, 15 * second + 5, '15')],
        [('/frames', 1, 2 * second + 5, 'b2'), ('/frames', 2, 12 * second + 5, 'a12'),
         ('/state', 2, 15 * second + 5, '15')]]


def test_whoever_reads_the_whole_log_counts_it_once(tmp_path):
    """Ours by the record that says what is repeated; others by topic and sequence; metadata.yaml says what stands."""
    log, written = split_with_states(tmp_path / 'log')
    assert [(one.topic, one.log_time, one.publish_time, one.data) for one in iter_log(tmp_path / 'log')] == written
    assert log.message_count == read_log(tmp_path / 'log').messages == len(written)
    topics = read_log(tmp_path / 'log').topics
    assert {topic.name: topic.messages for topic in topics} == Counter(row[0] for row in written)
    found = [(topic, sequence, data) for path in files_of(log) for topic, sequence, _, _, data in mcap_messages(path)]
    assert len(found) == len(written) + 9
    assert sorted({(topic, data) for topic, _, data in found}) == sorted({(row[0], row[3]) for row in written})
    assert len({(topic, sequence) for topic, sequence, _ in found}) == len(written)
    bag = yaml.safe_load((tmp_path / 'log' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert bag['message_count'] == len(found)
    assert [entry['message_count'] for entry in bag['files']] == [len(mcap_messages(path)) for path in files_of(log)]
    assert {entry['topic_metadata']['name']: entry['message_count']
            for entry in bag['topics_with_message_count']} == {'/text': 40, '/state': 3 + 3, '/frames': 3 + 6}
    with AnyReader([tmp_path / 'log']) as reader:
        assert reader.message_count == len(found) == len(list(reader.messages()))


def test_one_file_of_a_log_is_read_with_its_head(tmp_path):
    """Alone, what it repeats is all that is known; its own description tells of it alone."""
    log, written = split_with_states(tmp_path / 'log')
    alone = list(iter_log(files_of(log)[2]))
    assert [one.topic for one in alone[:3]] == ['/frames', '/frames', '/state']
    assert len(alone) == 3 + sum(20 <= row[1] / 1e9 < 30 for row in written)
    with open(files_of(log)[2], 'rb') as stream:
        own = [record for record in make_reader(stream).iter_metadata() if record.name == 'rosbag2'][-1]
    bag = yaml.safe_load(own.metadata['serialized_metadata'])
    assert bag['relative_file_paths'] == ['log_2.mcap']
    assert bag['message_count'] == len(alone)
    assert bag['starting_time']['nanoseconds_since_epoch'] == 20 * 10**9


def test_a_damaged_list_of_what_is_repeated_is_told(tmp_path):
    """Nothing is passed over then, and the log says why."""
    log, written = split_with_states(tmp_path / 'log')
    path = files_of(log)[1]
    data = path.read_bytes()
    place = data.index(b'0 1', data.index(bag_metadata.REPEATED_RECORD.encode()))
    path.write_bytes(data[:place] + b'x y' + data[place + 3:])
    read = read_log(tmp_path / 'log')
    assert read.messages == len(written) + 3
    assert read.problems == (f'{path}: a damaged metadata record was skipped',)


def test_states_are_bounded(tmp_path, monkeypatch):
    """Of endless new ones the latest are repeated."""
    monkeypatch.setattr(log_writer, 'MAX_STATES', 3)
    with LogWriter(tmp_path / 'log', 'log', max_file_seconds=1) as log:
        log.add_topic('/state', TEXT, state_of=bytes)
        for number in range(10):
            log.write('/state', b'\0\1\0\0\2\0\0\0%d\0' % number, number, number)
        log.write('/state', HELLO, 2 * 10**9, 2)
    assert [sequence for _, sequence, *_ in mcap_messages(files_of(log)[1])] == [7, 8, 9, 10]


def test_a_file_ends_after_so_many_chunks(tmp_path, monkeypatch):
    """Its index is held in memory; nothing is lost."""
    monkeypatch.setattr(log_writer, 'MAX_CHUNKS', 4)
    with writer(tmp_path / 'log', chunk_size=1) as log:
        for number in range(18):
            log.write('/text', HELLO, number, number)
    assert len(files_of(log)) > 3
    assert read_log(tmp_path / 'log').messages == 18
    for path in files_of(log):
        with open(path, 'rb') as stream:
            assert make_reader(stream).get_summary().statistics.chunk_count <= 5


def test_so_many_files_and_no_more(tmp_path, monkeypatch):
    """Whatever was asked for: metadata.yaml has to stay readable. The last file takes the rest."""
    monkeypatch.setattr(log_writer, 'MAX_FILES', 5)
    with writer(tmp_path / 'log', max_file_seconds=1) as log:
        for number in range(12):
            log.write('/text', HELLO, number * 10**9, number)
    assert [len(mcap_messages(path)) for path in files_of(log)] == [1, 1, 1, 1, 8]
    monkeypatch.undo()
    assert 500 * log_writer.MAX_FILES < MAX_BYTES  # a file takes some 230 bytes in metadata.yaml


def test_a_file_is_more_than_its_head(tmp_path):
    """Whatever size is asked for: a file holds at least as much again."""
    with writer(tmp_path / 'log', max_file_bytes=1) as log:
        for number in range(300):
            log.write('/text', HELLO, number, number)
    sizes = [len(mcap_messages(path)) for path in files_of(log)]
    assert sum(sizes) == 300
    assert min(sizes[1:-1]) > 20  # the first file began without topics


def test_memory_of_an_index_is_bounded(tmp_path, monkeypatch):
    """One chunk a second of 13 topics: its index takes some 1400 bytes, a whole file's less than 60 MB."""
    monkeypatch.setattr('os.fsync', lambda _: None)
    monkeypatch.setattr(bag_metadata, 'write_bag_metadata', lambda *_: None)
    wall, chunks = Wall(), 600
    with LogWriter(tmp_path / 'log', 'log', clock=wall) as log:
        topics = [f'/topic_{number}' for number in range(13)]
        for topic in topics:
            log.add_topic(topic, TEXT)
        tracemalloc.start()
        for second in range(chunks):
            wall.now = second
            for topic in topics:
                log.write(topic, HELLO, second, second)
        held, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    with open(files_of(log)[0], 'rb') as stream:
        assert make_reader(stream).get_summary().statistics.chunk_count >= chunks - 1
    assert held / chunks * log_writer.MAX_CHUNKS < 60e6


def test_a_file_gets_its_name_when_its_head_is_on_the_disk(tmp_path, monkeypatch):
    """Killed in between, no file is there that cannot be read, and none that metadata.yaml names is missing."""
    log = writer(tmp_path / 'log', max_file_seconds=1)
    log.write('/text', HELLO, 0, 0)

    class Killed(BaseException):
        pass

    def kill(*_):
        raise Killed

    monkeypatch.setattr('os.link', kill)
    with pytest.raises(Killed):
        log.write('/text', HELLO, 2 * 10**9, 2)
    assert sorted(path.name for path in (tmp_path / 'log').iterdir()) == [
        'log_0.mcap', 'log_1.mcap.part', 'metadata.yaml']
    read = read_log(tmp_path / 'log')
    assert (read.messages, read.problems) == (1, ())

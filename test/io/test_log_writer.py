# SPDX-License-Identifier: Apache-2.0
"""Logs as others read them: rosbags (which checks hashes and metadata.yaml), mcap-ros2-support."""

import resource
import signal
import subprocess
import sys
import time

import pytest
import yaml
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from written_logs import HELLO, TEXT, Wall, again, serialised, writer

from rosette_ros.core.run.errors import CellError, InvalidConfig, InvalidData
from rosette_ros.io import log_writer
from rosette_ros.io.bag_metadata import Qos, parse_qos, qos_text, read_bag_metadata
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_writer import LogWriter


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_rosbags_decodes_every_message_and_checks_hashes(make_cell, tmp_path, compression):
    """Every message comes back as it was serialised; metadata.yaml 9 and hashes are right."""
    cell = make_cell()
    cell.write(tmp_path / 'log', compression=compression, chunk_size=2000)
    with AnyReader([tmp_path / 'log']) as reader:
        read = [(connection.topic, again(reader, data, connection.msgtype))
                for connection, _, data in reader.messages()]
        assert reader.message_count == len(cell.sent)
    assert read == [(topic, serialised(cell, kind, message))
                    for topic, kind, message in cell.sent]


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_mcap_ros2_support_decodes_every_message(make_cell, tmp_path, compression):
    """Chunks carry checksums that the reader verifies; times are kept."""
    cell = make_cell()
    cell.write(tmp_path / 'log', compression=compression)
    with open(tmp_path / 'log' / 'log_0.mcap', 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == 'ros2'
        assert reader.get_summary().statistics.message_count == len(cell.sent)
        for (topic, _, sent), (_, channel, message, got) in zip(
                cell.sent, reader.iter_decoded_messages(), strict=True):
            assert channel.topic == topic
            assert message.publish_time == message.log_time - 1000
            if topic.endswith('ball_centre'):
                assert (got.seq, got.centre.x, got.run_id) == (sent.seq, sent.centre.x, 'first')


@pytest.mark.parametrize('compression', log_writer.COMPRESSIONS)
def test_chunks_are_small_indexed_and_have_checksums(make_cell, tmp_path, compression):
    """What rosbag2 needs to play in the order of time, and what shows damage."""
    make_cell().write(tmp_path / 'log', compression=compression, chunk_size=2000)
    with open(tmp_path / 'log' / 'log_0.mcap', 'rb') as stream:
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    indexes = [record for record in records if isinstance(record, ChunkIndex)]
    assert len(chunks) == len(indexes) > 3
    assert all(chunk.uncompressed_crc for chunk in chunks)
    assert {chunk.compression for chunk in chunks} == {'' if compression == 'none' else compression}
    assert max(chunk.uncompressed_size for chunk in chunks[1:]) < 2400  # the first has the schemas
    assert all(index.message_index_offsets for index in indexes)


def test_service_events_and_feedback_decode_in_rosbags(library, store, tmp_path):
    """rosbags takes the full names of a service's types from the channel in ros2idl."""
    definition = library.definition('std_srvs/srv/Trigger_Event')
    feedback = library.definition('rosette_msgs/action/Calibrate_FeedbackMessage')
    # Event: info (type 1, stamp 5 s 6 ns, gid, sequence 7), one request (its one byte), no answer.
    event = (b'\0\1\0\0' b'\1\0\0\0' b'\5\0\0\0' b'\6\0\0\0' + bytes(range(16)) + bytes(4)
             + b'\7' + bytes(7) + b'\1\0\0\0' b'\0\0\0\0' b'\0\0\0\0')
    state = store.serialize_cdr(
        store.types['rosette_msgs/msg/RunState'](
            header=store.types['std_msgs/msg/Header'](
                stamp=store.types['builtin_interfaces/msg/Time'](1, 2), frame_id=''),
            run_id='r', phase=3, order='row', done=4, total=9, text='', process=''),
        'rosette_msgs/msg/RunState')
    with LogWriter(tmp_path / 'log', 'log') as log:
        log.add_topic('/start/_service_event', definition)
        log.add_topic('/calibrate/_action/feedback', feedback)
        log.write('/start/_service_event', event, 1, 1)
        log.write('/calibrate/_action/feedback', b'\0\1\0\0' + bytes(16) + bytes(state[4:]), 2, 2)
    with AnyReader([tmp_path / 'log']) as reader:
        got = {connection.topic: reader.deserialize(data, connection.msgtype)
               for connection, _, data in reader.messages()}
    assert got['/start/_service_event'].info.sequence_number == 7
    assert bytes(got['/start/_service_event'].info.client_gid) == bytes(range(16))
    assert len(got['/start/_service_event'].request) == 1
    assert got['/calibrate/_action/feedback'].feedback.state.done == 4
    counts = {topic.name: topic.messages for topic in read_log(tmp_path / 'log').topics}
    assert counts == {'/start/_service_event': 1, '/calibrate/_action/feedback': 1}


def test_metadata_has_every_key_of_version_9(make_cell, tmp_path):
    """rosbag2 throws where one is missing; the file carries the same text."""
    cell = make_cell()
    cell.write(tmp_path / 'log', custom_data={'operator': 'x'})
    bag = yaml.safe_load((tmp_path / 'log' / 'metadata.yaml').read_text())
    bag = bag['rosbag2_bagfile_information']
    assert sorted(bag) == sorted([
        'version', 'storage_identifier', 'duration', 'starting_time', 'message_count',
        'topics_with_message_count', 'compression_format', 'compression_mode',
        'relative_file_paths', 'files', 'custom_data', 'ros_distro'])
    assert (bag['version'], bag['storage_identifier'], bag['ros_distro']) == (9, 'mcap', 'jazzy')
    assert bag['duration']['nanoseconds'] == 10**7 * (len(cell.sent) - 1)
    topic = bag['topics_with_message_count'][0]
    assert sorted(topic['topic_metadata']) == ['name', 'offered_qos_profiles',
                                               'serialization_format', 'type',
                                               'type_description_hash']
    assert sorted(topic['topic_metadata']['offered_qos_profiles'][0]) == sorted([
        'history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan', 'liveliness',
        'liveliness_lease_duration', 'avoid_ros_namespace_conventions'])
    with open(tmp_path / 'log' / 'log_0.mcap', 'rb') as stream:
        records = [record for record in make_reader(stream).iter_metadata()
                   if record.name == 'rosbag2']
    inside = yaml.safe_load(records[-1].metadata['serialized_metadata'])
    assert inside == bag
    assert len(records) == 2  # at opening and at closing, the last one counts


def test_qos_survives_as_text():
    """Infinite durations are rosbag2's numbers; what is no QoS gives none."""
    profile = Qos('keep_all', 0, 'best_effort', 'transient_local', deadline=1_500_000_000)
    assert parse_qos(qos_text([profile, Qos()])) == (profile, Qos())
    assert 'sec: 9223372036\n    nsec: 854775807' in qos_text([profile])
    assert parse_qos('') == parse_qos('history: 3') == parse_qos('[{') == ()


def test_nothing_is_overwritten(tmp_path):
    """A folder with a log is refused, and the log in it stays as it is."""
    writer(tmp_path / 'log').close()
    before = (tmp_path / 'log' / 'log_0.mcap').read_bytes()
    with pytest.raises(InvalidData, match='holds a log already .log_0.mcap.; nothing is overwr'):
        writer(tmp_path / 'log')
    assert (tmp_path / 'log' / 'log_0.mcap').read_bytes() == before


def test_misuse_is_refused_with_words(tmp_path):
    """Topics once, before their messages; nothing after closing; known compressions only."""
    log = writer(tmp_path / 'log')
    with pytest.raises(InvalidData, match='topic /text was added before'):
        log.add_topic('/text', TEXT)
    with pytest.raises(InvalidData, match='topic /other was not added to the log'):
        log.write('/other', HELLO, 0, 0)
    log.close()
    log.close()
    with pytest.raises(InvalidData, match='the log is closed'):
        log.write('/text', HELLO, 0, 0)
    with pytest.raises(InvalidConfig, match="expected one of none, lz4, zstd, found 'bz2'"):
        LogWriter(tmp_path / 'other', 'log', compression='bz2')
    (tmp_path / 'file').write_text('')
    with pytest.raises(InvalidData, match='expected a folder for the log, found'):
        LogWriter(tmp_path / 'file', 'log')


def test_after_a_second_everything_is_on_the_disk(tmp_path):
    """A quiet topic never fills a chunk: time finishes it, by a message or by the timer."""
    wall = Wall()
    log = writer(tmp_path / 'log', clock=wall)
    log.write('/text', HELLO, 1, 1)
    log.flush_if_due()
    assert readable(tmp_path / 'log') == 0
    wall.now = 1.0
    log.flush_if_due()
    assert readable(tmp_path / 'log') == 1
    assert log.message_count == 1
    wall.now = 1.5
    log.write('/text', HELLO, 2, 2)
    assert readable(tmp_path / 'log') == 1
    wall.now = 2.0
    log.write('/text', HELLO, 3, 3)
    assert readable(tmp_path / 'log') == 3
    described = tmp_path / 'log' / 'metadata.yaml'
    counts = [yaml.safe_load(described.read_text())['rosbag2_bagfile_information']['message_count']]
    log.close()
    counts.append(yaml.safe_load(described.read_text())['rosbag2_bagfile_information']['message_count'])
    assert counts == [0, 3]  # at the begin and at the end


def readable(directory):
    """Return how many messages an outside reader finds in the unfinished file."""
    count = 0
    with open(directory / 'log_0.mcap', 'rb') as stream:
        try:
            for _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
                count += 1
        except Exception as error:  # noqa: BLE001 (the file has no end yet)
            assert 'End' in type(error).__name__
    return count


SCRIPT = '''
import sys, time
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.type_definitions import TypeDefinition
log = LogWriter(sys.argv[1], 'log', flush_interval=0.2)
log.add_topic('/text', TypeDefinition('std_msgs/msg/String', 'string data\\n', 'RIHS01_0'))
number = 0
while True:
    text = str(number).encode() + b'\\0'
    try:
        log.write('/text', b'\\0\\1\\0\\0' + len(text).to_bytes(4, 'little') + text, number, number)
    except Exception as error:
        print(type(error).__name__, error, flush=True)
        break
    number += 1
    print(number, flush=True)
    time.sleep(float(sys.argv[2]))
'''


def test_killed_writer_loses_only_what_was_not_flushed(tmp_path):
    """SIGKILL in the middle: the log opens without repair; metadata.yaml is there."""
    child = subprocess.Popen([sys.executable, '-c', SCRIPT, str(tmp_path / 'log'), '0.01'],
                             stdout=subprocess.PIPE, text=True)
    written = []  # (number of messages, when it was told)
    while len(written) < 100:
        written.append((int(child.stdout.readline()), time.monotonic()))
    child.send_signal(signal.SIGKILL)
    child.communicate()
    killed = written[-1][1]
    log = read_log(tmp_path / 'log')
    safe = max((number for number, when in written if when < killed - 0.5), default=0)
    assert log.truncated
    assert log.messages >= safe > 0
    assert 'ends in the middle' in log.problems[0]
    assert [path.name for path in read_bag_metadata(tmp_path / 'log' / 'metadata.yaml').files] == ['log_0.mcap']


def test_full_disk_ends_with_words_and_a_readable_log(tmp_path):
    """When the system refuses to write more, what was flushed before stays readable."""
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    done = subprocess.run([sys.executable, '-Bc', SCRIPT, str(tmp_path / 'log'), '0.002'],
                          capture_output=True, text=True, preexec_fn=limit, timeout=300)
    last = done.stdout.splitlines()[-1]
    assert last.startswith('CellError'), done.stderr
    assert 'cannot write the log: File too large; what was recorded until the last flush' in last
    log = read_log(tmp_path / 'log')
    assert log.messages > 50
    assert len(log.problems) == 1  # it has no end; no chunk is damaged
    assert f'log_0.mcap, {(tmp_path / "log" / "log_0.mcap").stat().st_size} bytes' in last


def test_after_a_refusal_the_writer_stays_refused(tmp_path, monkeypatch):
    """No message is taken in silence once the disk has refused one."""
    log = writer(tmp_path / 'log')
    log.write('/text', HELLO, 1, 1)

    def refuse(_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('os.fsync', refuse)
    with pytest.raises(CellError, match='No space left on device.*Make room and start again'):
        log.flush()
    monkeypatch.undo()
    with pytest.raises(CellError, match='cannot write the log'):
        log.write('/text', HELLO, 2, 2)
    log.close()
    assert read_log(tmp_path / 'log').truncated

# SPDX-License-Identifier: Apache-2.0
"""Logs that are empty, cut, damaged, foreign: one clear error, or what is whole."""

import struct

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from split_bag import split

from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.message_decoder import message_decoder
from rosette_ros.io.open_run import open_run


def file_of(tmp_path, data):
    """Return the path of a file with these bytes."""
    path = tmp_path / 'some.mcap'
    path.write_bytes(data)
    return path


def mcap_of(tmp_path, profile='ros2', **chunk):
    """Return an MCAP file without messages, by the mcap library."""
    path = tmp_path / 'some.mcap'
    with open(path, 'wb') as stream:
        writer = Writer(stream)
        writer.start(profile=profile)
        writer.finish()
    return path


@pytest.mark.parametrize(('data', 'words'), [
    (b'', r'some.mcap: is empty; expected an MCAP log'),
    (b'hello world', r'some.mcap: is not an MCAP file: expected it to begin with .*MCAP0'),
    (b'\x89MCAP0\r\n', r'some.mcap: is not an MCAP file: expected .* and a header record'),
    (b'\x89MCAP0\r\n\x05' + bytes(8), r'some.mcap: is not an MCAP file: expected .* and a header record'),
    (b'\x89MCAP0\r\n\x0f\4' + bytes(11), r'expected a header record first, none came'),
])
def test_no_mcap_is_refused_with_words(tmp_path, data, words):
    """The error names the file and what it begins with."""
    with pytest.raises(InvalidData, match=words):
        read_log(file_of(tmp_path, data))


def test_other_profiles_are_refused_with_words(tmp_path):
    """They say that schemas mean something else."""
    with pytest.raises(InvalidData, match="some.mcap: profile: expected ros2, found 'ros1'"):
        read_log(mcap_of(tmp_path, 'ros1'))


def test_a_log_that_states_nothing_is_read_by_what_it_holds(make_cell, tmp_path):
    """An empty profile; an identifier of the storage that is empty, null or missing."""
    log = make_cell().write(tmp_path / 'log')
    whole, file, path = open_run(log), log / 'log_0.mcap', log / 'metadata.yaml'
    data = file.read_bytes()
    size = int.from_bytes(data[9:17], 'little')
    assert data[17:25] == b'\4\0\0\0ros2'
    file.write_bytes(data[:9] + (size - 4).to_bytes(8, 'little') + bytes(4) + data[25:])
    assert open_run(file).centre.tobytes() == whole.centre.tobytes()
    file.write_bytes(data)
    content = yaml.safe_load(path.read_text())
    bag = content['rosbag2_bagfile_information']
    for stated in ({'storage_identifier': ''}, {'storage_identifier': None}, {}):
        bag.pop('storage_identifier', None)
        bag.update(stated)
        path.write_text(yaml.safe_dump(content))
        assert open_run(log).centre.tobytes() == whole.centre.tobytes(), stated


def test_log_without_ball_centres_is_refused_with_words(make_cell, tmp_path):
    """An empty log, and one in which the CMM never answered; both can be looked into."""
    log = read_log(mcap_of(tmp_path))
    with pytest.raises(InvalidData, match=r'some.mcap: expected ball centres \(rosette_msgs/msg/'
                       r'BallCentre\), found none in 0 messages \(topics: none\)'):
        log.to_run()
    cell = make_cell()
    cell.sent = [entry for entry in cell.sent if 'ball_centre' not in entry[0]]
    with pytest.raises(InvalidData, match=r'found none in 22 messages \(topics: /rosette/probe_tar'):
        read_log(cell.write(tmp_path / 'log')).to_run()


def test_log_without_targets_is_refused_with_words(make_cell, tmp_path):
    """Number of balls, radius and phase are known from the targets only."""
    cell = make_cell()
    cell.sent = [entry for entry in cell.sent if 'probe_target' not in entry[0]]
    with pytest.raises(InvalidData, match='log: expected probe targets .rosette_msgs/msg/ProbeTarget., found none '
                                          'beside '
                       '21 ball centres; record both'):
        read_log(cell.write(tmp_path / 'log')).to_run()


def test_folders_that_are_no_log_are_refused_with_words(make_cell, tmp_path):
    """Nothing there; nothing in it; a file missing; a description that is none."""
    with pytest.raises(InvalidData, match='nowhere: expected a log directory or an .mcap file, found '
                       'nothing there'):
        read_log(tmp_path / 'nowhere')
    with pytest.raises(InvalidData, match='expected a log directory with .mcap files, found none'):
        read_log(tmp_path)
    log = split(make_cell().write(tmp_path / 'whole'), tmp_path / 'log', 3)
    (log / 'log_1.mcap').unlink()
    with pytest.raises(InvalidData, match='metadata.yaml: names log_1.mcap, which is missing; put '
                       'the file back'):
        read_log(log)
    (log / 'metadata.yaml').write_text('hello')
    with pytest.raises(InvalidData, match='metadata.yaml: expected a rosbag2 description'):
        read_log(log)
    (log / 'metadata.yaml').unlink()
    assert len(read_log(log).files) > 1


@pytest.mark.parametrize(('key', 'value', 'words'), [
    ('relative_file_paths', ['../other.mcap'], 'names other.mcap, which is missing; put the file back'),
    ('relative_file_paths', ['..'], r"relative_file_paths: expected names of files in the same folder, found \['..'\]"),
    ('relative_file_paths', [], 'relative_file_paths: expected names'),
    ('relative_file_paths', [3], 'relative_file_paths: expected names'),
    ('storage_identifier', 'sqlite3', "storage_identifier: expected mcap, found 'sqlite3'; convert"),
])
def test_foreign_descriptions_are_refused_with_words(make_cell, tmp_path, key, value, words):
    """No file outside the folder is opened because a description says so."""
    path = make_cell().write(tmp_path / 'log') / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    content['rosbag2_bagfile_information'][key] = value
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InvalidData, match=words):
        read_log(tmp_path / 'log')


def test_unknown_compression_is_refused_with_words(make_cell, write_with_mcap, tmp_path):
    """What is in such a chunk is unknown: it is not skipped in silence."""
    path = write_with_mcap(tmp_path / 'some.mcap', make_cell(), compression=CompressionType.LZ4)
    path.write_bytes(path.read_bytes().replace(b'\3\0\0\0lz4', b'\3\0\0\0bz2'))
    with pytest.raises(InvalidData, match="some.mcap: chunk 1: compression: expected none, lz4 or "
                       "zstd, found 'bz2'"):
        read_log(path)


def test_damaged_chunk_is_told_and_the_others_are_read(make_cell, write_with_mcap, tmp_path):
    """A bit that fell over is seen by the checksum; the run is incomplete, not wrong."""
    cell = make_cell()
    path = write_with_mcap(tmp_path / 'some.mcap', cell, compression=CompressionType.NONE,
                           chunk_size=3000)
    data = bytearray(path.read_bytes())
    data[data.rindex(b'first') + 60] ^= 1
    path.write_bytes(data)
    log = read_log(path)
    assert 'is damaged (its checksum is wrong): its messages are lost' in log.problems[0]
    assert 0 < len(log.answers) < len(cell.answers())
    assert not log.truncated


def test_big_endian_is_read_and_other_encodings_are_refused(make_cell, tmp_path):
    """The fourth answer says 00 02, a parameter list; 00 00 is plain CDR, big endian."""
    cell = make_cell()

    class Broken(LogWriter):
        def write(self, topic, data, *times):
            self.answers = getattr(self, 'answers', 0) + topic.endswith('ball_centre')
            if topic.endswith('ball_centre') and self.answers == 4:
                data = b'\0\2' + data[2:]
            super().write(topic, data, *times)

    cell.write(tmp_path / 'log', writer=Broken)
    with pytest.raises(InvalidData, match=r'log_0.mcap: topic /rosette/ball_centre: message 4: '
                       r'.*BallCentre: expected CDR \(00 00 or 00 01\), found 00 02'):
        read_log(tmp_path / 'log')
    decode = message_decoder('some_msgs/msg/Some', 'string name\nint32 count\nfloat64[] values')
    for order, head in (('<', b'\0\1'), ('>', b'\0\0')):
        body = struct.pack(f'{order}I3sxiI2d', 3, b'ab', -7, 2, 0.5, -1e300)
        found = decode(head + b'\0\0' + body)
        assert (found.name, found.count, list(found.values)) == ('ab', -7, [0.5, -1e300])


@pytest.mark.parametrize('folder', ['', './', 'oldname/', '/home/op/bags/oldname/', '../', 'C:\\bags\\old\\'])
def test_files_are_looked_for_beside_their_description(make_cell, tmp_path, folder):
    """Wherever they were when they were recorded."""
    make_cell().write(tmp_path / 'log')
    path = tmp_path / 'log' / 'metadata.yaml'
    bag = yaml.safe_load(path.read_text())
    inside = bag['rosbag2_bagfile_information']
    inside['relative_file_paths'] = [f'{folder}{name}' for name in inside['relative_file_paths']]
    for entry in inside.get('files', ()):
        entry['path'] = f'{folder}{entry["path"]}'
    path.write_text(yaml.safe_dump(bag))
    log = read_log(tmp_path / 'log')
    assert log.answers and not log.problems


def test_short_message_is_refused_with_words(make_cell, tmp_path):
    """A message that ends early has no value made up for it."""
    cell = make_cell()

    class Broken(LogWriter):
        def write(self, topic, data, *times):
            super().write(topic, data[:-20] if topic.endswith('ball_centre') else data, *times)

    cell.write(tmp_path / 'log', writer=Broken)
    with pytest.raises(InvalidData, match='message 1: .*BallCentre: ends early, after .* bytes'):
        read_log(tmp_path / 'log')


def test_schema_without_a_field_is_refused_with_words(make_cell, tmp_path):
    """The error says which field is missing and which there are."""
    cell = make_cell()
    define = cell.define

    def without(type_name):
        definition = define(type_name)
        text = definition.text.replace('float64 table_travel', 'float64 something')
        return definition.__class__(type_name, text, definition.hash)

    cell.define = without
    cell.write(tmp_path / 'log')
    with pytest.raises(InvalidData, match='expected the field table_travel, the log has header, '
                       'run_id, .*; it was written with another version of the message'):
        read_log(tmp_path / 'log')


@pytest.fixture
def log_bytes(make_cell, tmp_path):
    """Return the bytes of a log of several chunks."""
    cell = make_cell()
    cell.write(tmp_path / 'log', chunk_size=1500, compression='lz4')
    return (tmp_path / 'log' / 'log_0.mcap').read_bytes()


@settings(max_examples=40, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_truncated_log_gives_what_is_whole(log_bytes, tmp_path, data):
    """Cut anywhere: the messages of whole chunks, a word about it, never another error."""
    size = data.draw(st.integers(0, len(log_bytes) - 1))
    path = file_of(tmp_path, log_bytes[:size])
    try:
        log = read_log(path)
    except InvalidData as error:
        assert size < 60, error
        return
    if log.truncated:
        assert f'read {log.messages} messages of ' in log.problems[-1]
    try:
        assert log.to_run().size <= 16
    except InvalidData as error:
        assert 'expected' in str(error)


def test_unfinished_log_gives_all_its_whole_chunks(log_bytes, tmp_path):
    """Without summary and footer nothing is lost."""
    complete = read_log(file_of(tmp_path, log_bytes))
    end = log_bytes.rindex(b'\x0f\x04\0\0\0\0\0\0\0')  # the data-end record
    cut = read_log(file_of(tmp_path, log_bytes[:end]))
    assert cut.truncated
    assert cut.messages == complete.messages
    assert cut.to_run().centre.tobytes() == complete.to_run().centre.tobytes()


@settings(max_examples=80, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8))
def test_changed_bytes_never_end_in_another_error(log_bytes, tmp_path, changes):
    """Whatever is in the file: a Run or one clear error."""
    mutated = bytearray(log_bytes)
    for place, value in changes:
        mutated[int(place * (len(mutated) - 1))] = value
    path = file_of(tmp_path, bytes(mutated))
    try:
        read_log(path).to_run()
    except RosetteError as error:
        assert 'some.mcap' in str(error)

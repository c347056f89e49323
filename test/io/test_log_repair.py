# SPDX-License-Identifier: Apache-2.0
"""A log that was cut short becomes a whole one beside it; others read that one too."""

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from rosette_ros.core.errors import InvalidData
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.log_repair import repair_log


@pytest.fixture
def cut(make_cell, tmp_path):
    """Return a log that ends in the middle of a chunk, and what was whole in it."""
    directory = make_cell().write(tmp_path / 'log', chunk_size=1500)
    path = directory / 'log_0.mcap'
    path.write_bytes(path.read_bytes()[:-9000])
    return directory, read_log(directory)


def test_a_cut_log_becomes_whole_beside_the_old_one(cut, tmp_path):
    """Every message of the whole chunks, byte for byte; the old log is as it was."""
    directory, before = cut
    assert before.truncated
    old = {path.name: path.read_bytes() for path in directory.iterdir()}
    done = repair_log(directory)
    assert done.directory == tmp_path / 'log_repaired'
    after = read_log(done.directory)
    assert not after.truncated
    assert after.problems == ()
    assert after.messages == before.messages == done.messages > 0
    assert 'ends in the middle' in done.problems[0]
    assert {path.name: path.read_bytes() for path in directory.iterdir()} == old


def test_other_readers_open_the_repaired_log(cut):
    """rosbags checks metadata.yaml and type hashes; mcap finds the summary."""
    directory, before = cut
    done = repair_log(directory)
    with AnyReader([done.directory]) as reader:
        assert reader.message_count == before.messages
        for connection, _, data in reader.messages():
            assert reader.deserialize(data, connection.msgtype) is not None
    with open(next(done.directory.glob('*.mcap')), 'rb') as stream:
        assert make_reader(stream).get_summary().statistics.message_count == before.messages


def test_the_numbers_of_a_repaired_run_are_those_of_the_old_one(make_cell, tmp_path):
    """Without its end a log gives the same Run, to the last bit."""
    directory = make_cell().write(tmp_path / 'log', chunk_size=1500)
    path = directory / 'log_0.mcap'
    data = path.read_bytes()
    path.write_bytes(data[:data.rindex(b'\x0f\x04\0\0\0\0\0\0\0')])
    done = repair_log(path, tmp_path / 'new')
    old, new = read_log(path).to_run(), read_log(done.directory).to_run()
    assert old.centre.tobytes() == new.centre.tobytes()
    assert old.time.tobytes() == new.time.tobytes()
    assert old.repeatability == new.repeatability


def test_lost_metadata_is_written_anew(make_cell, tmp_path):
    """The folder has its files and no metadata.yaml."""
    directory = make_cell().write(tmp_path / 'log')
    (directory / 'metadata.yaml').unlink()
    done = repair_log(directory)
    assert done.problems == (f'{directory}: metadata.yaml is missing',)
    assert (done.directory / 'metadata.yaml').is_file()


def test_what_cannot_or_need_not_be_repaired_is_said(make_cell, tmp_path, cut):
    """A whole log, a second repair, the log's own folder: words, and nothing is written."""
    whole = make_cell().write(tmp_path / 'whole')
    with pytest.raises(InvalidData, match='is whole; there is nothing to repair'):
        repair_log(whole)
    assert not (tmp_path / 'whole_repaired').exists()
    directory, _ = cut
    repair_log(directory)
    with pytest.raises(InvalidData, match='holds a log already'):
        repair_log(directory)
    with pytest.raises(InvalidData, match='folder of the log itself'):
        repair_log(directory, directory)

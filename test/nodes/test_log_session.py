# SPDX-License-Identifier: Apache-2.0
"""What a session keeps for a log, what it writes, and what it does when the disk refuses."""

import pytest
from mcap.reader import make_reader

from rosette_ros.core.run.errors import CellError, InvalidData
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_reader import iter_log
from rosette_ros.io.type_definitions import TypeDefinition
from rosette_ros.nodes.log_session import LATCHED_KEPT, LogSession, Message, Retention

BYTE = TypeDefinition('std_msgs/msg/UInt8', 'uint8 data\n', 'RIHS01_' + '0' * 64)


def make_session(recent=2.0):
    session = LogSession(recent, lambda topic: [Qos()])
    session.add_topic('/run', BYTE, Retention.NONE)
    session.add_topic('/latched', BYTE, Retention.LATCHED)
    session.add_topic('/request', BYTE, Retention.RECENT)
    return session


def message(topic, value, received=0.0, time=1):
    return Message(topic, bytes((0, 1, 0, 0, value)), time, time, received)


def content(path):
    return [(entry.topic, entry.data[-1]) for entry in iter_log(path)]


def test_log_begins_with_what_holds_and_with_the_request(tmp_path):
    """Latched first, then the request; what belongs to no run is not in it."""
    session = make_session()
    session.take(message('/run', 1))
    session.take(message('/request', 2, received=0.0))
    session.take(message('/request', 3, received=9.0))
    session.take(message('/latched', 4))
    session.open(tmp_path / 'a', 'a', now=10.0, log_time=5)
    session.take(message('/run', 5, time=6))
    session.close()
    assert sorted(content(tmp_path / 'a')) == [('/latched', 4), ('/request', 3), ('/run', 5)]
    assert (session.messages, session.lost) == (3, 0)


def test_every_log_gets_the_latched_messages_and_no_request_twice(tmp_path):
    """The second log knows what was latched before the first."""
    session = make_session()
    session.take(message('/latched', 1))
    session.take(message('/request', 2))
    for name in 'ab':
        session.open(tmp_path / name, name, now=0.0, log_time=1)
        session.close()
    assert content(tmp_path / 'a') == [('/latched', 1), ('/request', 2)]
    assert content(tmp_path / 'b') == [('/latched', 1)]


def test_memory_is_bounded():
    """Latched messages are kept by number."""
    session = make_session()
    for value in range(200):
        session.take(message('/latched', value))
    assert len(session._latched['/latched']) == LATCHED_KEPT


def test_second_log_while_one_is_open_is_refused(tmp_path):
    """In words, and the open one goes on."""
    session = make_session()
    session.open(tmp_path / 'a', 'a', 0.0, 1)
    with pytest.raises(CellError, match='the log of run a is open; expected it closed first'):
        session.open(tmp_path / 'b', 'b', 0.0, 1)
    session.take(message('/run', 7))
    session.close()
    assert session.messages == 1


def test_existing_log_is_never_overwritten(tmp_path):
    """A run of the same name is refused, and the session stays closed."""
    session = make_session()
    session.open(tmp_path / 'a', 'a', 0.0, 1)
    session.close()
    with pytest.raises(InvalidData, match='holds a log already'):
        session.open(tmp_path / 'a', 'a', 0.0, 1)
    assert not session.is_open


def test_refusing_disk_is_kept_in_words_and_counted(tmp_path, monkeypatch):
    """The cell goes on; what could not be written counts as lost."""
    session = make_session()
    session.open(tmp_path / 'a', 'a', 0.0, 1)
    session.take(message('/run', 1))

    def refuse(*_):
        raise CellError('disk full')

    monkeypatch.setattr(session._writer, 'write', refuse)
    session.take(message('/run', 2))
    session.take(message('/run', 3))
    assert session.failure == 'disk full'
    assert session.lost == 2


def test_settings_hold_from_the_next_log_on(tmp_path):
    """They are read when a log is opened."""
    settings = {}
    session = LogSession(2.0, lambda topic: [Qos()], lambda: settings)
    session.add_topic('/run', BYTE, Retention.NONE)
    for name, compression in (('a', ''), ('b', 'lz4')):
        session.open(tmp_path / name, name, 0.0, 1)
        session.take(message('/run', 1))
        session.close()
        with open(tmp_path / name / f'{name}_0.mcap', 'rb') as stream:
            assert {index.compression for index in make_reader(stream).get_summary().chunk_indexes} == {compression}
        settings['compression'] = 'lz4'

# SPDX-License-Identifier: Apache-2.0
"""What the tape keeps for a log, what it writes, and what it does when the disk refuses."""

import pytest

from rosette_ros.core.errors import CellError, InvalidData
from rosette_ros.data.bag_metadata import Qos
from rosette_ros.data.log_files import iter_log
from rosette_ros.data.schemas import TypeDefinition
from rosette_ros.nodes.tape import LATCHED_KEPT, Memory, Message, Tape

BYTE = TypeDefinition('std_msgs/msg/UInt8', 'uint8 data\n', 'RIHS01_' + '0' * 64)


def make_tape(recent=2.0):
    tape = Tape(recent, lambda topic: [Qos()])
    tape.add_topic('/run', BYTE, Memory.NONE)
    tape.add_topic('/latched', BYTE, Memory.LATCHED)
    tape.add_topic('/request', BYTE, Memory.RECENT)
    return tape


def message(topic, value, heard=0.0, time=1):
    return Message(topic, bytes((0, 1, 0, 0, value)), time, time, heard)


def content(path):
    return [(entry.topic, entry.data[-1]) for entry in iter_log(path)]


def test_log_begins_with_what_holds_and_with_the_request(tmp_path):
    """Latched first, then the request; what belongs to no run is not in it."""
    tape = make_tape()
    tape.take(message('/run', 1))
    tape.take(message('/request', 2, heard=0.0))
    tape.take(message('/request', 3, heard=9.0))
    tape.take(message('/latched', 4))
    tape.open(tmp_path / 'a', 'a', now=10.0, log_time=5)
    tape.take(message('/run', 5, time=6))
    summary = tape.close()
    assert sorted(content(tmp_path / 'a')) == [('/latched', 4), ('/request', 3), ('/run', 5)]
    assert (summary.messages, summary.lost) == (3, 0)


def test_every_log_gets_the_latched_messages_and_no_request_twice(tmp_path):
    """The second log knows what was latched before the first."""
    tape = make_tape()
    tape.take(message('/latched', 1))
    tape.take(message('/request', 2))
    for name in 'ab':
        tape.open(tmp_path / name, name, now=0.0, log_time=1)
        tape.close()
    assert content(tmp_path / 'a') == [('/latched', 1), ('/request', 2)]
    assert content(tmp_path / 'b') == [('/latched', 1)]


def test_memory_is_bounded():
    """Latched messages are kept by number."""
    tape = make_tape()
    for value in range(200):
        tape.take(message('/latched', value))
    assert len(tape._latched['/latched']) == LATCHED_KEPT


def test_second_log_while_one_is_open_is_refused(tmp_path):
    """In words, and the open one goes on."""
    tape = make_tape()
    tape.open(tmp_path / 'a', 'a', 0.0, 1)
    with pytest.raises(CellError, match='the log of run a is open; wanted it closed first'):
        tape.open(tmp_path / 'b', 'b', 0.0, 1)
    tape.take(message('/run', 7))
    assert tape.close().messages == 1


def test_existing_log_is_never_overwritten(tmp_path):
    """A run of the same name is refused, and the tape stays closed."""
    tape = make_tape()
    tape.open(tmp_path / 'a', 'a', 0.0, 1)
    tape.close()
    with pytest.raises(InvalidData, match='holds a log already'):
        tape.open(tmp_path / 'a', 'a', 0.0, 1)
    assert not tape.is_open


def test_refusing_disk_is_kept_in_words_and_counted(tmp_path, monkeypatch):
    """The cell goes on; what could not be written counts as lost."""
    tape = make_tape()
    tape.open(tmp_path / 'a', 'a', 0.0, 1)
    tape.take(message('/run', 1))

    def refuse(*_):
        raise CellError('disk full')

    monkeypatch.setattr(tape._writer, 'write', refuse)
    tape.take(message('/run', 2))
    tape.take(message('/run', 3))
    assert tape.failure == 'disk full'
    assert tape.lost == 2


def test_losses_count_only_while_a_log_is_open(tmp_path):
    """What was lost before does not make a good log look bad."""
    tape = make_tape()
    tape.lose(5)
    tape.open(tmp_path / 'a', 'a', 0.0, 1)
    assert tape.lost == 0
    tape.lose(2)
    assert tape.close().lost == 2

# SPDX-License-Identifier: Apache-2.0
"""What tests of logs share: one topic, its message, a clock, and messages encoded once more."""

from rosette_ros.io.bag_metadata import Qos, files_in
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.type_definitions import TypeDefinition

TEXT = TypeDefinition('std_msgs/msg/String', 'string data\n',
                      'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18')
HELLO = b'\0\1\0\0\6\0\0\0hello\0'


class Wall:
    """A wall clock that the test turns."""

    now = 0.0

    def __call__(self):
        """Return the time in s."""
        return self.now


def writer(directory, name='log', **options):
    """Return a LogWriter with one topic."""
    log = LogWriter(directory, name, **options)
    log.add_topic('/text', TEXT, [Qos(depth=7)])
    return log


def files_of(log):
    """Return the files of a log in their order."""
    return files_in(log.directory)


def again(reader, data, kind):
    """Return a message decoded and encoded again by the types that the log carries."""
    return bytes(reader.typestore.serialize_cdr(reader.deserialize(data, kind), kind))


def serialised(cell, kind, message):
    """Return a message encoded by the types of the sources."""
    return bytes(cell.store.serialize_cdr(message, kind))

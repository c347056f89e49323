# SPDX-License-Identifier: Apache-2.0
"""Bags of several files."""

import shutil

from rosette_ros.io.bag_metadata import FileSummary, bag_mapping, write_bag_metadata
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.type_definitions import TypeDefinition


def split(log, directory, count):
    """Write a log again as one of several files, as ros2 bag splits them; return its directory."""
    directory.mkdir()
    messages, files, known = list(iter_log(log)), [], read_log(log)
    size = -(-len(messages) // count)
    for number in range(count):
        part = messages[number * size:(number + 1) * size]
        summary = FileSummary(f'log_{number}.mcap')
        with LogWriter(directory / 'part', 'log', custom_data=known.custom_data) as one:
            for channel in {message.topic: message.channel for message in part}.values():
                one.add_topic(channel.topic, TypeDefinition(channel.type_name, channel.schema_text, channel.type_hash),
                              channel.qos)
            for message in part:
                one.write(message.topic, message.data, message.log_time, message.publish_time)
                summary.count(message.log_time)
        (directory / 'part' / 'log_0.mcap').rename(directory / summary.path)
        shutil.rmtree(directory / 'part')
        files.append(summary)
    write_bag_metadata(directory, bag_mapping(known.topics, files, known.custom_data), True)
    return directory

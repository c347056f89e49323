# SPDX-License-Identifier: Apache-2.0
"""Every verb says what a damaged log lacks."""

import contextlib
from pathlib import Path

import pytest
from mcap.reader import make_reader

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.log_reader import iter_log
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.type_definitions import TypeDefinition

RECORDED = Path(__file__).parents[1] / 'golden' / 'logs' / 'log_clean_n6_diagonal'


@pytest.fixture
def damaged_log(tmp_path):
    """Return a recorded log that lost the chunk with its repeatability check, and the words of the problem."""
    log = tmp_path / 'log'
    with LogWriter(log, 'log', chunk_size=3000) as writer:
        for one in iter_log(RECORDED):
            channel = one.channel
            with contextlib.suppress(InvalidData):  # it was added before
                writer.add_topic(one.topic, TypeDefinition(one.type_name, channel.schema_text, channel.type_hash))
            writer.write(one.topic, one.data, one.log_time, one.publish_time)
    path = log / 'log_0.mcap'
    with open(path, 'rb') as stream:
        summary = make_reader(stream).get_summary()
    answers = next(key for key, channel in summary.channels.items() if channel.topic == '/rosette/ball_centre')
    chunk = next(one for one in summary.chunk_indexes if answers in one.message_index_offsets)
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length - 50] ^= 1
    path.write_bytes(data)
    return log, f'the log is damaged: {path}: chunk'


@pytest.mark.usefixtures('sketched')
def test_every_verb_tells_what_a_log_lacks(rosette, damaged_log, tmp_path):
    """In a line: in the verdict, or on stderr where the output has none; the run is complete, but U is another."""
    log, words = damaged_log
    for verb in (['evaluate'], ['compare'], ['diagnose'], ['evaluate', '--json']):
        answer = rosette(*verb[:1], log, *verb[1:])
        assert answer.code == 0
        assert words in ' '.join(answer.out.split()).replace('- ', '-')
        assert answer.err == ''
    for verb in (['advise'], ['evaluate', '--csv'], ['export', '-o', '-']):
        answer = rosette(*verb[:1], log, *verb[1:])
        assert answer.err.startswith(f'rosette: {words}')
        assert answer.err.count('\n') == 1
    assert rosette('report', log, '-o', tmp_path / 'report.html').code == 0
    assert words in (tmp_path / 'report.html').read_text()
    out = ' '.join(rosette('info', log).out.split())
    assert out.count('is damaged (') == 1

# SPDX-License-Identifier: Apache-2.0
"""The file that keeps that a person is wanted."""

from rosette_ros.dme.stop_mark import StopMark


def test_it_is_kept_until_it_is_cleared(tmp_path):
    """By the next process too, in one line."""
    path = tmp_path / 'dme.yaml'
    mark = StopMark(path)
    assert mark.read() == ''
    mark.write('error 2504: Collision')
    assert StopMark(path).read() == 'error 2504: Collision'
    assert (tmp_path / 'dme.yaml.stopped').read_text(encoding='utf-8') == 'error 2504: Collision\n'
    mark.clear()
    mark.clear()
    assert StopMark(path).read() == mark.complaint == ''


def test_files_that_are_not_as_written(tmp_path):
    """An empty or strange one stops, too; one that cannot be read does; one that cannot be written is told."""
    mark = StopMark(tmp_path / 'dme.yaml')
    mark.path.write_bytes(b'')
    assert mark.read() == 'stopped'
    mark.path.write_bytes(b'\xff\n\x00')
    assert mark.read()
    mark.path.unlink()
    mark.path.mkdir()
    assert 'cannot be read: Is a directory; a person has to look' in mark.read()
    mark.write('x')
    assert 'cannot be written: Is a directory; a restart of the cell would forget' in mark.complaint

# SPDX-License-Identifier: Apache-2.0
"""The file that keeps that a person is wanted."""

import asyncio
import os
from pathlib import Path

import pytest
from scripted_server import OK, error, prepared, run, settings_of, unsolicited

from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.stop_mark import StopMark


def test_it_is_kept_until_it_is_cleared(tmp_path, monkeypatch):
    """By the next process too, in one line, and by whatever name the settings are given."""
    monkeypatch.setenv('HOME', str(tmp_path))
    path = tmp_path / 'dme.yaml'
    mark = StopMark('~/dme.yaml')
    assert mark.read() == ''
    mark.write('error 2504: Collision')
    assert StopMark(path).read() == 'error 2504: Collision'
    (tmp_path / 'link.yaml').symlink_to(path)
    assert StopMark(tmp_path / 'link.yaml').read() == 'error 2504: Collision'
    assert (tmp_path / 'dme.yaml.stopped').read_text(encoding='utf-8') == 'error 2504: Collision\n'
    mark.clear()
    mark.clear()
    assert StopMark(path).read() == mark.complaint == ''


def test_the_disk_has_it_before_the_machine_moves(tmp_path, monkeypatch):
    """The file is whole under its name, file and folder are synchronised, also where it is removed."""
    synchronised = []
    fsync = os.fsync
    monkeypatch.setattr(os, 'fsync', lambda number: (synchronised.append(
        Path(f'/proc/self/fd/{number}').resolve().name), fsync(number)))
    mark = StopMark(tmp_path / 'dme.yaml')
    monkeypatch.setattr(Path, 'write_text', None)
    mark.write('moving')
    beside, folder = synchronised
    assert beside.endswith('.part') and folder == tmp_path.name
    mark.clear()
    assert synchronised[2:] == [tmp_path.name]


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


@pytest.mark.parametrize(('number', 'words'), [(514, 'error 0514'), (500, 'error 0500'), (None, '')])
def test_a_session_that_is_refused(tmp_path, number, words):
    """By a server in an error state: a person has to look. Nobody there: nothing has moved."""
    async def scene(server, cmm):
        await cmm.session.end()
        server.replies['StartSession'] = lambda tag, asked: error(tag, 3, number) if number else OK
        if not number:
            server.server.close()
        mark = StopMark(tmp_path / 'dme.yaml')
        with pytest.raises(CellError) as caught:
            await prepared(cmm.settings)
        mark.keep_refusal(caught.value)
        assert words in mark.read()
        assert bool(mark.read()) == bool(number)
    run(scene, settings_of(timeouts={'connect_s': 2.0}))


def test_how_a_session_came_to_rest(tmp_path):
    """What a person has to look at is kept; an error of a command is not."""
    async def scene(server, cmm):
        mark = StopMark(tmp_path / 'dme.yaml')
        mark.write('in the middle of a move')
        mark.settle(cmm.session)
        assert not mark.read()
        for number, kept in ((1006, ''), (2504, 'error 2504')):
            server.send(unsolicited(3, number))
            while f'error {number}' not in cmm.session.stop:
                await asyncio.sleep(0)
            mark.settle(cmm.session)
            assert bool(kept) == bool(mark.read())
            assert kept in mark.read()
    run(scene)

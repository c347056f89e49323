# SPDX-License-Identifier: Apache-2.0
"""Which log is meant by a name, and what is recalled of it."""

import dataclasses

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes.log_session import find_part, next_part, parts_of, recall


def test_a_run_means_its_last_part(tmp_path, monkeypatch):
    """By the run's name or a path in the recorder's folder; the next part is numbered on."""
    for name in ('run', 'run_part2', 'run_part3', 'other'):
        (tmp_path / name).mkdir()
    assert find_part(tmp_path, 'run') == tmp_path / 'run_part3'
    assert find_part(tmp_path, str(tmp_path / 'other')) == tmp_path / 'other'
    assert find_part(tmp_path, str(tmp_path / 'other/other_0.mcap')) == tmp_path / 'other'
    monkeypatch.setenv('HOME', str(tmp_path))
    assert find_part(tmp_path, '~/other') == tmp_path / 'other'
    assert [path.name for path in parts_of(tmp_path, 'run')] == ['run', 'run_part2', 'run_part3']
    assert next_part(tmp_path, 'run').name == 'run_part4'
    assert next_part(tmp_path, 'other').name == 'other_part2'


@pytest.mark.parametrize(('name', 'words'), [
    ('run_part2', 'run_part2 was continued already; resume run_part3'),
    ('nothing', "found none named 'nothing'"), ('run_part9', "found none named 'run_part9'"),
    ('/elsewhere/run', "found '/elsewhere/run'; copy it there"), ('../run', "found '../run'; copy it there")])
def test_what_is_no_log_to_go_on_from_is_refused(tmp_path, name, words):
    """In words; nothing outside the recorder's folder is read."""
    for part in ('run', 'run_part2', 'run_part3'):
        (tmp_path / part).mkdir()
    with pytest.raises(InvalidData) as error:
        find_part(tmp_path, name)
    assert words in str(error.value)


def test_a_log_of_other_messages_is_not_gone_on_with(tmp_path, monkeypatch):
    """Its bytes mean something else; it can still be evaluated."""
    import os

    from rosette_ros.core.run.records import Run
    from rosette_ros.io.run_to_log import write_log

    library = TypeLibrary.from_environment(os.environ)
    run = Run(3, 0.1, [1, 1, 1], [1, 2, 3], np.zeros((3, 3)))
    write_log(run.replace(run_id='a'), tmp_path / 'a', library)
    response = recall(tmp_path / 'a', library)
    assert (response.run_id, len(response.targets), len(response.answers)) == ('a', 3, 3)

    class Younger:
        def definition(self, name):
            return dataclasses.replace(library.definition(name), hash='RIHS01_' + 64 * '0')

    with pytest.raises(InvalidData, match='was written with another version of rosette_msgs/msg/ProbeTarget'):
        recall(tmp_path / 'a', Younger())

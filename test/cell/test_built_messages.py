# SPDX-License-Identifier: Apache-2.0
"""A clone whose messages have changed since they were built says so before it starts a node."""

import shutil

import pytest

from rosette_ros.cell.supervisor import DEFINITIONS, Cell, check_messages
from rosette_ros.core.run.errors import CellError


@pytest.fixture
def trees(tmp_path):
    """Return the definitions of a source tree and the environment of a build of them."""
    definitions, share = tmp_path / 'msg_defs', tmp_path / 'prefix' / 'share' / 'rosette_msgs'
    shutil.copytree(DEFINITIONS, definitions)
    shutil.copytree(DEFINITIONS, share)
    return definitions, {'AMENT_PREFIX_PATH': f'{tmp_path / "other"}:{tmp_path / "prefix"}'}


def test_the_build_of_these_definitions_is_fine(trees):
    check_messages(*trees)


def test_a_changed_definition(trees):
    definitions, environment = trees
    (definitions / 'action' / 'Calibrate.action').write_text('bool changed\n---\n---\n')
    with pytest.raises(CellError, match=r'expected rosette_msgs as .*/msg_defs defines it, found a build in .*'
                                        r'rosette_msgs in which Calibrate.action differs: run make setup'):
        check_messages(definitions, environment)


def test_a_new_definition(trees):
    definitions, environment = trees
    (definitions / 'msg' / 'Further.msg').write_text('bool further\n')
    with pytest.raises(CellError, match=r'Further.msg is missing: run make setup'):
        check_messages(definitions, environment)


@pytest.mark.parametrize('paths', ['', '/nowhere'])
def test_without_a_build_or_a_source_tree_there_is_nothing_to_compare(trees, tmp_path, paths):
    check_messages(trees[0], {'AMENT_PREFIX_PATH': paths})
    check_messages(tmp_path / 'none', trees[1])


def test_a_cell_starts_no_node_then(trees, tmp_path, monkeypatch):
    (trees[0] / 'srv' / 'CheckPlan.srv').write_text('---\n')
    monkeypatch.setattr('rosette_ros.cell.supervisor.check_messages', lambda: check_messages(*trees))
    cell = Cell(output_dir=tmp_path / 'output')
    with pytest.raises(CellError, match='CheckPlan.srv differs'):
        cell.start()
    assert not cell.processes

# SPDX-License-Identifier: Apache-2.0
"""Nodes that are started with wrong parameters say so in one line and end."""

import subprocess
import sys

import pytest
import yaml

from rosette_ros.cell.supervisor import cell_environment
from rosette_ros.nodes import names

pytestmark = pytest.mark.long


@pytest.mark.parametrize(('module', 'args', 'words'), [
    ('sequencer', ['-p', 'plate.balls:=2'],
     'sequencer: node sequencer: parameter: plate.balls: expected a whole number in 3 .. 1000'),
    ('simulated_cmm', ['-p', 'machine:=/nowhere/machine.yaml'], '/nowhere/machine.yaml'),
    ('recorder', ['-p', 'logdir:=x'], "found 'logdir'; did you mean 'log_dir'?"),
    ('recorder', ['--params-file', '/nowhere.yaml'], '/nowhere.yaml'),
])
def test_wrong_start_is_one_line_and_exit_code_2(domain_id, module, args, words):
    """The node's own line is the last one; rcl may have said something before."""
    done = subprocess.run(
        [sys.executable, '-m', f'rosette_ros.nodes.{module}', '--ros-args', *args],
        env=cell_environment(domain_id), capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2, done.stderr
    own = [line for line in done.stderr.splitlines() if line.startswith(module.removeprefix('simulated_'))]
    assert len(own) == 1, done.stderr
    assert words in own[0]
    assert 'Traceback' not in done.stderr


@pytest.mark.parametrize(('section', 'words'), [
    ('sequencer', "section 'sequencer': expected the name of a node in the namespace /rosette, found one that belongs "
                  "to "
                  'none; did you mean /**/sequencer?'),
    ('/**/sequenser', 'did you mean /**/sequencer?'),
    ('/cell2/evaluator', 'did you mean /**/evaluator?'),
    ('/**/simulated_cmm', 'did you mean /**/cmm?'),
    ('rosette/recorder', None), ('/**/recorder', None), ('/*/recorder', None), ('/**', None),
])
def test_a_section_of_a_parameter_file_that_matches_no_node_is_refused(domain_id, tmp_path, section, words):
    """It was ignored, and 144 balls were measured instead of 36."""
    path = tmp_path / 'cell.yaml'
    path.write_text(yaml.safe_dump({section: {'ros__parameters': {'use_sim_time': False}}}))
    command = [sys.executable, '-m', 'rosette_ros.nodes.recorder', '--ros-args', '-r', '__ns:=/rosette',
               '--params-file', str(path)]
    with subprocess.Popen(command, env={**cell_environment(domain_id), names.PARENT_PID: '1'},  # ends at once
                          cwd=tmp_path, stderr=subprocess.PIPE, text=True) as node:
        said = node.communicate(timeout=300)[1]
    assert node.returncode == (2 if words else 0), said
    assert said.strip().splitlines()[-1].startswith(f'recorder: {path}: section') == bool(words)
    assert words is None or words in said

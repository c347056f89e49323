# SPDX-License-Identifier: Apache-2.0
"""rosette demo --hidden: the story, and the envelope beside the answer."""

import re

import pytest
import yaml

from rosette_ros.cli.hidden_demo import answer, story_of, visible_strengths
from rosette_ros.core.diagnosis import Candidate
from rosette_ros.core.scheme import plan
from rosette_ros.data.log_reader import read_log
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.machine.envelope import open_envelope

SEED = 3
BALLS = 6


@pytest.fixture(scope='module')
def told(tmp_path_factory, module_domain_id):
    """Run the demo once; return what it printed and the folder of its log."""
    runs = tmp_path_factory.mktemp('hidden') / 'runs'
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr('rosette_ros.cli.demo.console', lambda file=None: _Listener(lines))
        code = main_of('demo', '--hidden', SEED, '--balls', BALLS, '-o', runs, '--domain',
                       module_domain_id)
    assert code == 0
    log, = runs.iterdir()
    return '\n'.join(lines), log

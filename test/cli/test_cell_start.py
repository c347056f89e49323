# SPDX-License-Identifier: Apache-2.0
"""What a cell says at its start."""

import io

import pytest
from rich.console import Console

from rosette_ros.cli.cell import keep_running
from rosette_ros.words.calibration_words import with_advice


class EndedAtOnce:
    """A cell that is ended as soon as it runs."""

    namespace, processes, log_dir = 'rosette', {'cmm': None}, 'runs'

    def __init__(self, domain_id):
        self.domain_id = domain_id

    def news(self):
        return ['sequencer: the cell is complete', 'cmm: error 2504: a person has to look at the machine']

    def restart_failed(self, hanging):
        assert not hanging
        raise KeyboardInterrupt


@pytest.mark.parametrize(('is_measured', 'log', 'words'), [
    (True, '/data/run', 'the disk is full; what was measured is in /data/run; continue with: rosette calibrate '
                        '--resume /data/run --domain 7'),
    (True, '', 'the disk is full; what was measured is in no log'),
    (False, '', 'the disk is full; nothing was measured')])
def test_where_what_was_measured_is(is_measured, log, words):
    """A log that was deleted is not named, nor advised to be resumed."""
    assert with_advice('the disk is full', log, is_measured, ('--domain', '7')) == words


def test_what_nodes_warn_of_at_the_start_is_shown(domain_id):
    """A machine that waits for a person, a server that is not there: not only after the first run."""
    out = Console(file=io.StringIO(), width=120)
    keep_running(out, EndedAtOnce(domain_id))
    said = out.file.getvalue()
    assert 'cmm: error 2504: a person has to look at the machine\n' in said
    assert 'sequencer' not in said


def test_with_sros2_no_node_is_taken_to_hang(monkeypatch):
    """The command has no enclave and hears nobody, so it does not join the graph: here it could not."""
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    out = Console(file=io.StringIO(), width=120)
    keep_running(out, EndedAtOnce('none'))
    assert 'The cell is running' in out.file.getvalue()


@pytest.mark.parametrize(('domain_id', 'environment', 'command'), [
    (0, '', 'rosette calibrate'), (0, '5', 'calibrate --domain 0'), (None, '5', 'calibrate --domain 5')])
def test_the_command_for_another_terminal_finds_the_cell(monkeypatch, domain_id, environment, command):
    """Domain 0 is that of a command only where the environment names none."""
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_DOMAIN_ID', environment)
    out = Console(file=io.StringIO(), width=120)
    keep_running(out, EndedAtOnce(domain_id))
    assert f'{command}\nCtrl-C' in out.file.getvalue()

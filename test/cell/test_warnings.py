# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a cell warn of reaches its screen and the client."""

from rosette_ros.cell.client import CellClient

LATE = {'kind': 'silent', 'at': [5]}


def test_an_answer_that_is_missing_is_told_on_both_screens(cell_of, domain_id, wait_until):
    """The fifth target has no answer at first: the sequencer warns and asks again."""
    warned = []
    with cell_of(3, groups={'faults': [LATE]}) as cell, CellClient(domain_id) as client:
        cell.news()
        outcome = client.calibrate(options='limits.answer_timeout_s: 0.5', on_warning=warned.append)
        assert outcome.success
        words = (f'sequencer: run {outcome.run_id}: target 5 (table position 2, ball 1), attempt 1: no answer within '
                 '0.5 s; asking again')
        wait_until(lambda: words in warned)
        told = []
        wait_until(lambda: told.extend(cell.news()) or any(': done: ' in line for line in told))
        assert words in told
        assert any(line.startswith(f'sequencer: run {outcome.run_id}: ') and line.endswith(' balls') for line in told)
        cell.processes['cmm'].popen.kill()
        wait_until(lambda: told.extend(cell.news()) or any('no CMM: expected one that' in line for line in told))

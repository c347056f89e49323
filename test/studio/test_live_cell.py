# SPDX-License-Identifier: Apache-2.0
"""The page connected to a running cell over DDS: start, progress, done, open the log; cancel; no cell."""

import pytest
import yaml
from playwright.sync_api import expect

BALLS = 6
SILENT = {'kind': 'silent', 'at': [20], 'always': True}
"""A target without an answer: the calibration is still running when it is cancelled."""


@pytest.fixture(scope='module')
def cell(make_cell, module_domain_id, tmp_path_factory):
    """Yield a running cell for the tests of this file."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), BALLS) as running:
        yield running


def connect(page, studio, domain):
    """Open the tab of the cell and connect to a domain."""
    page.goto(studio.address)
    page.get_by_test_id('tab-live').click()
    page.get_by_test_id('domain').fill(str(domain))
    page.get_by_test_id('connect').click()


def test_calibrate_and_cancel_from_the_page(cell, module_domain_id, studio, page):
    """Health of all nodes, start, curves, done; the log opens; the next one is cancelled and ends in order."""
    connect(page, studio, module_domain_id)
    for node in ('sequencer', 'cmm', 'evaluator', 'recorder'):
        expect(page.get_by_test_id('health-table')).to_contain_text(f'{node}: healthy')
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('phase')).to_contain_text('done')
    expect(page.get_by_test_id('live-words')).to_contain_text('Result of run')
    expect(page.get_by_test_id('outcome')).to_contain_text('The model fits')
    expect(page.get_by_test_id('fault-list')).to_have_text('None.')
    page.get_by_test_id('open-log').click()
    expect(page.get_by_test_id('tab-run')).to_have_attribute('aria-selected', 'true')
    expect(page.get_by_test_id('run')).not_to_have_value('drifting.csv')

    machine = yaml.safe_load(cell.machine.read_text())
    cell.machine.write_text(yaml.safe_dump({**machine, 'faults': [SILENT]}))
    page.get_by_test_id('tab-live').click()
    page.get_by_test_id('start').click()
    page.get_by_test_id('cancel').click()
    expect(page.get_by_test_id('outcome')).to_contain_text('cancelled')
    expect(page.get_by_test_id('fault-list')).to_contain_text('cancelled')
    expect(page.get_by_test_id('start')).to_be_enabled()
    cell.check()


def test_a_domain_without_a_cell(studio, domain_id, page):
    """A calibration is refused in the words of the command line."""
    connect(page, studio, domain_id)
    expect(page.get_by_test_id('health-table')).to_contain_text('No node of this cell has reported yet')
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('outcome')).to_contain_text('wanted a sequencer within 10 s, got none')

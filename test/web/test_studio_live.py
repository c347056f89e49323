# SPDX-License-Identifier: Apache-2.0
"""The page beside a running cell over DDS: start, progress, done, open the log; cancel; a cell that is not there."""

from contextlib import ExitStack

import pytest
from playwright.sync_api import expect

N = 4
SLOW = 12


@pytest.fixture
def studio_of(start_studio, tmp_path):
    """Yield a function that starts a studio for a domain; it ends after the page is closed."""
    (tmp_path / 'studio').mkdir()
    with ExitStack() as stack:
        yield lambda domain: stack.enter_context(start_studio(tmp_path / 'studio', '--domain', domain))


def connect(page, studio):
    """Open the tab of the cell and listen to it."""
    page.goto(studio.address)
    page.get_by_test_id('open-close').click()
    page.get_by_test_id('tab-live').click()
    page.get_by_test_id('connect').click()


def test_calibrate_from_the_page(cell_of, studio_of, domain_id, page):
    """Health of all four nodes, start, curves, done, and the log opens with a verdict."""
    with cell_of(N):
        connect(page, studio_of(domain_id))
        for node in ('sequencer', 'cmm', 'evaluator', 'recorder'):
            expect(page.get_by_test_id('health-table')).to_contain_text(f'{node}: healthy')
        page.get_by_test_id('start').click()
        expect(page.get_by_test_id('outcome')).to_contain_text('Done')
        expect(page.get_by_test_id('phase')).to_contain_text('done')
        expect(page.get_by_test_id('live-words')).to_contain_text('result of the evaluator')
        expect(page.get_by_test_id('fault-list')).to_have_text('None.')
        page.get_by_test_id('open-log').click()
        expect(page.get_by_test_id('run')).not_to_have_value('')
        expect(page.get_by_test_id('rms-fit')).not_to_have_text('–')


def test_cancel_from_the_page(cell_of, studio_of, domain_id, page):
    """A calibration that takes its time is cancelled; it ends in order and says so."""
    with cell_of(SLOW) as cell:
        connect(page, studio_of(domain_id))
        expect(page.get_by_test_id('health-table')).to_contain_text('sequencer: healthy')
        page.get_by_test_id('start').click()
        page.get_by_test_id('cancel').click()
        expect(page.get_by_test_id('outcome')).to_contain_text('cancelled')
        expect(page.get_by_test_id('fault-list')).to_contain_text('cancelled')
        expect(page.get_by_test_id('start')).to_be_enabled()
        cell.check()


def test_no_cell_is_told(studio_of, domain_id, page):
    """Whoever starts a calibration where there is no cell reads what the command line says."""
    connect(page, studio_of(domain_id))
    expect(page.get_by_test_id('health-table')).to_contain_text('No node of this cell was heard yet')
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('outcome')).to_contain_text('wanted a sequencer within 10 s, got none')

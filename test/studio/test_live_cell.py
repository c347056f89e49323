# SPDX-License-Identifier: Apache-2.0
"""The page connected to a running cell over DDS: start, progress, done, open the log; cancel; no cell."""

import contextlib
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
import yaml
from playwright.sync_api import expect

from rosette_ros.core.run.errors import CellError
from rosette_ros.studio.panels.live_panel import CellWatchers

pytestmark = pytest.mark.long

BALLS = 6
FAULTS = [{'kind': 'failed', 'at': [5]}, {'kind': 'silent', 'at': [20], 'always': True}]
"""A ball that cannot be measured at once, and a target without an answer: the calibration still runs when it is
cancelled."""


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


def points(figure, name):
    """Return how many marks of a name a figure draws."""
    return figure.evaluate('(made, name) => made.data.flatMap(one => one.name === name && one.text || []).length', name)


def test_calibrate_and_cancel_from_the_page(cell, module_domain_id, studio, page, wait_until):
    """Health of all nodes, start, curves, done; the log opens; the next one warns, is cancelled and ends in order."""
    connect(page, studio, module_domain_id)
    for node in ('sequencer', 'cmm', 'evaluator', 'recorder'):
        expect(page.get_by_test_id('health-table')).to_contain_text(f'{node}: healthy')
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('phase')).to_contain_text('done')
    expect(page.get_by_test_id('live-words')).to_contain_text('Result of run')
    expect(page.get_by_test_id('outcome')).to_contain_text('The model fits')
    curves = page.get_by_test_id('live-figure').locator('.scatterlayer .trace')
    expect(curves).not_to_have_count(0)
    expect(page.get_by_test_id('fault-list')).not_to_contain_text('error')  # a slow recorder is a warning
    page.get_by_test_id('open-log').click()
    expect(page.get_by_test_id('tab-run')).to_have_attribute('aria-selected', 'true')
    expect(page.get_by_test_id('run')).not_to_have_value('drifting.csv')

    machine = yaml.safe_load(cell.machine.read_text())
    cell.machine.write_text(yaml.safe_dump({**machine, 'faults': FAULTS}))
    page.get_by_test_id('tab-live').click()
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('live-words')).not_to_contain_text('Result of run')
    expect(page.get_by_test_id('live-words')).to_contain_text('too few ball centres')
    expect(curves).to_have_count(0)
    expect(page.get_by_test_id('progress-text')).to_contain_text('of 52 ball centres. Run')
    view = page.get_by_test_id('plan-view-figure')
    expect(view).to_contain_text('table position')
    assert points(view, 'current target') == 2  # its ball, and its reading
    wait_until(lambda: points(view, 'measured'))
    assert points(view, 'measured') <= BALLS + 20
    expect(page.get_by_test_id('fault-list')).to_contain_text('asking again')
    page.get_by_test_id('cancel').click()
    expect(page.get_by_test_id('outcome')).to_contain_text('cancelled')
    expect(page.get_by_test_id('start')).to_be_enabled()
    expect(curves).to_have_count(0)
    expect(page.get_by_test_id('fault-list')).not_to_contain_text('cancelled')
    cell.check()


def test_pages_that_connect_at_once_share_a_watcher(monkeypatch):
    """Only one is made, and it is closed."""
    made, closed, both = [], [], threading.Barrier(2)

    class Watcher:
        def __init__(self, *cell):
            made.append(cell)
            with contextlib.suppress(threading.BrokenBarrierError):
                both.wait(0.5)

        def close(self):
            closed.append(self)

    monkeypatch.setitem(sys.modules, 'rosette_ros.studio.cell_watcher', SimpleNamespace(CellWatcher=Watcher))
    cells = CellWatchers()
    with ThreadPoolExecutor(2) as threads:
        one, other = threads.map(cells.watch, (3, 3), ('rosette', 'rosette'))
    cells.close()
    assert (one is other, made, closed) == (True, [(3, 'rosette')], [one])


def test_a_domain_without_a_cell(studio, domain_id, page):
    """Nothing can be started, and the page says why; a domain that DDS has no ports for would end the process."""
    connect(page, studio, 233)
    expect(page.get_by_text('expected a whole number from 0 to 232')).to_be_visible()
    assert studio.process.poll() is None
    with pytest.raises(CellError, match='ROS domain: expected a whole number from 0 to 232, found 233'):
        CellWatchers().watch(233, 'rosette')
    page.get_by_test_id('domain').fill(str(domain_id))
    page.get_by_test_id('connect').click()
    expect(page.get_by_test_id('health-table')).to_contain_text('No node of this cell has reported yet')
    expect(page.get_by_test_id('start')).to_be_disabled()
    expect(page.get_by_test_id('start-hint')).to_contain_text('The sequencer has not reported yet')

# SPDX-License-Identifier: Apache-2.0
"""Makes the images of the studio in docs/results.md: the page in a real browser, beside a simulated cell.

python tools/studio_pictures.py [FOLDER]; the browser is the one that tools/browser.sh names.
"""

import os
import re
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

from rosette_ros.cell.supervisor import Cell
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

ROOT = Path(__file__).parents[1]
FLAGS = ('--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
         '--disable-component-update', '--disable-sync')
DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [1.0, 0.0, 0.5]}
DESKTOP = {'width': 1280, 'height': 800}
DOMAIN = 63


def main(folder):
    """Write all images into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    browser_path = subprocess.run([ROOT / 'tools' / 'browser.sh'], check=True, capture_output=True, text=True)
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        place = Path(place)
        config = MachineConfig().changed(seed=3, plate={'balls': 12}, hidden=[DRIFT])
        write_csv(Machine(config).run(plan(12, 'random')), place / 'run.csv')
        browser = playwright.chromium.launch(executable_path=browser_path.stdout.strip(), args=FLAGS)
        with studio(place, 'run.csv') as address:
            picture_run(browser, address, folder)
        with Cell(DOMAIN, log_dir=place / 'runs', params={'sequencer': {'order': 'random'}}), \
                studio(place, '--domain', str(DOMAIN)) as address:
            picture_cell(browser, address, folder)
        browser.close()


def picture_run(browser, address, folder):
    """Take an image of the verdict on a run."""
    page = browser.new_page(viewport=DESKTOP)
    page.goto(address)
    settle(page, 'bad')
    page.screenshot(path=folder / 'studio-verdict.png')
    page.close()


def picture_cell(browser, address, folder):
    """Take an image of the tab of a running cell after a calibration."""
    page = browser.new_page(viewport=DESKTOP)
    page.goto(address)
    page.get_by_test_id('open-close').click()
    page.get_by_test_id('tab-live').click()
    page.get_by_test_id('connect').click()
    expect(page.get_by_test_id('health-table')).to_contain_text('sequencer: healthy')
    page.get_by_test_id('start').click()
    expect(page.get_by_test_id('live-words')).to_contain_text('Result of run', timeout=60_000)
    expect(page.get_by_test_id('open-log')).to_be_visible(timeout=60_000)
    page.wait_for_timeout(3000)
    page.screenshot(path=folder / 'studio-cell.png')
    page.close()


def settle(page, level):
    """Wait until the verdict is shown and everything is drawn."""
    expect(page.get_by_test_id('verdict')).to_have_class(re.compile(rf'\b{level}\b'), timeout=60_000)
    expect(page.get_by_test_id('step')).to_be_hidden(timeout=60_000)
    page.wait_for_timeout(2000)


@contextmanager
def studio(place, *arguments):
    """Yield the address of a running studio."""
    command = [sys.executable, '-m', 'rosette_ros.cli.main', 'studio', '--no-browser', *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=place,
                          env={**os.environ, 'PYTHONUNBUFFERED': '1'}) as process:
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


if __name__ == '__main__':
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / 'docs' / 'images')

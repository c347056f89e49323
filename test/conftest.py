# SPDX-License-Identifier: Apache-2.0
"""What tests of several folders need: a ROS domain of their own, and small cells; and which files start first."""

import asyncio
import atexit
import contextlib
import functools
import gc
import html
import io
import os
import random
import re
import shutil
import signal
import socket
import time
from pathlib import Path

import hypothesis
import pytest
import yaml
from forked_nodes import OUTPUTS, ForkedNode, preload
from known_searches import KnownSearches
from matplotlib.figure import Figure
from matplotlib.text import Text

from rosette_ros.cell.supervisor import Cell, added_environment
from rosette_ros.cli import main
from rosette_ros.cli.demo_cell import is_free
from rosette_ros.core.diagnosis import diagnosis
from rosette_ros.core.joint import cell_diagnosis

gc.disable()  # until all is loaded
os.environ.update(added_environment(os.environ))
Cell.process_of = ForkedNode  # the cells of the commands that tests run as processes start theirs as users do

# How long an example takes says something of the computer, not of the code; make fuzz takes many of them.
hypothesis.settings.register_profile('rosette', deadline=None, max_examples=20)
hypothesis.settings.load_profile('rosette')

WAITS = {'chromium', 'domain_id', 'module_domain_id'}
"""Fixtures of tests that mostly wait, for a cell or a browser."""


def pytest_ignore_collect(collection_path, config):
    """Do not load files of which every test is long where none is wanted: each worker loads all that it may run."""
    if config.option.markexpr == 'not long' and collection_path.suffix == '.py':
        return '\npytestmark = pytest.mark.long\n' in collection_path.read_text('utf-8') or None
    return None


def pytest_collection_modifyitems(items):
    """Start the files that wait before those that compute, long ones first, so that two processors have something to
    do from the beginning to the end."""
    waits = {item.path for item in items if WAITS & set(getattr(item, 'fixturenames', ()))}
    long = {item.path for item in items if item.get_closest_marker('long')}
    items.sort(key=lambda item: (item.path not in long, item.path not in waits))


def pytest_collection_finish():
    """Say what processes that fork load, after all modules of tests have said it; and let garbage be looked for among
    what tests make alone, and less often, also after a command that they run here: figures are made of many objects. At
    the end all is cleared up; libraries tell of what is left."""
    preload()
    gc.freeze()
    gc.enable()
    atexit.register(gc.unfreeze)
    main.FEWER_COLLECTIONS *= 100
    gc.set_threshold(main.FEWER_COLLECTIONS)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(call):
    """Add to a test that fails what nodes of its process have said meanwhile."""
    report = yield
    for output in map(Path, OUTPUTS) if report.failed else ():
        if output.exists() and output.stat().st_mtime >= call.start:
            report.sections.append((f'output of {output.parent.parent.name}/{output.name}', '\n'.join(
                line for line in output.read_text('utf-8', 'replace').splitlines() if _is_since(line, call.start))))
    return report


def _is_since(line, begin):
    """Return whether a line of a node's output has no time of its own, or a later one."""
    time_of = re.match(r'\[\w+\] \[([\d.]+)\]', line)
    return time_of is None or float(time_of[1]) >= begin


@pytest.fixture(scope='session', autouse=True)
def own_signals():
    """Let no process that a test starts inherit that a signal is ignored, as shells in the background ignore SIGINT and
    nohup SIGHUP: what has a handler here has none there. Here they stay without effect, but for Ctrl-C, which tests
    press; Python itself ignores what it tells by an error."""
    for number in signal.valid_signals() - {signal.SIGPIPE, signal.SIGXFSZ}:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else lambda *_: None)


@pytest.fixture(scope='session')
def kept_searches(tmp_path_factory):
    """Return the searches that all workers have made."""
    folder = tmp_path_factory.getbasetemp()
    return KnownSearches((folder.parent if 'PYTEST_XDIST_WORKER' in os.environ else folder) / 'searches')


@pytest.fixture(scope='module')
def shared_searches(kept_searches):
    """Search what a run lacks once for all tests that use this, and for what is made for all tests of their file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnosis, 'RunDiagnosis', kept_searches.search)
        patch.setattr(cell_diagnosis, 'RunSearch', lambda run, model: kept_searches.search(run, model).search)
        yield
    kept_searches.keep()


@pytest.fixture(scope='module', autouse=True)
def known_searches(shared_searches):
    """Share all searches; folders whose subject is the search replace this."""


@pytest.fixture
def sketched(monkeypatch):
    """Let figures in pages be their texts alone: lines take longer to draw than all the rest of a page to make."""
    drawn = Figure.savefig

    def sketch(figure, stream, **options):
        if not isinstance(stream, io.StringIO):
            return drawn(figure, stream, **options)
        texts = ''.join(f'<text>{html.escape(one.get_text())}</text>' for one in figure.findobj(Text))
        return stream.write(f'<svg xmlns="http://www.w3.org/2000/svg">{texts}</svg>')

    monkeypatch.setattr(Figure, 'savefig', sketch)


@pytest.fixture(autouse=True)
def own_loop(request):
    """Hide the event loop that the browser of other tests keeps running in this thread: programs start their own."""
    running = None if 'chromium' in request.fixturenames else asyncio._get_running_loop()
    if running is None:
        yield
        return
    asyncio._set_running_loop(None)
    yield
    asyncio._set_running_loop(running)


BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
FLAGS = ('--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
         '--disable-component-update', '--disable-sync',
         '--disable-features=WebUIOmniboxPopup,WebUIOmniboxAimPopup')  # pages of its own in every window: 0.4 s each
NO_BROWSER = f'expected one of {", ".join(BROWSERS)} on PATH (tools/browser.sh installs one), found none'
_DOMAINS = range(60, 100)
_LOCK_PORT = 47000


@contextlib.contextmanager
def free_domain():
    """Yield a ROS domain that no other test on this computer uses at the moment."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        lock = socket.socket()
        try:
            lock.bind(('127.0.0.1', _LOCK_PORT + domain))
        except OSError:
            lock.close()
            continue
        with lock:
            if not is_free(domain):  # used by another program: a node of an earlier test, a cell of somebody
                continue
            yield domain
        return
    pytest.fail(f'expected a free ROS domain in {_DOMAINS}, all are in use')


@pytest.fixture
def domain_id():
    """Yield a ROS domain for one test."""
    with free_domain() as domain:
        yield domain


@pytest.fixture(scope='module')
def module_domain_id():
    """Yield a ROS domain for the tests of one file that share a cell."""
    with free_domain() as domain:
        yield domain


def write_machine(folder, balls, silent=False, **groups):
    """Write a machine.yaml for so many balls and return its path; silent: without noise."""
    content = {'seed': 3, 'plate': {'balls': balls}, **groups}
    if silent:
        content.update(
            probing={'repeatability_um': 0.0}, timing={'jitter_s': 0.0},
            cmm={'scale_ppm': 0.0, 'squareness_urad': 0.0, 'straightness_um': 0.0})
    path = folder / 'machine.yaml'
    path.write_text(yaml.safe_dump(content), encoding='utf-8')
    return path


def _make_cell(domain, folder, balls=4, silent=False, sequencer=None, groups=None, **changes):
    """Return a Cell for so many balls that keeps everything in a folder."""
    settings = {'plate.balls': balls, 'repeats': 3, **(sequencer or {})}
    return Cell(domain, machine=write_machine(folder, balls, silent, **(groups or {})),
                params={'sequencer': settings, **changes.pop('params', {})},
                log_dir=folder / 'runs', output_dir=folder / 'output', **changes)


@pytest.fixture
def cell_of(domain_id, tmp_path):
    """Return a function that makes a Cell in the test's own domain and folder."""
    return functools.partial(_make_cell, domain_id, tmp_path)


@pytest.fixture(scope='session')
def make_cell():
    """Return the function that makes a Cell in any domain and folder."""
    return _make_cell


@pytest.fixture(scope='session')
def wait_until():
    """Return a function that waits until a condition holds and fails where it never does."""

    def wait(condition, timeout=300.0):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f'expected this within {timeout} s'
            time.sleep(0.05)

    return wait


@pytest.fixture(scope='session')
def chromium():
    """Yield a headless browser; without one the tests fail where CI is set, and are skipped elsewhere."""
    from playwright.sync_api import sync_playwright  # most tests need no browser
    path = next(filter(None, map(shutil.which, (os.environ.get('ROSETTE_BROWSER', ''), *BROWSERS))), None)
    if path is None and os.environ.get('CI', '').lower() in ('1', 'true'):
        pytest.fail(NO_BROWSER)
    if path is None:
        pytest.skip(NO_BROWSER)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()

# SPDX-License-Identifier: Apache-2.0
"""A real studio in a process of its own, and a real browser that opens its page."""

import contextlib
import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from page_steps import judged
from playwright.sync_api import expect

from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

BALLS = 6
DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [3.0, 0.0, 1.5]}
TIMEOUT = 300_000
"""Longest time that the page may take for anything, ms; a busy computer must not fail a test."""
expect.set_options(timeout=TIMEOUT)


@pytest.fixture(scope='session')
def visitor(chromium):
    """Yield what a browser keeps between pages: scripts that are loaded and compiled once, cookies; nothing moves."""
    context = chromium.new_context(reduced_motion='reduce')
    yield context
    context.close()


def _opened_in(visitor):
    """Return a new page of a browser, and what its console and its requests will complain of."""
    made, problems = visitor.new_page(), []
    made.set_viewport_size({'width': 1280, 'height': 800})
    made.set_default_timeout(TIMEOUT)
    made.on('console', lambda line: line.type in ('error', 'warning') and problems.append(line.text))
    made.on('pageerror', lambda error: problems.append(str(error)))
    made.on('request', lambda request: _is_foreign(request.url) and problems.append(request.url))
    made.on('requestfailed', lambda request: problems.append(f'{request.url}: {request.failure}'))
    return made, problems


def _is_quiet(problems):
    """Return whether nothing has failed and no request has left the computer."""
    return [words for words in problems if 'net::ERR_ABORTED' not in words] == []


@pytest.fixture
def page(visitor):
    """Yield a page without cookies."""
    visitor.clear_cookies()
    made, problems = _opened_in(visitor)
    yield made
    made.close()
    assert _is_quiet(problems), problems


@pytest.fixture(scope='module')
def module_pages(chromium):
    """Yield the pages that tests of a file share, none at first, and the browser that keeps their session."""
    context = chromium.new_context(reduced_motion='reduce')
    yield context, []
    context.close()


@pytest.fixture
def shared_page(request, module_pages, studio):
    """Yield the page of the drifting run with its verdict: each test leaves it as it was, or fails and it goes."""
    context, pages = module_pages
    if not pages:
        context.clear_cookies()
        pages.append(_opened_in(context))
        pages[0][0].goto(studio.address)
        judged(pages[0][0], 'bad')
    failed = request.session.testsfailed
    page, problems = pages[0]
    yield page
    if request.session.testsfailed > failed or not _is_quiet(problems):
        pages.clear()
        page.close()
    assert _is_quiet(problems), problems


def _is_foreign(url):
    return not url.startswith(('http://127.0.0.1:', 'http://localhost:', 'ws://127.0.0.1:', 'file:', 'data:', 'blob:'))


def _environment():
    """Return the environment without pytest: NiceGUI behaves differently where it sees it."""
    own = {name: value for name, value in os.environ.items() if not name.startswith('PYTEST')}
    return {**own, 'PYTHONUNBUFFERED': '1', 'OPENBLAS_NUM_THREADS': '1'}


@contextlib.contextmanager
def studio_process(folder, *arguments, environment=None, codes=(0, 130)):
    """Yield a running `rosette studio` as .address, .process and .folder."""
    output = folder / 'studio.log'
    with open(output, 'wb') as stream:
        process = subprocess.Popen(
            [sys.executable, '-m', 'rosette_ros.cli.main', 'studio', '--no-browser', *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=stream, text=True, cwd=folder, start_new_session=True,
            env={**_environment(), **(environment or {})})
        try:
            line = process.stdout.readline()
            assert line.startswith('rosette studio: http'), f'{line}{output.read_text()}'
            yield SimpleNamespace(address=line.split()[-1], process=process, folder=folder)
        finally:
            process.send_signal(signal.SIGINT)
            try:
                code = process.wait(60)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                raise
            finally:
                process.stdout.close()
    assert code in codes, output.read_text()
    assert 'Traceback' not in output.read_text(), output.read_text()


@pytest.fixture(scope='session')
def drifting(tmp_path_factory):
    """Return the path of a table of a run in which the frame drifts, which the base model does not know."""
    path = tmp_path_factory.mktemp('runs') / 'drifting.csv'
    config = MachineConfig().changed(seed=3, plate={'balls': BALLS}, hidden=[DRIFT])
    write_csv(Machine(config).run(plan(BALLS, 'random')), path)
    return path


@pytest.fixture(scope='session')
def second(tmp_path_factory):
    """Return the path of a second run of the same cell."""
    path = tmp_path_factory.mktemp('runs') / 'second.csv'
    config = MachineConfig().changed(seed=4, plate={'balls': BALLS}, hidden=[DRIFT])
    write_csv(Machine(config).run(plan(BALLS, 'random', 1)), path)
    return path


@pytest.fixture(scope='session')
def studio(tmp_path_factory, drifting):
    """Yield a running studio with the drifting run, shared by all tests: each page has a session of its own."""
    with studio_process(tmp_path_factory.mktemp('studio'), drifting) as running:
        yield running


@pytest.fixture(scope='session')
def start_studio():
    """Return the context manager that runs a studio in a folder with arguments."""
    return studio_process

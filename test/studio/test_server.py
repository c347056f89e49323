# SPDX-License-Identifier: Apache-2.0
"""The server against clients that are no browser, and against pages of others."""

import asyncio
import os
import re
import signal
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from mcap.writer import Writer
from playwright.sync_api import expect

from rosette_ros.studio.page import MOST_BROWSERS, Controllers

pytestmark = pytest.mark.long

LOADS = 300
MOST_KEPT = 60
"""MB; a page that is built takes more than 1 MB."""


def send(address, request):
    """Return the first line of the answer to the bytes of a request."""
    with socket.create_connection(('127.0.0.1', urlsplit(address).port), timeout=300) as connection:
        connection.sendall(request)
        answer = b''.join(iter(lambda: connection.recv(1 << 16), b''))
    return answer.partition(b'\r\n')[0].decode()


def resident(process, name='VmRSS'):
    """Return the memory of a process, MB; VmHWM: the most that it has had."""
    return int(re.search(rf'{name}:\s+(\d+)', Path(f'/proc/{process.pid}/status').read_text())[1]) / 1024


@pytest.mark.parametrize('head', [
    b'/ HTTP/1.1\r\nHost: [::1', b'/ HTTP/1.1\r\nHost: \xff', b'/ HTTP/1.1\r\nHost: localhost\r\nOrigin: http://[::1',
    b'/\xff HTTP/1.1\r\nHost: localhost', b'/%ff HTTP/1.1\r\nHost: localhost', b'/%0d%0aa HTTP/1.1\r\nHost: localhost',
    b'/ HTTP/1.1\r\nHost: localhost\r\nX-A: a\r\n b', b'/ HTTP/1.1\r\nHost: localhost\r\nX-A: a\nb'])
def test_what_no_browser_sends_is_refused_in_one_line(studio, head):
    """In the name, the origin, the path and the headers; the studio lives on."""
    log = studio.folder / 'studio.log'
    before = len(log.read_text())
    assert send(studio.address, b'GET ' + head + b'\r\nConnection: close\r\n\r\n') == 'HTTP/1.1 400 Bad Request'
    assert len(log.read_text()[before:].splitlines()) == 1


@pytest.fixture(scope='module')
def empty(start_studio, tmp_path_factory):
    """Yield a studio of its own, without a run, whose memory is that of these tests."""
    with start_studio(tmp_path_factory.mktemp('empty')) as running:
        yield running


def test_pages_that_are_only_loaded_keep_no_memory(empty):
    """Clients without websocket and without cookie."""
    request = f'GET / HTTP/1.1\r\nHost: {urlsplit(empty.address).netloc}\r\nConnection: close\r\n\r\n'.encode()
    assert send(empty.address, request) == 'HTTP/1.1 200 OK'
    before = resident(empty.process)
    for _ in range(LOADS):
        send(empty.address, request)
    assert resident(empty.process) - before < MOST_KEPT


def test_images_on_a_foreign_page_do_not_empty_a_session(studio, chromium):
    """What was opened is still there."""
    context = chromium.new_context()
    page = context.new_page()
    page.goto(studio.address)
    expect(page.get_by_test_id('run')).to_have_value('drifting.csv')
    page.get_by_test_id('remove-cmm_deviations').click()
    expect(page.get_by_test_id('part-cmm_deviations')).to_be_hidden()
    foreign = context.new_page()
    foreign.set_content(''.join(f'<img src="{studio.address}?{k}">' for k in range(40)))
    foreign.wait_for_load_state('networkidle')
    page.reload()
    expect(page.get_by_test_id('part-table_motions')).to_be_visible()
    expect(page.get_by_test_id('part-cmm_deviations')).to_be_hidden()
    context.close()


def test_a_browser_with_an_open_page_keeps_its_session():
    """However many others come; without a page it is dropped as they are, the one that came first before all others."""
    every = Controllers()
    first, _ = every.of('first')
    first.changed.subscribe(print)
    others = [every.of(f'other {k}')[0] for k in range(MOST_BROWSERS)]
    with ThreadPoolExecutor(1) as thread:  # Playwright has a running loop in the thread of the tests
        assert thread.submit(asyncio.run, first.do_quick(int)).result() == 0
    assert every.of('other 1') == (others[1], False)
    assert every.of('other 0')[1]
    assert every.of('first') == (first, False)
    first.changed.unsubscribe(print)
    for k in range(MOST_BROWSERS):
        every.of(f'another {k}')
    assert every.of('first')[1]
    every.close()


def test_an_upload_that_expands_is_refused(empty, chromium, tmp_path):
    """A log of 27 kB that holds 0.8 GB takes no memory of the studio, which lives on."""
    bomb = tmp_path / 'bomb.mcap'
    writer = Writer(str(bomb), chunk_size=1 << 30)
    writer.start()
    channel = writer.register_channel('/x', 'cdr', writer.register_schema('std_msgs/msg/String', 'ros2msg', b''))
    for k in range(8):
        writer.add_message(channel, k, bytes(100 << 20), k)
    writer.finish()
    page = chromium.new_page()
    page.goto(empty.address)
    page.locator('input[type=file]').set_input_files(bomb)
    expect(page.get_by_test_id('open-error')).to_contain_text('bomb.mcap: ')
    assert resident(empty.process, 'VmHWM') < 500
    page.close()


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_without_a_traceback(start_studio, tmp_path, drifting, number):
    """To all of its processes, as of a service manager or a terminal that is closed."""
    with start_studio(tmp_path, drifting, codes=(143,)) as studio:
        os.killpg(studio.process.pid, number)
        studio.process.wait(60)

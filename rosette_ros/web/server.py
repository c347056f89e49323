# SPDX-License-Identifier: Apache-2.0
"""Serves the studio: one desk per browser, one door for all."""

import asyncio
import ipaddress
import os
import secrets
import socket
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from tempfile import TemporaryDirectory

from nicegui import app, background_tasks, ui

from rosette_ros.core.errors import CellError, InvalidConfig
from rosette_ros.nodes.names import NAMESPACE
from rosette_ros.web.desk import Desk
from rosette_ros.web.door import LOOPBACK, Door
from rosette_ros.web.live_panel import Cells
from rosette_ros.web.page import Page

MOST_DESKS = 16
"""So many browsers keep what is on their desk; of more, the one not seen for longest loses it."""


@dataclass(frozen=True)
class Wanted:
    """How the studio was asked for on the command line.

    runs: paths to open at the start; suggestions: paths that are offered; port: 0 for a free one;
    token: None on loopback without one; domain: of ROS, None for that of the environment; namespace: of
    the cell that the page offers to watch.
    """

    runs: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    host: str = '127.0.0.1'
    port: int = 0
    token: str | None = None
    domain: int | None = None
    browser: bool = True
    namespace: str = NAMESPACE


class Desks:
    """The desk of each browser, by the name in its cookie."""

    def __init__(self):
        """Start without any."""
        self._quick = ThreadPoolExecutor(1, 'quick')
        self._desks = OrderedDict()

    def of(self, browser):
        """Return the Desk of a browser, and whether it is new."""
        is_new = browser not in self._desks
        desk = self._desks.setdefault(browser, Desk(self._quick))
        self._desks.move_to_end(browser)
        while len(self._desks) > MOST_DESKS:
            self._desks.popitem(last=False)[1].close()
        return desk, is_new

    def close(self):
        """End what is on at all desks."""
        for desk in self._desks.values():
            desk.close()
        self._quick.shutdown(wait=False, cancel_futures=True)


def serve(wanted, on_ready=None):
    """Serve the studio until it is ended; on_ready(address) is called when it can be opened.

    Raises CellError where the port is taken.
    """
    port = free_port(wanted.host, wanted.port)
    name = f'[{wanted.host}]' if ':' in wanted.host else wanted.host
    address = f'http://{"localhost" if name in ("0.0.0.0", "[::]") else name}:{port}/'
    desks, cells = Desks(), Cells()
    with TemporaryDirectory(prefix='rosette_studio_') as folder:
        async def build():
            desk, is_new = desks.of(app.storage.browser['id'])
            page = Page(desk, wanted, folder, cells)
            await page.begin(is_new)

        ui.page('/', title='rosette studio', favicon='◎')(build)
        if on_ready:
            app.on_startup(lambda: background_tasks.create(_tell_when_ready(wanted.host, port, address, on_ready)))
        app.on_shutdown(desks.close)
        app.on_shutdown(cells.close)
        names = (*LOOPBACK, wanted.host) if is_loopback(wanted.host) else None
        app.add_middleware(Door, token=wanted.token, names=names)
        ui.run(host=wanted.host, port=port, show=wanted.browser and f'/{_query(wanted)}', reload=False,
               dark=None, tailwind=False, storage_secret=secrets.token_hex(32), show_welcome_message=False,
               session_middleware_kwargs={'session_cookie': f'rosette_{port}', 'same_site': 'lax'},
               reconnect_timeout=30.0, timeout_graceful_shutdown=2)


async def _tell_when_ready(host, port, address, on_ready):
    """Call on_ready(address) as soon as the port is listened on."""
    while True:
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        writer.close()
        on_ready(address)
        return


def _query(wanted):
    return f'?token={wanted.token}' if wanted.token else ''


def free_port(host, port):
    """Return a port that can be listened on; 0 asks for any. Raises CellError where it is taken."""
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == 'posix':
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise CellError(f'studio: wanted to listen on {host} port {port}, got: {error.strerror}; choose '
                            'another --port or --host') from error
        return probe.getsockname()[1]


def is_loopback(host):
    """Return whether an address is this computer's alone; raises InvalidConfig for what is no address."""
    if host == 'localhost':
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise InvalidConfig(f'--host: wanted an IP address such as 192.168.1.5, or localhost, got {host!r}') \
            from None

# SPDX-License-Identifier: Apache-2.0
"""Serves the studio: one Controller per browser, one access control for all."""

import asyncio
import ipaddress
import secrets
import socket
from collections import OrderedDict
from collections.abc import Callable
from importlib import resources
from tempfile import TemporaryDirectory

from nicegui import app, background_tasks, ui

from rosette_ros.core.errors import CellError, InvalidConfig
from rosette_ros.studio.access_control import LOOPBACK, AccessControl
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.page import Page, StudioOptions
from rosette_ros.studio.panels.live_panel import CellWatchers
from rosette_ros.studio.studio_session import KeptResults
from rosette_ros.studio.worker import prepare

MOST_BROWSERS = 16
"""The state of so many browsers is kept; of more, that of the one without a page not seen for longest is dropped."""

CONNECTED_WITHIN = 30.0
"""A page whose websocket is not open after so long is forgotten, s."""


class Controllers:
    """The Controller of each browser, by the name in its cookie."""

    def __init__(self) -> None:
        self._controllers: OrderedDict[str, Controller] = OrderedDict()
        self._kept = KeptResults()

    def of(self, browser: str) -> tuple[Controller, bool]:
        """Return the Controller of a browser, and whether it is new."""
        is_new = browser not in self._controllers
        if is_new:
            self._controllers[browser] = Controller(self._kept)
        self._controllers.move_to_end(browser)
        unseen = [name for name, one in self._controllers.items() if not one.is_shown and name != browser]
        for name in unseen[:max(len(self._controllers) - MOST_BROWSERS, 0)]:
            self._controllers.pop(name).close()
        return self._controllers[browser], is_new

    def close(self) -> None:
        """End all calculations."""
        for controller in self._controllers.values():
            controller.close()


REMOVED_FIGURE = """<script>addEventListener('unhandledrejection', event => {
    if (event.reason?.message?.startsWith('Resize must be passed a displayed plot div')) event.preventDefault();
})</script>"""
"""A figure that is removed before its browser has drawn it cannot follow the size of the window; nobody needs it to."""


def serve(options: StudioOptions, on_ready: Callable[[str], object] | None = None) -> None:
    """Serve the studio until it is ended; on_ready(address): when it can be opened; raises CellError for the port."""
    port = free_port(options.host, options.port)
    name = f'[{options.host}]' if ':' in options.host else options.host
    address = f'http://{"localhost" if name in ("0.0.0.0", "[::]") else name}:{port}/'
    controllers, cells = Controllers(), CellWatchers()
    prepare()
    with TemporaryDirectory(prefix='rosette_studio_') as folder:
        async def build() -> None:
            client = ui.context.client
            await client.connected(CONNECTED_WITHIN)  # what only loads the page keeps nothing here
            if client.is_deleted:
                return
            controller, is_new = controllers.of(app.storage.browser['id'])
            Page(controller, options, folder, cells).begin(is_new)

        ui.page('/', title='rosette studio', favicon='◎', language='en-US')(build)
        ui.add_css(resources.files('rosette_ros.studio').joinpath('style.css').read_text('utf-8'), shared=True)
        ui.add_head_html(REMOVED_FIGURE, shared=True)
        app.colors(primary='#00598c')
        if on_ready:
            app.on_startup(lambda: background_tasks.create(_call_when_ready(options.host, port, address, on_ready)))
        app.on_shutdown(controllers.close)
        app.on_shutdown(cells.close)
        app.add_middleware(AccessControl, token=options.token,
                           names=(*LOOPBACK, options.host) if is_loopback(options.host) else None)
        query = f'?token={options.token}' if options.token else ''
        ui.run(host=options.host, port=port, show=f'/{query}' if options.browser else False, reload=False, dark=None,
               tailwind=False, storage_secret=secrets.token_hex(32), show_welcome_message=False,
               session_middleware_kwargs={'session_cookie': f'rosette_{port}', 'same_site': 'lax'},
               reconnect_timeout=30.0, timeout_graceful_shutdown=2)


async def _call_when_ready(host: str, port: int, address: str, on_ready: Callable[[str], object]) -> None:
    """Call on_ready(address) as soon as the port accepts connections."""
    while True:
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        writer.close()
        on_ready(address)
        return


def free_port(host: str, port: int) -> int:
    """Return a port that can be listened on; 0 means any. Raises CellError where it is taken."""
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise CellError(f'studio: wanted to listen on {host} port {port}, got: {error.strerror}; choose '
                            'another --port or --host') from error
        return int(probe.getsockname()[1])


def is_loopback(host: str) -> bool:
    """Return whether an address is this computer's alone; raises InvalidConfig for what is no address."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise InvalidConfig(f'--host: wanted an IP address such as 192.168.1.5, or localhost, got {host!r}') from None

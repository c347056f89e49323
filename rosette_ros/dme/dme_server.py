# SPDX-License-Identifier: Apache-2.0
"""A server of I++ DME on this computer with the simulated machine behind it, for clients that want to be tried.

It listens on the loopback address only. One client at a time is served; machine, tool and parameters stay between
connections, as those of a controller do.
"""

import asyncio
import contextlib
import ipaddress
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future

from rosette_ros.core.errors import CellError
from rosette_ros.dme.serve_commands import ServedCommands
from rosette_ros.dme.serve_errors import Refused
from rosette_ros.dme.serve_session import ServedConnection
from rosette_ros.dme.serve_settings import DmeFaults, ServeSettings
from rosette_ros.dme.wire import ERROR, LONGEST, Response, encoded
from rosette_ros.simulation import MachineConfig

HOST = '127.0.0.1'
GRACE = 0.3
"""So long a new client waits for the one before to be gone, s."""


class DmeServer:
    """The server; commands: the machine and its state; sessions: number of connections so far."""

    def __init__(self, config: MachineConfig, settings: ServeSettings | None = None,
                 say: Callable[[str], None] = lambda line: None) -> None:
        settings = settings or ServeSettings()
        self.commands = ServedCommands(config, settings, DmeFaults(settings.faults))
        self.sessions, self._say = 0, say
        self._server: asyncio.Server | None = None
        self._free = asyncio.Lock()
        self._connections: set[asyncio.Task[None]] = set()

    async def start(self, port: int = 0, host: str = HOST) -> int:
        """Listen on a port, 0: a free one, and return it; raises CellError for an address that is not loopback."""
        check_loopback(host)
        try:
            self._server = await asyncio.start_server(self._serve, host, port, limit=LONGEST)
        except OSError as error:
            raise CellError(f'port: wanted a free one, got {port}: {error.strerror or error}; end what listens there '
                            'or choose another one with --port') from error
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close all connections and listen no longer."""
        if self._server is not None:
            self._server.close()
        for task in list(self._connections):
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        try:
            if await self._is_free():
                try:
                    self.sessions += 1
                    self._say('connected')
                    await ServedConnection(self.commands, writer, self._say).run(reader)
                    self._say('disconnected')
                finally:
                    self._free.release()
            else:
                writer.write(encoded(Response('E0000', ERROR, (Refused(8, 'Connect').error.value(),)).line()))
        except asyncio.CancelledError:
            pass  # the server is being stopped
        finally:
            self._connections.discard(task)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _is_free(self) -> bool:
        """Return whether no other client is served, and keep the place."""
        with contextlib.suppress(TimeoutError):
            return await asyncio.wait_for(self._free.acquire(), GRACE)
        return False


def check_loopback(host: str) -> None:
    """Raise CellError where a host is not this computer's own loopback address: nobody else shall move a machine."""
    with contextlib.suppress(ValueError):
        if host == 'localhost' or ipaddress.ip_address(host).is_loopback:
            return
    raise CellError(f'host: wanted the loopback address 127.0.0.1, got {host!r:.60}; the simulated machine is for '
                    'clients on this computer only')


@contextlib.contextmanager
def serving(config: MachineConfig, settings: ServeSettings | None = None, port: int = 0,
            say: Callable[[str], None] = lambda line: None, host: str = HOST) -> Iterator[tuple[int, DmeServer]]:
    """Serve in a thread of its own and yield the port and the server; raises CellError as start."""
    ready: Future[tuple[int, DmeServer, Callable[[], object]]] = Future()

    async def serve() -> None:
        over, loop = asyncio.Event(), asyncio.get_running_loop()
        server = DmeServer(config, settings, say)
        try:
            ready.set_result((await server.start(port, host), server, lambda: loop.call_soon_threadsafe(over.set)))
        except CellError as error:
            ready.set_exception(error)
            return
        await over.wait()
        await server.stop()

    thread = threading.Thread(target=asyncio.run, args=(serve(),), name='dme server', daemon=True)
    thread.start()
    found, server, end = ready.result()
    try:
        yield found, server
    finally:
        end()
        thread.join()

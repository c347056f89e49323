# SPDX-License-Identifier: Apache-2.0
"""What stands between a client and a server of I++ and spoils the conversation: what a client must survive."""

import asyncio
import contextlib
import re
import threading
from concurrent.futures import Future

TOGETHER = 0.005
"""Lines within this time are sent in one packet, where packets are joined, s."""
ERRORS = {'surface_not_found': ('PtMeas', 2, 1006), 'collision': ('GoTo', 3, 2504), 'out_of_limits': ('GoTo', 3, 2500)}


class FaultyProxy:
    """faults: KIND, or KIND:at=N, which strikes once, at its N-th occasion; say: called with every line."""

    def __init__(self, faults=(), say=lambda line: None):
        self._say, self._server, self._tasks, self._held = say, None, set(), []
        self.strikes(*faults)

    def strikes(self, *faults):
        """Have faults strike from now on."""
        parts = [fault.partition(':at=') for fault in faults]
        self._at = {kind: int(at or 0) for kind, _, at in parts}
        self._occasions = dict.fromkeys(self._at, 0)

    def _strikes(self, kind):
        """Count an occasion; return whether the fault strikes."""
        if kind not in self._at:
            return False
        self._occasions[kind] += 1
        return self._at[kind] in (0, self._occasions[kind])

    async def start(self, port):
        """Listen before the server at a port of this computer; return the port for clients."""
        self._port = port
        self._server = await asyncio.start_server(self._serve, '127.0.0.1', 0)
        return self._server.sockets[0].getsockname()[1]

    async def stop(self):
        """End all connections."""
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader, writer):
        self._tasks.add(asyncio.current_task())
        behind, to_server = await asyncio.open_connection('127.0.0.1', self._port)
        self._is_mute, self._names = False, {}
        ways = [asyncio.create_task(self._requests(reader, to_server, writer)),
                asyncio.create_task(self._answers(behind, writer))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for one in (*ways, writer, to_server):
                one.cancel() if isinstance(one, asyncio.Task) else one.close()
            await asyncio.gather(*ways, return_exceptions=True)

    async def _requests(self, reader, to_server, writer):
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                data = await reader.readuntil(b'\r\n')
                tag, text = data.decode().strip().split(' ', 1)
                name = self._names[tag] = text.partition('(')[0]
                self._say(f'< {tag} {text}')
                failed = [kind for kind, (what, _, _) in ERRORS.items() if what == name and self._strikes(kind)]
                if failed:
                    _, severity, number = ERRORS[failed[0]]
                    self._write(writer, f'{tag} &', f'{tag} ! Error({severity}, {number:04d}, "{name}", "'
                                f'{failed[0].replace("_", " ").capitalize()}")', f'{tag} %')
                elif name == 'GoTo' and self._strikes('emergency_stop'):
                    self._write(writer, f'{tag} &', 'E0000 ! Error(3, 0500, "HealthCheck", "Emergency stop")',
                                f'{tag} ! Error(2, 0006, "GoTo", "Transaction aborted")', f'{tag} %')
                elif name == 'AbortE' and self._strikes('abort_ignored'):
                    self._write(writer, f'{tag} &')
                elif name == 'SetProp' and self._strikes('clamped'):
                    self._write(writer, f'{tag} &', f'{tag} ! Error(1, 0504, "SetProp", "Argument out of range")',
                                f'{tag} %')
                else:
                    to_server.write(data)

    async def _answers(self, behind, writer):
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                line = (await behind.readuntil(b'\r\n')).decode().strip()
                tag, kind, *_ = line.split(' ')
                is_touch = kind.startswith('#') and self._names.get(tag) == 'PtMeas'
                if is_touch and self._strikes('restart'):
                    return
                self._is_mute |= is_touch and self._strikes('half_open')
                if is_touch and self._strikes('garbage'):
                    writer.write(b'\x00\xff\x13 #!&% \x80(((\r\n')
                if is_touch and self._strikes('wrong_tag'):
                    line = f'{int(tag) % 99999 + 1:05d}{line[5:]}'
                if is_touch and self._strikes('nan'):
                    line = re.sub(r'X\([^)]*\)', 'X(nan)', line)
                if kind.startswith('#') and self._strikes('reordered'):
                    line = f'{tag} # {", ".join(re.findall(r"[A-Z.a-z]+[(][^)]*[)]", line)[::-1]) or line[8:]}'
                if '(' in line and self._strikes('quoted'):
                    line = re.sub(r'(?<=\()(-?[0-9.]+)(?=\))', r'"\1"', line)
                after = ['E0000 ! Error(3, 1009, "HealthCheck", "Air pressure out of range")'] * (
                    kind == '%' and self._names.get(tag) == 'PtMeas' and self._strikes('unsolicited'))
                await self._deliver(writer, line, *after)

    async def _deliver(self, writer, *lines):
        if self._strikes('slow'):
            await asyncio.sleep(5e-4)
        if self._strikes('joined'):
            self._held += lines
            asyncio.get_running_loop().call_later(TOGETHER, self._write_held, writer)
        elif self._strikes('split'):
            half = len(lines[0]) // 2
            writer.write(lines[0][:half].encode())
            await writer.drain()
            self._write(writer, lines[0][half:], *lines[1:])
        else:
            self._write(writer, *lines)

    def _write_held(self, writer):
        held, self._held = self._held, []
        if held and not writer.is_closing():
            writer.write(''.join(f'{line}\r\n' for line in held).encode())

    def _write(self, writer, *lines):
        for line in lines:
            self._say(f'> {line}')
            if not (self._is_mute or writer.is_closing()):
                writer.write(f'{line}\r\n'.encode())


@contextlib.contextmanager
def spoiling(port, *faults, say=lambda line: None):
    """Yield the port of a proxy in a thread of its own, and the proxy."""
    ready = Future()

    async def serve():
        over, loop = asyncio.Event(), asyncio.get_running_loop()
        proxy = FaultyProxy(faults, say)
        ready.set_result((await proxy.start(port), proxy, lambda: loop.call_soon_threadsafe(over.set)))
        await over.wait()
        await proxy.stop()

    thread = threading.Thread(target=asyncio.run, args=(serve(),), daemon=True)
    thread.start()
    found, proxy, end = ready.result()
    try:
        yield found, proxy
    finally:
        end()
        thread.join()

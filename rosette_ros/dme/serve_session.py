# SPDX-License-Identifier: Apache-2.0
"""One connection to the simulated server: what is taken in which state, in which order it is answered, what goes wrong.

A command is acknowledged when it comes and carried out in its turn; event commands are carried out at once. After an
error of severity 2 or more all that waits is aborted, and only ClearAllErrors is taken.
Source: I++ DME 1.4.3, 6.2, 8.1.
"""

import asyncio
import logging
import re
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from rosette_ros.dme import wire
from rosette_ros.dme.serve_commands import AXES, Line, ServedCommands
from rosette_ros.dme.serve_errors import Refused

EVENTS = ('AbortE', 'GetErrStatusE', 'GetPropE', 'OnMoveReportE')
MOST_WAITING = 8
"""Commands that may wait; the next one is acknowledged when there is room."""
FLOOD = 1000
"""Commands that a client may send without waiting for an Ack; then nothing more is read, AbortE neither."""
TICK = 0.1
"""Moves are reported no more often, s."""
TOGETHER = 0.005
"""Lines within this time are sent in one packet, where packets are joined, s."""


class ServedConnection:
    """A connection; say: called with every line, after `<` where it was received and `>` where it was sent."""

    def __init__(self, commands: ServedCommands, writer: asyncio.StreamWriter, say: Callable[[str], None]) -> None:
        self.commands, self.faults, self._writer, self._say = commands, commands.faults, writer, say
        self._is_open = self._is_mute = False
        self._waiting: deque[wire.Command] = deque()
        self._current: wire.Command | None = None
        self._work: asyncio.Task[list[Line]] | None = None
        self._changed = asyncio.Condition()
        self._daemons: dict[str, asyncio.Task[None]] = {}
        self._out: asyncio.Queue[bytes] | None = asyncio.Queue() if self.faults.has('split', 'joined', 'slow') else None

    async def run(self, reader: asyncio.StreamReader) -> None:
        """Serve the connection until it ends; then nothing moves any more."""
        tasks: list[asyncio.Task[None] | asyncio.Task[list[Line]]] = [asyncio.create_task(self._carry_out_all())]
        if self._out is not None:
            tasks.append(asyncio.create_task(self._deliver(self._out)))
        try:
            while True:
                data = await reader.readuntil(b'\r\n')
                await self._take(data[:-2])
        except asyncio.LimitOverrunError:
            self._fail('E0000', Refused(7, 'Receive'))
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            tasks += [*self._daemons.values(), *([self._work] if self._work else [])]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.commands.cmm.stop()

    async def _take(self, data: bytes) -> None:
        """Take a line: acknowledge a command and carry it out, or let it wait; answer what is none with an error."""
        try:
            text = wire.decoded(data)
        except wire.NotDme:
            self._fail('E0000', Refused(7, 'Receive'))
            return
        self._say(f'< {text}')
        tag = text[:5]
        taken = {one.tag for one in self._waiting} | ({self._current.tag} if self._current else set())
        if not re.fullmatch('[0-9]{5}|E[0-9]{4}', tag) or tag in ('00000', 'E0000') or tag in taken:
            self._fail('E0000', Refused(1, 'Receive'))
        elif text[5:6] != ' ':
            self._refuse(tag, Refused(2, 'Receive'))
        else:
            try:
                command = wire.parse_command(text)
            except wire.NotDme:
                self._refuse(tag, Refused(8, 'Receive'))
                return
            if (command.call.name in EVENTS) != (tag[0] == 'E'):
                self._refuse(tag, Refused(1, command.call.name))
            elif tag[0] == 'E':
                await self._event(command)
            else:
                async with self._changed:
                    await self._changed.wait_for(lambda: len(self._waiting) < FLOOD)
                    if len(self._waiting) < MOST_WAITING:
                        self._send(tag, wire.ACK)
                    self._waiting.append(command)
                    self._changed.notify_all()

    async def _event(self, command: wire.Command) -> None:
        """Carry out an event command at once."""
        tag, name = command.tag, command.call.name
        self._send(tag, wire.ACK)
        try:
            if not self._is_open:
                raise Refused(8, name)
            if name == 'AbortE':
                if self.faults.strike('abort_ignored'):
                    return
                await self._abort()
            elif name == 'OnMoveReportE':
                self._start_daemon(tag, command.call)
            else:
                self._answer(tag, self.commands.answer(command.call))
        except Exception as error:
            self._fail(tag, _refused(name, error))
        self._send(tag, wire.DONE)

    async def _abort(self) -> None:
        """Stop what moves and abort what waits; afterwards only ClearAllErrors is taken."""
        self.commands.wants_clear = True
        if self._work is not None:
            self._work.cancel()
        async with self._changed:
            await self._changed.wait_for(lambda: self._current is None)
        self._abort_waiting()

    async def _carry_out_all(self) -> None:
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: self._waiting)
                self._current = self._waiting.popleft()
                if len(self._waiting) >= MOST_WAITING:
                    self._send(self._waiting[MOST_WAITING - 1].tag, wire.ACK)
                self._changed.notify_all()
            await self._carry_out(self._current)
            async with self._changed:
                self._current = None
                self._changed.notify_all()

    async def _carry_out(self, command: wire.Command) -> None:
        """Carry out a command and answer it to its end."""
        tag, name = command.tag, command.call.name
        try:
            self._work = asyncio.create_task(self._result(command))
            await asyncio.wait([self._work])
            if self._work.cancelled():
                raise Refused(6, name)
            self._answer(tag, self._work.result())
        except Exception as error:
            refused = _refused(name, error)
            if refused.error.number == 500:
                self._fail('E0000', refused)
                refused = Refused(6, name)
            self._fail(tag, refused)
        else:
            if name == 'PtMeas' and self.faults.strike('unsolicited'):
                self._fail('E0000', Refused(1009, 'HealthCheck'))
        finally:
            self._work = None
        self._send(tag, wire.DONE)
        if self.commands.wants_clear:
            self._abort_waiting()

    async def _result(self, sent: wire.Command) -> list[Line]:
        """Return what a command answers at its end, in the state that the session is in; raises Refused."""
        command, commands = sent.call, self.commands
        name = command.name
        if not self._is_open and name != 'StartSession':
            if name == 'EndSession':
                return []
            raise Refused(8, name)
        if name == 'StartSession' and not self._is_open:
            self._is_open, commands.wants_clear, commands.cmm.is_stopped = True, False, False
            commands.begin_session()
        elif name == 'ClearAllErrors':
            commands.wants_clear = commands.cmm.is_stopped = False
        elif commands.wants_clear and name != 'GetXtdErrStatus':
            raise Refused(514, name)
        elif name == 'StartSession':
            raise Refused(8, name)
        elif name == 'EndSession':
            self._is_open = False
            self._stop_daemons(*self._daemons)
        elif name == 'StopDaemon':
            if not command.values or str(command.values[0]) not in self._daemons:
                raise Refused(513, name)
            self._stop_daemons(str(command.values[0]))
        elif name == 'StopAllDaemons':
            if not self._daemons:
                raise Refused(512, name)
            self._stop_daemons(*self._daemons)
        else:
            return await commands.carry_out(command, partial(self._touched, sent.tag))
        if command.values and name != 'StopDaemon':
            raise Refused(502, name)
        return []

    def _start_daemon(self, tag: str, command: wire.Call) -> None:
        if tag in self._daemons:
            raise Refused(515, command.name)
        values = {one.name: one.values for one in command.values if isinstance(one, wire.Call)}
        names = [name for name in values if name in (*AXES, 'R')]
        try:
            period, far = (wire.number((wire.named(command.values, name) or (0.0,))[0]) for name in ('Time', 'Dis'))
        except wire.NotDme:
            raise Refused(509, command.name) from None
        if not names or set(values) - {'Time', 'Dis', *names} or period < TICK or len(values) < len(command.values):
            raise Refused(510, command.name)
        self._daemons[tag] = asyncio.create_task(self._report_moves(tag, period, 1e-3 * far, names))

    async def _report_moves(self, tag: str, period: float, far: float, names: list[str]) -> None:
        """Report the position when it has moved far enough, m, or when the period, s, is over."""
        last, since = self.commands.cmm.place, 0.0
        while True:
            await asyncio.sleep(TICK)
            since, place = since + TICK, self.commands.cmm.place
            moved = float(np.linalg.norm(place - last))
            if since >= period - 1e-9 or (far and moved >= far):
                self._send(tag, wire.DATA, self.commands.place_values(names))
                last, since = place, 0.0

    def _stop_daemons(self, *tags: str) -> None:
        for tag in tags:
            self._daemons.pop(tag).cancel()

    def _abort_waiting(self) -> None:
        for place, command in enumerate(self._waiting):
            if place >= MOST_WAITING:
                self._send(command.tag, wire.ACK)
            self._fail(command.tag, Refused(6, command.call.name))
            self._send(command.tag, wire.DONE)
        self._waiting.clear()

    def _refuse(self, tag: str, refused: Refused) -> None:
        """Answer what is no command: acknowledged, an error, done."""
        self._send(tag, wire.ACK)
        self._fail(tag, refused)
        self._send(tag, wire.DONE)

    def _fail(self, tag: str, refused: Refused) -> None:
        """Answer an error; from severity 2 on ClearAllErrors has to follow."""
        if refused.error.severity >= 2:
            self.commands.wants_clear = True
        self._send(tag, wire.ERROR, (refused.error.value(),))

    def _answer(self, tag: str, lines: list[Line]) -> None:
        for values in lines:
            self._send(tag, wire.DATA, values)

    def _touched(self, tag: str, values: Line) -> None:
        """Answer a touch when it is made, with the faults that strike it."""
        strike = self.faults.strike
        if strike('restart'):
            self._writer.transport.abort()
        if strike('half_open'):
            self._is_mute = True
        if strike('garbage'):
            self._write(b'\x00\xff\x13 #!&% \x80(((\r\n')
        if strike('wrong_tag'):
            tag = f'{int(tag) % 99999 + 1:05d}'
        if strike('nan'):
            values = tuple(wire.call('X', wire.Word('nan')) if isinstance(one, wire.Call) and one.name == 'X' else one
                           for one in values)
        self._answer(tag, [values])

    def _send(self, tag: str, kind: str, values: Line = ()) -> None:
        if kind == wire.DATA and self.faults.strike('reordered'):
            values = values[::-1]
        text = wire.Response(tag, kind, values).line(self.commands.settings.dialect == '1.4')
        if values and self.faults.strike('quoted'):
            text = re.sub(r'\b([0-9]{4})(?=, ")|(?<=\()(-?[0-9.]+)(?=\))', r'"\1\2"', text)
        self._say(f'> {text}')
        self._write(wire.encoded(text))

    def _write(self, data: bytes) -> None:
        if self._is_mute or self._writer.is_closing():
            return
        if self._out is None:
            self._writer.write(data)
        else:
            self._out.put_nowait(data)

    async def _deliver(self, out: asyncio.Queue[bytes]) -> None:
        """Send what waits late, in parts, or several lines at once."""
        while True:
            data = await out.get()
            if fault := self.faults.strike('slow'):
                await asyncio.sleep(fault.seconds)
            if self.faults.strike('joined'):
                await asyncio.sleep(TOGETHER)
                while not out.empty():
                    data += out.get_nowait()
            if fault := self.faults.strike('split'):
                self._writer.write(data[:len(data) // 2])
                data = data[len(data) // 2:]
                await asyncio.sleep(fault.seconds)
            self._writer.write(data)


def _refused(name: str, error: Exception) -> Refused:
    """Return the error that is answered where a command has raised one; an unexpected one is logged."""
    if isinstance(error, Refused):
        return error
    logging.getLogger(__name__).error('rosette dme serve: %s ended in a program error', name, exc_info=error)
    return Refused(511, name)

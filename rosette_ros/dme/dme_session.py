# SPDX-License-Identifier: Apache-2.0
"""A client's session with an I++ DME server: one command after the other, errors, abortion, the end of the connection.

Nothing is tried again, cleared, homed or connected anew unless the caller says so. A command may be sent after the Ack
of the last one; from an error of severity 2 on nothing but ClearAllErrors is sent. Source: I++ DME 1.4.3, 6.2 and 8.
"""

import asyncio
import math
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from rosette_ros.core.run.errors import CellError
from rosette_ros.dme import wire
from rosette_ros.dme.dme_settings import TimeoutSettings

ABORTED, CLAMPED, NOT_CLEARED, NO_SURFACE = 6, 504, 514, 1006
OF_A_COMMAND = frozenset((ABORTED, 501, 502, 505, 506, 507, 508, 509, 510, 511, 513, NO_SURFACE, 1008, 1010, 1502,
                          1503, 2000, 2002, 2500, 2505, 2506))
"""Errors that concern one command: the machine stands as it is used to. After any other severe one a person looks."""
FOR_PERSON = frozenset((500, 2504))
"""Emergency stop and collision: a person looks, whatever severity the server gives them."""
_UNSUPPORTED = frozenset((501, 502, 505, 506, 507, 508, 509, 510, 511))
SEVERE = 2
"""From this severity on the server takes nothing but ClearAllErrors."""
_BUSY = 'is another client connected to the server, or is it no I++ server?'

USUAL = TimeoutSettings()
Data = list[tuple[wire.Value, ...]]
"""What a command answered: the values of each line of data."""


class DmeStopped(CellError):
    """Nothing is sent any more until a person has looked at the machine."""


class DmeLost(DmeStopped):
    """The connection is lost, or what comes through it cannot be trusted."""


class ToolNotInUse(CellError):
    """Another tool is in use than the settings want, and the machine may not move to change it."""


class DmeRefused(CellError):
    """A command that the server did not carry out; error: its number and words."""

    def __init__(self, call: wire.Call, error: wire.DmeError) -> None:
        super().__init__(f'{wire.format_value(call)}: the server answered {error}')
        self.error = error


@dataclass(eq=False)
class SentCommand:
    """A command that was sent, and what was answered: data, warnings (severity 0 and 1) and the first error.

    data_time: when the first data came, s of the system clock, NaN before; acked, done: when the answers have come."""

    call: wire.Call
    acked: asyncio.Future[None]
    done: asyncio.Future[None]
    data: Data = field(default_factory=list)
    data_time: float = math.nan
    warnings: list[wire.DmeError] = field(default_factory=list)
    error: wire.DmeError | None = None


class DmeSession:
    """A connection to a server; every method belongs to the event loop in which it was made.

    stop: why nothing is sent, '' while commands are taken; for_person: whether a person has to look before errors are
    cleared; is_lost: whether the connection has ended; warnings: errors of severity 0 and 1, the newest last."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, where: str,
                 timeouts: TimeoutSettings = USUAL, trace: Callable[[str], None] | None = None) -> None:
        self._reader, self._writer, self.where, self._timeouts = reader, writer, where, timeouts
        self._trace = trace or (lambda line: None)
        self._pending: dict[str, SentCommand] = {}
        self._tags = self._events = 0
        self._is_answered = False  # before the first answer, nothing that this session sent moves the machine
        self._turn, self._aborting = asyncio.Lock(), asyncio.Lock()
        self.stop, self.for_person, self.is_lost, self.is_halted = '', False, False, False
        self.warnings = deque[str](maxlen=100)
        self._listener = asyncio.create_task(self._listen())

    @classmethod
    async def connect(cls, host: str, port: int = wire.PORT, timeouts: TimeoutSettings = USUAL,
                      trace: Callable[[str], None] | None = None, by_person: bool = False) -> 'DmeSession':
        """Return a session that has sent StartSession; raises DmeLost where nobody answers, DmeStopped, DmeRefused.

        by_person: whether a person has looked at the machine, so that errors which the server keeps are cleared."""
        where = address_words(host, port)
        try:
            async with asyncio.timeout(timeouts.connect_s):
                reader, writer = await asyncio.open_connection(host, port, limit=wire.LONGEST)
        except TimeoutError:
            raise DmeLost(f'{where}: expected a connection within {timeouts.connect_s:g} s, found none; is the I++ '
                          'server '
                          'started, and is host:port right?') from None
        except OSError as error:
            raise DmeLost(f'{where}: expected a connection, found {error.strerror or error}; is the I++ server '
                          'started, '
                          'and is host:port right?') from None
        connection = writer.get_extra_info('socket')
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        session = cls(reader, writer, where, timeouts, trace)
        try:
            try:
                await session.request(wire.Call('StartSession'))
            except DmeStopped:
                if session.is_lost or not by_person:
                    raise
                await session.clear(by_person=True)
                await session.request(wire.Call('StartSession'))
        except BaseException:
            await session.close()
            raise
        return session

    async def request(self, call: wire.Call, timeout: float | None = None) -> Data:
        """Return the data of a command; arguments and errors as of `carry_out`."""
        return (await self.carry_out(call, timeout)).data

    async def carry_out(self, call: wire.Call, timeout: float | None = None) -> SentCommand:
        """Send a command, wait for its end and return what was answered.

        timeout: for its end, s, None for the usual one; after it the command is aborted. Raises DmeRefused for an error
        of the command, DmeStopped where nothing may be sent, DmeLost."""
        clears = call.name in ('ClearAllErrors', 'EndSession')
        async with self._turn:
            self._refuse_if_stopped(call.name)
            self._tags = self._tags % 99999 + 1
            pending = self._send(f'{self._tags:05d}', call)
            try:
                await self._within(self._timeouts.ack_s, pending.acked, call, 'Ack')
            finally:
                pending.acked.cancel()
        await self._within(timeout or self._timeouts.command_s, pending.done, call, 'end')
        if self.for_person and not clears:
            raise DmeStopped(self.stop)
        if pending.error:
            raise DmeRefused(call, pending.error)
        return pending

    async def optional(self, call: wire.Call) -> Data | None:
        """Send a command that a server need not have; None where it has not, and its error is cleared."""
        try:
            return await self.request(call)
        except DmeRefused as error:
            if error.error.number not in _UNSUPPORTED:
                raise
            if self.stop:
                await self.clear()
            return None

    async def property_of(self, name: str) -> float | None:
        """Return a property such as Tool.PtMeasPar.Speed, None where the server has none; raises NotDme."""
        values = sum(await self.optional(wire.Call('GetProp', (wire.Call(name),))) or [], ())
        return None if wire.named(values, name) is None else wire.numbers(values, name)[0]

    async def halt(self) -> None:
        """Send AbortE at once; nothing is sent after that until `resume`. Raises DmeLost."""
        self.is_halted = True
        await self.abort()

    async def resume(self) -> None:
        """Take commands again after `halt`, when AbortE has ended; raises DmeStopped where a person has to look."""
        async with self._aborting:
            self.is_halted = False
        if self.stop:
            await self.clear()

    async def abort(self) -> None:
        """Send AbortE at once and wait for its end; the server then wants ClearAllErrors. Raises DmeLost."""
        if self.is_lost:
            raise DmeLost(self.stop)
        if self._aborting.locked():
            return
        async with self._aborting:
            self._events = self._events % 9999 + 1
            pending = self._send(f'E{self._events:04d}', wire.Call('AbortE'))
            if not await _is_done(pending.done, self._timeouts.abort_s):
                self._lose(f'AbortE was not answered within {self._timeouts.abort_s:g} s: the machine may still move, '
                           'press the emergency stop')
                raise DmeLost(self.stop)
            self._stop_for(wire.DmeError(SEVERE, ABORTED, text='aborted'))
            self._expect_the_end()

    async def clear(self, by_person: bool = False) -> None:
        """Send ClearAllErrors; raises DmeStopped where a person has to look first, unless one has, and DmeRefused."""
        if self.for_person and not by_person:
            raise DmeStopped(self.stop)
        if by_person:
            self.is_halted = False
        await self.request(wire.Call('ClearAllErrors'))
        if not self.is_lost:
            self.stop, self.for_person = '', False

    async def end(self) -> None:
        """Send EndSession, which a server in an error state may refuse, and close the connection."""
        try:
            await self.request(wire.Call('EndSession'), self._timeouts.ack_s)
        except CellError:
            pass
        finally:
            await self.close()

    async def close(self) -> None:
        """Close the connection."""
        self._lose('the connection was closed')
        self._listener.cancel()
        await asyncio.gather(self._listener, return_exceptions=True)

    def _refuse_if_stopped(self, name: str) -> None:
        if self.is_lost:
            raise DmeLost(self.stop)
        is_stopped = self.is_halted or (self.stop and name != 'ClearAllErrors')
        if self._aborting.locked() or (is_stopped and name != 'EndSession'):
            raise DmeStopped(self.stop or f'{self.where}: aborted')

    def _send(self, tag: str, call: wire.Call) -> SentCommand:
        line = wire.Command(tag, call).line()
        loop = asyncio.get_running_loop()
        pending = self._pending[tag] = SentCommand(call, loop.create_future(), loop.create_future())
        self._trace(f'> {line}')
        self._writer.write(wire.encoded(line))
        return pending

    async def _within(self, seconds: float, future: 'asyncio.Future[None]', call: wire.Call, what: str) -> None:
        if not await _is_done(future, seconds):
            words = f'{wire.format_value(call)}: expected its {what} within {seconds:g} s, found none'
            if not self._is_answered:
                self._lose(f'{words}; {_BUSY}')
                raise DmeLost(self.stop)
            await self.abort()
            self._stop(f'{words}; it was aborted', for_person=True)
            raise DmeStopped(self.stop)

    async def _listen(self) -> None:
        try:
            while (line := await wire.read_line(self._reader)) is not None:
                self._trace(f'< {line}')
                self._take(wire.parse_response(line))
                self._is_answered = True
            words = 'the server closed the connection: it was ended or restarted'
        except wire.NotDme as error:
            words = f'the server sent what is no I++ DME: {error}'
        except OSError as error:
            words = f'the connection broke: {error.strerror or error}'
        self._lose(f'{words}; a person has to look at the machine' if self._is_answered else f'{words}; {_BUSY}')

    def _take(self, response: wire.Response) -> None:
        """Sort one line of the server; raises NotDme for a tag that nobody waits for."""
        if response.tag in wire.UNSOLICITED:
            if response.kind == wire.ERROR:
                self._note(wire.error_of(response), None)
            return
        pending = self._pending.get(response.tag)
        if pending is None:
            raise wire.NotDme(f'expected answers to {", ".join(self._pending) or "nothing"}, found one with the tag '
                              f'{response.tag}')
        if response.kind == wire.ACK and not pending.acked.done():
            pending.acked.set_result(None)
        elif response.kind == wire.DATA:
            pending.data_time = pending.data_time if pending.data else time.time()
            pending.data.append(response.values)
        elif response.kind == wire.ERROR:
            self._note(wire.error_of(response), pending)
        elif response.kind == wire.DONE:
            del self._pending[response.tag]
            for future in (pending.acked, pending.done):
                if not future.done():
                    future.set_result(None)

    def _note(self, error: wire.DmeError, pending: SentCommand | None) -> None:
        if error.severity < SEVERE and error.number not in FOR_PERSON:
            what = f'{wire.format_value(pending.call)}: ' if pending else ''
            self.warnings.append(f'{what}{error}')
            if pending:
                pending.warnings.append(error)
            return
        if pending and not pending.error:
            pending.error = error
        self._stop_for(error)
        if pending is None:
            self._expect_the_end()

    def _expect_the_end(self) -> None:
        """Give up commands that the server has aborted and does not end within the time of AbortE."""
        asyncio.get_running_loop().call_later(self._timeouts.abort_s, self._give_up, tuple(self._pending.values()))

    def _stop_for(self, error: wire.DmeError) -> None:
        if error.number == NOT_CLEARED and (self.stop or self._aborting.locked()):
            return  # a command that was waiting: what stopped the machine is known
        for_person = error.number not in OF_A_COMMAND or error.severity > 3
        self._stop(f'{error}{"; a person has to look at the machine" if for_person else ""}', for_person)

    def _stop(self, words: str, for_person: bool) -> None:
        """Remember why nothing may be sent; what a person has to look at is not forgotten for less."""
        if not self.stop or (for_person and not self.for_person):
            self.stop, self.for_person = f'{self.where}: {words}', for_person

    def _lose(self, words: str) -> None:
        if not self.is_lost:
            self.is_lost, self.for_person = True, True
            self.stop = f'{self.where}: {words}{f" (before: {self.stop})" if self.stop else ""}'
            self._writer.close()
        self._give_up(tuple(self._pending.values()))
        self._pending.clear()

    def _give_up(self, commands: tuple[SentCommand, ...]) -> None:
        for future in (future for one in commands for future in (one.acked, one.done) if not future.done()):
            future.set_exception(DmeLost(self.stop) if self.is_lost else
                                 DmeStopped(self.stop or f'{self.where}: aborted'))
            future.exception()  # nobody may wait for it


async def _is_done(future: 'asyncio.Future[None]', seconds: float) -> bool:
    """Wait for a future, which raises what it holds, and return whether it came within the time.

    Before Python 3.11.3 asyncio.timeout does not tell that to work that is being cancelled."""
    done, _ = await asyncio.wait((future,), timeout=seconds)
    if done:
        future.result()
    return bool(done)


def address_words(host: str, port: int) -> str:
    """Return where a server listens in words, an IPv6 address in brackets."""
    return f'[{host}]:{port}' if ':' in host else f'{host}:{port}'

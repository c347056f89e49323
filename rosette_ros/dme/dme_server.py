# SPDX-License-Identifier: Apache-2.0
"""A small server of I++ DME on this computer with the simulated machine behind it, to try clients.

One client at a time; the machine stays between connections. Commands are carried out one after the other, AbortE at
once. Millimetres and degrees. Source: I++ DME 1.4.3, 6.2, 6.3 and 8."""

import asyncio
import contextlib
import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from typing import Literal

import numpy as np
from pydantic import Field

from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.records import Floats
from rosette_ros.dme import wire
from rosette_ros.dme.virtual_cmm import LIMITS, Refused, VirtualCmm
from rosette_ros.dme.wire import Call, Value, Word, call
from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.setting_types import Positive, Settings
from rosette_ros.simulation.touch_by_touch import SingleTouch

HOST = '127.0.0.1'
AXES: tuple[str, ...] = ('X', 'Y', 'Z')
TOOLS = ('Probe1', 'RefTool')
VERSIONS = {'1.4': '1.4.3', '2.x': '2.5'}
MOST_TURN = 3600.0  # deg that the table may be turned by one command
Line = tuple[Value, ...]


class ServeSettings(Settings):
    """The server: speed None is as fast as the computer allows, 1 real time, 60 sixty times that."""

    dialect: Literal['1.4', '2.x'] = '1.4'
    speed: Positive | None = None
    sign: Literal[-1, 1] = Field(1, description='of R: 1 counts counter-clockwise about the axis')
    cumulative: bool = Field(False, description='R counts over turns; else it is 0 to 360 and the short way is taken')
    compensated: bool = Field(False, description='points lie on the surface; else the centre of the tip is reported')


class ServedCommands:
    """What commands do with the machine `cmm`; tool: the one in use."""

    def __init__(self, config: MachineConfig, settings: ServeSettings) -> None:
        self.settings, self.cmm = settings, VirtualCmm(config, settings.speed)
        self.tool, self.report = TOOLS[0], AXES

    async def carry_out(self, command: Call, answer: Callable[[Line], None]) -> None:
        """Carry out a command; answer: called with each line of its data, of a touch before the retract.

        Raises Refused; NotDme where arguments are none."""
        cmm = self.cmm
        match command.name:
            case 'GetDMEVersion':
                answer((call('DMEVersion', VERSIONS[self.settings.dialect]),))
            case 'GetMachineClass':
                answer((call('GetMachineClass', Word('SimulatedCartCMMWithRotaryTable')),))
            case 'IsHomed':
                answer((call('IsHomed', float(cmm.is_homed)),))
            case 'EnumTools':
                for name in TOOLS:
                    answer((name,))
            case 'SetCoordSystem':
                pass  # all are the machine's own
            case 'ReadAllTemperatures' if self.settings.dialect == '2.x':
                value = round(cmm.cell.temperature(cmm.clock.now()), 6)
                answer((call('Name', 'Part'), call('Temperature', value)))
            case 'ChangeTool' | 'SetTool':
                if len(command.values) != 1 or command.values[0] not in TOOLS:
                    raise Refused(1502, command.name)
                self.tool, cmm.parameters = str(command.values[0]), dict(cmm.usual)
            case 'GetProp':
                answer(self._stated(command, {'Tool.Name': self.tool, 'Tool.AvrRadius': 1e3 * cmm.cell.pattern.tip, **{
                    f'Tool.{name}{end}': value for name, (least, most) in LIMITS.items()
                    for end, value in (('', cmm.parameters[name]), ('.Min', least), ('.Max', most))}}))
            case 'SetProp':
                self._set_properties(command)
            case 'Get':
                answer(self._stated(command, dict(zip(AXES, _rounded(1e3 * cmm.place)), R=self._shown_angle())))
            case 'OnPtMeasReport':
                self._stated(command, dict.fromkeys((*AXES, 'IJK', 'R'), 0.0))
                self.report = tuple(one.name for one in _calls(command))
            case 'GoTo':
                await cmm.go_to(self._target(command, 'R'), self._angle(command), command.name)
            case 'PtMeas':
                outwards = np.array(wire.numbers(command.values, 'IJK', 3))
                length = float(np.linalg.norm(outwards))
                if not 1e-9 < length < 1e9:
                    raise Refused(1010, command.name)
                await cmm.measure(self._target(command, 'IJK'), outwards / length,
                                  lambda touch: answer(self._touched(touch, outwards / length)))
            case _:
                raise Refused(501, command.name)

    def _stated(self, command: Call, known: Mapping[str, float | str]) -> Line:
        """Return what a command asks for by name; raises Refused."""
        if not {one.name for one in _calls(command)} <= {*known}:
            raise Refused(510, command.name)
        return tuple(call(one.name, known[one.name]) for one in _calls(command))

    def _set_properties(self, command: Call) -> None:
        made, is_clamped = dict(self.cmm.parameters), False
        for one in _calls(command):
            name = one.name.removeprefix('Tool.')
            if name not in made:
                raise Refused(510, command.name)
            [wanted] = wire.numbers(command.values, one.name)
            made[name] = min(max(wanted, LIMITS[name][0]), LIMITS[name][1])
            is_clamped |= made[name] != wanted
        self.cmm.parameters = made
        if is_clamped:
            raise Refused(504, command.name)

    def _angle(self, command: Call) -> float | None:
        """Return the unwrapped angle of the table that a move names, rad."""
        if wire.named(command.values, 'R') is None:
            return None
        [value] = wire.numbers(command.values, 'R')
        angle, now = math.radians(self.settings.sign * value), self.cmm.now()[1]
        if not self.settings.cumulative:  # the short way
            way = (angle - now) % math.tau
            angle = now + way - math.tau * (way > math.pi + 1e-12)
        if not (self.settings.cumulative or 0 <= value <= 360) or abs(angle - now) > math.radians(MOST_TURN):
            raise Refused(2505, command.name)
        return angle

    def _target(self, command: Call, other: str) -> Floats:
        """Return the place (3,), m, that the axes of a command name."""
        if not {one.name for one in _calls(command)} <= {*AXES, other}:
            raise Refused(505, command.name)
        place = self.cmm.place.copy()
        for axis, name in enumerate(AXES):
            if wire.named(command.values, name) is not None:
                place[axis] = 1e-3 * wire.numbers(command.values, name)[0]
        return place

    def _touched(self, touch: SingleTouch, outwards: Floats) -> Line:
        """Return what is reported of a touch."""
        point = 1e3 * (touch.tip - self.cmm.cell.pattern.tip * outwards if self.settings.compensated else touch.tip)
        values = dict(zip((*AXES, 'R'), (*_rounded(point), self._shown_angle())))
        return tuple(call(name, *(_rounded(outwards) if name == 'IJK' else (values[name],))) for name in self.report)

    def _shown_angle(self) -> float:
        angle = round(self.settings.sign * math.degrees(self.cmm.now()[1]), 9)
        return angle if self.settings.cumulative else angle % 360.0


class ServedConnection:
    """A connection; say: called with every line, after `<` where it was received and `>` where it was sent."""

    def __init__(self, commands: ServedCommands, writer: asyncio.StreamWriter, say: Callable[[str], None]) -> None:
        self._commands, self._writer, self._say = commands, writer, say
        self._is_open = self._wants_clear = False
        self._waiting = asyncio.Queue[wire.Command]()
        self._work: asyncio.Task[None] | None = None

    async def run(self, reader: asyncio.StreamReader) -> None:
        """Serve the connection until it ends; then nothing moves any more."""
        worker = asyncio.create_task(self._carry_out_all())
        try:
            while True:
                await self._take((await reader.readuntil(b'\r\n'))[:-2])
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, ConnectionError):
            pass
        finally:
            tasks = [worker, *([self._work] if self._work else [])]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._commands.cmm.stop()

    async def _take(self, data: bytes) -> None:
        """Take a line: acknowledge a command and let it wait for its turn; AbortE has none."""
        try:
            text = wire.decoded(data)
            self._say(f'< {text}')
            command = wire.parse_command(text)
        except wire.NotDme:
            self._fail('E0000', Refused(8, 'Receive'))
            return
        self._send(command.tag, wire.ACK)
        if command.call.name != 'AbortE':
            self._waiting.put_nowait(command)
            return
        self._wants_clear = True
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait([self._work])
        self._send(command.tag, wire.DONE)

    async def _carry_out_all(self) -> None:
        while True:
            self._work = asyncio.create_task(self._carry_out(await self._waiting.get()))
            await asyncio.wait([self._work])
            self._work = None

    async def _carry_out(self, sent: wire.Command) -> None:
        """Carry out a command and answer it to its end."""
        tag, name = sent.tag, sent.call.name
        try:
            if name in ('StartSession', 'EndSession', 'ClearAllErrors'):
                self._change_state(name)
            elif not self._is_open or self._wants_clear:
                raise Refused(514 if self._is_open else 8, name)
            else:
                await self._commands.carry_out(sent.call, lambda values: self._send(tag, wire.DATA, values))
        except asyncio.CancelledError:
            self._fail(tag, Refused(6, name))
        except wire.NotDme:
            self._fail(tag, Refused(509, name))
        except Refused as refused:
            self._fail(tag, refused)
        except Exception as error:  # of this program: the client has to be answered
            logging.getLogger(__name__).error('rosette dme serve: %s ended in a program error', name, exc_info=error)
            self._fail(tag, Refused(511, name))
        self._send(tag, wire.DONE)

    def _change_state(self, name: str) -> None:
        """Begin or end the session, or clear its errors; raises Refused."""
        if self._is_open and (name == 'StartSession' or (self._wants_clear and name == 'EndSession')):
            raise Refused(514 if self._wants_clear else 8, name)
        self._wants_clear, self._is_open = False, name == 'StartSession' or (self._is_open and name != 'EndSession')

    def _fail(self, tag: str, refused: Refused) -> None:
        self._wants_clear |= refused.error.severity >= 2
        self._send(tag, wire.ERROR, (refused.error.value(),))

    def _send(self, tag: str, kind: str, values: Line = ()) -> None:
        text = wire.Response(tag, kind, values).line(self._commands.settings.dialect == '1.4')
        self._say(f'> {text}')
        if not self._writer.is_closing():
            self._writer.write(wire.encoded(text))


class DmeServer:
    """The server; commands: the machine and its state; sessions: number of connections so far."""

    def __init__(self, config: MachineConfig, settings: ServeSettings | None = None,
                 say: Callable[[str], None] = lambda line: None) -> None:
        self.commands = ServedCommands(config, settings or ServeSettings())
        self.sessions, self._say, self._free = 0, say, asyncio.Lock()
        self._server: asyncio.Server | None = None
        self._connections: set[asyncio.Task[None]] = set()

    async def start(self, port: int = 0) -> int:
        """Listen on a port of the loopback address, 0: a free one, and return it; raises CellError."""
        try:
            self._server = await asyncio.start_server(self._serve, HOST, port, limit=wire.LONGEST)
        except OSError as error:
            raise CellError(f'port: expected a free one, found {port}: {error.strerror or error}; end what listens '
                            'there '
                            'or choose another one with --port') from error
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close all connections and listen no longer."""
        if self._server is not None:
            self._server.close()
        for task in self._connections:
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if task := asyncio.current_task():
            self._connections.add(task)
        try:
            async with self._free:  # another client waits
                self.sessions += 1
                self._say('connected')
                await ServedConnection(self.commands, writer, self._say).run(reader)
                self._say('disconnected')
        except asyncio.CancelledError:
            pass  # the server is being stopped
        finally:
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()


@contextlib.contextmanager
def serving(config: MachineConfig, settings: ServeSettings | None = None, port: int = 0,
            say: Callable[[str], None] = lambda line: None) -> Iterator[tuple[int, DmeServer]]:
    """Serve in a thread of its own and yield the port and the server; raises CellError as start."""
    ready: Future[tuple[int, DmeServer, Callable[[], object]]] = Future()

    async def serve() -> None:
        over, loop = asyncio.Event(), asyncio.get_running_loop()
        server = DmeServer(config, settings, say)
        try:
            ready.set_result((await server.start(port), server, lambda: loop.call_soon_threadsafe(over.set)))
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


def _calls(command: Call) -> tuple[Call, ...]:
    """Return the arguments of a command that are all Name(values), each name once; raises Refused."""
    found = tuple(one for one in command.values if isinstance(one, Call) and one.name)
    if len(found) < len(command.values) or len({one.name for one in found}) < len(found) or not found:
        raise Refused(502, command.name)
    return found


def _rounded(values: Floats) -> list[float]:
    return [round(value, 9) for value in values.tolist()]

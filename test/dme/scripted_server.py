# SPDX-License-Identifier: Apache-2.0
"""A small I++ server for tests: an ideal machine with balls and a table, of which single answers can be replaced."""

import asyncio
import contextlib

import numpy as np

from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.dme.ball_probing import DmeCmm
from rosette_ros.dme.dme_session import DmeSession
from rosette_ros.dme.dme_settings import dme_settings
from rosette_ros.dme.wire import (
    ACK,
    DATA,
    DONE,
    ERROR,
    Call,
    DmeError,
    Response,
    call,
    encoded,
    named,
    numbers,
    parse_command,
)

SETTINGS = {
    'schema': 'rosette-dme/1', 'table': {'balls': 6},
    'path': {'box_low_mm': [0, 0, -400], 'box_high_mm': [700, 600, 100]},
}
IMPATIENT = {'ack_s': 1.0, 'command_s': 1.5, 'abort_s': 0.5}
"""Time-outs of tests whose subject is one of them; a busy computer keeps them rarely."""
MOVING = ('GoTo', 'PtMeas', 'AlignPart', 'Home', 'ChangeTool')
OK = object()


class ScriptedServer:
    """replies: name of a command -> function of (tag, call) that returns what is sent in its place, or OK.

    What is sent: a list of Response or bytes. commands: what came, in order; moves: those that move something."""

    def __init__(self, settings, **replies):
        self.settings, self.replies, self.commands = settings, replies, []
        self.place, self.r, self.properties = np.array([100.0, 100.0, 50.0]), 0.0, {'Tool.AvrRadius': 2.5}
        self.blank, self.writers, self.turns = True, [], 1
        self.off = np.zeros(3)  # by which balls are off their places, mm

    async def __aenter__(self):
        self.server = await asyncio.start_server(self._serve, '127.0.0.1', 0)
        self.port = self.server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_):
        self.server.close()
        for writer in self.writers:
            writer.close()
        await asyncio.sleep(0)

    @property
    def moves(self):
        return [one for one in self.commands if one.name in MOVING]

    def send(self, *packets):
        """Send something that nobody asked for, on the last connection."""
        for packet in packets:
            self.writers[-1].write(packet if isinstance(packet, bytes) else encoded(packet.line(self.blank)))

    async def _serve(self, reader, writer):
        self.writers.append(writer)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                line = (await reader.readuntil(b'\r\n'))[:-2].decode()
                command = parse_command(line)
                self.commands.append(command.call)
                reply = self.replies.get(command.call.name)
                made = OK if reply is None else reply(command.tag, command.call)
                if asyncio.iscoroutine(made):
                    made = await made
                self.send(*(self.usual(command.tag, command.call) if made is OK else made))

    def usual(self, tag, asked):
        """Return the responses of the ideal machine."""
        if asked.name == 'GetProp' and asked.values[0].name not in self.properties:
            return error(tag, 3, 510, 'Bad property')
        values = getattr(self, f'_{asked.name}', lambda asked: ())(asked)
        lines = [Response(tag, DATA, tuple(values))] if values else []
        return [Response(tag, ACK), *lines, Response(tag, DONE)]

    def _IsHomed(self, asked):
        return [call('IsHomed', 1.0)]

    def _Get(self, asked):
        now = dict(zip('XYZ', self.place), R=self.r)
        return [call(one.name, float(now[one.name])) for one in asked.values]

    def _SetProp(self, asked):
        self.properties.update((one.name, one.values[0]) for one in asked.values)
        return []

    def _GetProp(self, asked):
        return [call(one.name, float(self.properties[one.name])) for one in asked.values]

    def _GoTo(self, asked):
        for place, axis in enumerate('XYZ'):
            if named(asked.values, axis):
                [self.place[place]] = numbers(asked.values, axis)
        if named(asked.values, 'R'):
            self.r = numbers(asked.values, 'R')[0] * self.turns
        return []

    def _AlignPart(self, asked):
        x, y = asked.values[3:5]
        self.r = float(np.rad2deg(np.arctan2(y, x)) % 360)
        return [Call('', tuple(asked.values[:3]))]

    def balls(self):
        """Return where the balls are, (n, 3), mm."""
        table = self.settings.table
        return 1e3 * table.frame.to_outer(rotate_z(np.deg2rad(self.r), table.balls_at(0.0))) + self.off

    def _PtMeas(self, asked):
        aim = np.array([numbers(asked.values, axis)[0] for axis in 'XYZ'])
        normal = np.array(numbers(asked.values, 'IJK', 3))
        balls = self.balls()
        ball = balls[np.argmin(np.linalg.norm(balls - aim, axis=1))]
        off, reach = ball - aim, self.settings.ball.radius_mm + self.settings.tool.tip_radius_mm
        along = off @ normal
        self.place = aim + normal * (along + np.sqrt(along**2 - off @ off + reach**2))
        return [call(axis, float(value)) for axis, value in zip('XYZ', self.place)]

    def _ReadAllTemperatures(self, asked):
        return [call('T1', -273.0), call('T2', 20.5)]


def error(tag, severity, number, text='words'):
    """Return the responses of a command that is refused."""
    return [Response(tag, ACK), Response(tag, ERROR, (DmeError(severity, number, 'method', text).value(),)),
            Response(tag, DONE)]


def unsolicited(severity, number, text='words'):
    """Return an error that nobody asked for."""
    return Response('E0000', ERROR, (DmeError(severity, number, 'method', text).value(),))


def settings_of(**changes):
    """Return the settings of the tests with single groups changed."""
    values = {**SETTINGS, **{key: {**SETTINGS.get(key, {}), **value} if isinstance(value, dict) else value
                             for key, value in changes.items()}}
    return dme_settings(values)


async def prepared(settings):
    """Connect, prepare the machine and return it."""
    server = settings.server
    cmm = DmeCmm(await DmeSession.connect(server.host, server.port, settings.timeouts), settings)
    try:
        await cmm.prepare()
    except BaseException:
        await cmm.session.end()
        raise
    return cmm


def run(scene, settings=None, **replies):
    """Run a scene(server, cmm) with a server and a prepared machine; return what it returns."""
    settings = settings or settings_of()

    async def played():
        async with ScriptedServer(settings, **replies) as server:
            there = settings.model_copy(update={'server': settings.server.model_copy(update={'port': server.port})})
            cmm = await prepared(there)
            try:
                return await scene(server, cmm)
            finally:
                await cmm.session.close()
    return asyncio.run(played())


async def measured(cmm, ball=1, position=1, approach=1, **more):
    """Measure a ball at a table position, as the sequencer asks for it."""
    table = cmm.settings.table
    angle = 2 * np.pi * (position - 1) / table.balls
    return await cmm.measure(ball, table.frame.to_outer(table.balls_at(angle))[ball - 1], angle, approach, **more)

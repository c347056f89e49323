# SPDX-License-Identifier: Apache-2.0
"""What I++ DME costs: a touch through the client against a bare TCP round trip, and balls an hour at real speeds.

Bare: two processes on the loopback address, one line there and the three lines of an answer back, plain sockets.
Client: the same answers, taken by the client's session. Server: the simulated machine answers, touch included.
Usage: python -m benchmarks dme
"""

import asyncio
import re
import socket
import subprocess
import sys
import time

import numpy as np

from rosette_ros.dme.ball_probing import DmeCmm
from rosette_ros.dme.dme_server import DmeServer
from rosette_ros.dme.dme_session import DmeSession
from rosette_ros.dme.dme_settings import client_settings, dme_settings
from rosette_ros.dme.wire import call
from rosette_ros.simulation import MachineConfig

TOUCHES = 2000
REPEATS = 3
LINE = b'00001 PtMeas(X(532.65), Y(259.62), Z(-292.3), IJK(0, 0, 1))\r\n'
DATA = b'# X(532.650161147), Y(259.619911168), Z(-289.791575552)'
TOUCH = call('PtMeas', call('X', 532.65), call('Y', 259.62), call('Z', -292.3), call('IJK', 0.0, 0.0, 1.0))
MUST = 10.0
"""Bare round trips that a touch may take in the client."""


def echo():
    """Answer every line like a server, without looking at more than its tag."""
    with socket.create_server(('127.0.0.1', 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            connection = listener.accept()[0]
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection, connection.makefile('rb') as lines:
                for line in lines:
                    tag = line[:5]
                    data = tag + b' ' + DATA + b'\r\n' if b'PtMeas' in line else b''
                    connection.sendall(tag + b' &\r\n' + data + tag + b' %\r\n')


def started(*command):
    """Start a process that prints its port first; return both."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    return process, int(re.search(r'(?:127\.0\.0\.1:)?(\d{4,5})', process.stdout.readline())[1])


def bare_seconds(port):
    """Return the seconds of a round trip by plain sockets."""
    with socket.create_connection(('127.0.0.1', port)) as connection, connection.makefile('rb') as lines:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        began = time.perf_counter()
        for _ in range(TOUCHES):
            connection.sendall(LINE)
            while b'%' not in lines.readline():
                pass
        return (time.perf_counter() - began) / TOUCHES


async def session_seconds(port, touches):
    """Return the seconds of a touch by the client's session, over ball 1."""
    session = await DmeSession.connect('127.0.0.1', port)
    await session.request(call('GoTo', call('X', 532.65), call('Y', 259.62), call('Z', -250.0)))
    began = time.perf_counter()
    for _ in range(touches):
        await session.request(TOUCH)
    spent = time.perf_counter() - began
    await session.end()
    return spent / touches


async def ball_seconds(speed):
    """Return (machine's time of a ball, s; commands of a ball), moves at a speed, mm/s."""
    config = MachineConfig().changed(timing={'cmm_speed_mm_per_s': speed})
    server = DmeServer(config)
    settings = dme_settings(client_settings(config, await server.start()))
    link = settings.server
    cmm, commands = DmeCmm(await DmeSession.connect(link.host, link.port, settings.timeouts), settings), []
    await cmm.prepare()
    carry_out = cmm.session.carry_out  # every command goes through it
    cmm.session.carry_out = lambda *values: commands.append(1) or carry_out(*values)
    taught = settings.table
    began, balls = server.commands.cmm.clock.now(), 6
    for ball in range(1, balls + 1):
        angle = 2 * np.pi * (ball - 1) / taught.balls
        await cmm.measure(ball, taught.frame.to_outer(taught.balls_at(angle))[ball - 1], angle, 1)
    spent = server.commands.cmm.clock.now() - began
    await cmm.session.end()
    await server.stop()
    return spent / balls, len(commands) / balls


def main():
    """Print the costs, their ratios, and balls an hour."""
    answering, port = started(__file__, 'echo')
    serving, served = started('-m', 'rosette_ros.cli.main', 'dme', 'serve', '--port', '0', '--speed', 'fast')
    try:
        trips = [(bare_seconds(port), asyncio.run(session_seconds(port, TOUCHES)),
                  asyncio.run(session_seconds(served, TOUCHES // 4))) for _ in range(REPEATS)]
    finally:
        for process in (answering, serving):
            process.terminate()
            process.wait()
    bare, client, server = 1e6 * np.min(trips, axis=0)
    print(f'  bare TCP round trip        {bare:7.0f} us')
    print(f'  touch, client              {client:7.0f} us   {client / bare:.1f} round trips   (wanted: {MUST:g})')
    print(f'  touch, client and server   {server:7.0f} us   {server / bare:.1f} round trips, the touch included')
    for speed in (60.0, 200.0):
        machine, commands = asyncio.run(ball_seconds(speed))
        spent = commands * 1e-6 * server
        print(f'  moves at {speed:3.0f} mm/s: {machine:5.1f} s a ball by the machine, {spent:.2f} s by the protocol '
              f'({commands:.0f} commands): {3600 / (machine + spent):.0f} balls an hour '
              f'({100 * spent / (machine + spent):.1f} % protocol)')


if __name__ == '__main__':
    echo() if sys.argv[1:] == ['echo'] else main()

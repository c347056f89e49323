# SPDX-License-Identifier: Apache-2.0
"""Which hosts and ports are opened, as Python's audit hooks tell: those that are configured, and no other."""

import asyncio
import sys

import pytest
from scripted_server import ScriptedServer, measured, prepared, settings_of

from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.dme_server import serving
from rosette_ros.dme.dme_session import DmeSession
from rosette_ros.simulation import MachineConfig

HEARD = {'socket.connect', 'socket.bind', 'socket.sendto', 'socket.getaddrinfo', 'socket.gethostbyname'}


class Audit:
    """The addresses that were used while it is on; a hook cannot be removed."""

    def __init__(self):
        self.is_on, self.used = False, []
        sys.addaudithook(self._hear)

    def _hear(self, event, arguments):
        if self.is_on and event in HEARD:
            self.used.append((event, tuple(arguments[1] if event in ('socket.connect', 'socket.bind', 'socket.sendto')
                                           else arguments[:2])))


AUDIT = Audit()


@pytest.fixture
def audit():
    """Yield what is used during a test."""
    AUDIT.is_on, AUDIT.used = True, []
    yield AUDIT
    AUDIT.is_on = False


def test_a_client_opens_what_is_configured(audit):
    """To measure, after a lost connection, and after a person has looked: host and port of the settings alone."""
    async def scene():
        settings = settings_of()
        async with ScriptedServer(settings) as server:
            there = settings.model_copy(update={'server': settings.server.model_copy(update={'port': server.port})})
            audit.used.clear()  # of the server
            cmm = await prepared(there)
            await measured(cmm)
            server.replies['GoTo'] = lambda tag, asked: server.writers[-1].close() or []
            for _ in range(2):
                with pytest.raises(CellError, match='the server closed the connection'):
                    await measured(cmm)
            assert {address for _, address in audit.used} == {('127.0.0.1', server.port)}
            assert [event for event, _ in audit.used].count('socket.connect') == 1
            await cmm.session.close()
            session = await DmeSession.connect('127.0.0.1', server.port, by_person=True)
            await session.end()
            assert {address for _, address in audit.used} == {('127.0.0.1', server.port)}
    asyncio.run(scene())


def test_a_server_listens_on_loopback_only(audit):
    """On one port, and it connects to nobody."""
    with serving(MachineConfig()) as (port, _):
        bound = [address for event, address in audit.used if event == 'socket.bind']
        assert bound == [('127.0.0.1', 0)]
        assert port
        assert 'socket.connect' not in [event for event, _ in audit.used]

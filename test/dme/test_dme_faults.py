# SPDX-License-Identifier: Apache-2.0
"""What goes wrong between client and server, over TCP: each in words, and nothing moves after a stop."""

import asyncio

import numpy as np
import pytest
from scripted_server import IMPATIENT, OK, error, measured, prepared, run, settings_of, unsolicited

from rosette_ros.core.run.errors import CellError
from rosette_ros.dme.dme_session import DmeLost, DmeSession, DmeStopped
from rosette_ros.dme.dme_settings import TimeoutSettings
from rosette_ros.dme.wire import ACK, DONE, Response, call, encoded

NANOMETRE = 1e-9


def at(number, reply):
    """Return a reply that is given from the `number`-th time on, once, the usual one before and after."""
    count = iter(range(1, 10_000))
    return lambda tag, asked: reply(tag, asked) if next(count) == number else OK


def no_move_after(server, cmm):
    """Return what still moves when the machine is asked to: nothing."""
    before = len(server.moves)

    async def tried():
        with pytest.raises(CellError) as caught:
            await measured(cmm)
        assert len(server.moves) == before
        return str(caught.value)
    return tried()


def stopped_by(words, settings=None, person=True, **replies):
    """Measure a ball, which a fault stops; return what is said. Nothing moves then, unless a person clears it."""
    async def scene(server, cmm):
        with pytest.raises(CellError, match=words) as caught:
            await measured(cmm)
        if person:
            assert cmm.session.for_person
            await no_move_after(server, cmm)
            assert 'ClearAllErrors' not in [one.name for one in server.commands]
        else:
            assert server.place[2] == pytest.approx(-240.0)  # the tip has gone up
            again = await measured(cmm)
            assert np.linalg.norm(again.centre - [0.5325, 0.26, -0.3]) < NANOMETRE
        return str(caught.value)
    return run(scene, settings, **replies)


def moved(server, tag, words):
    """Return the answer to PtMeas with other words in place of the numbers."""
    return [Response(tag, ACK), encoded(f'{tag} # {words}'), Response(tag, DONE)]


@pytest.mark.parametrize(('name', 'severity', 'number', 'person'), [
    ('PtMeas', 2, 1006, False), ('GoTo', 3, 1008, False), ('GoTo', 3, 2500, False), ('PtMeas', 3, 2000, False),
    ('PtMeas', 3, 2504, True), ('GoTo', 3, 500, True), ('GoTo', 9, 503, True), ('PtMeas', 3, 1005, True),
    ('PtMeas', 2, 514, True), ('GoTo', 3, 4711, True), ('GoTo', 1, 500, True), ('PtMeas', 0, 500, True),
    ('PtMeas', 1, 2504, True),
])
def test_errors_of_the_machine(name, severity, number, person):
    """One of the command: cleared, the tip goes up, the next ball is measured. Any other: a person has to look."""
    replies = {name: at(4, lambda tag, asked: error(tag, severity, number))}
    said = stopped_by(f'error {number:04d} \\(severity {severity}\\): words', person=person, **replies)
    assert ('a person has to look at the machine' in said) == person


def test_a_person_clears_a_collision():
    """After that it goes on."""
    async def scene(server, cmm):
        with pytest.raises(DmeStopped, match='error 2504'):
            await measured(cmm)
        with pytest.raises(DmeStopped, match='error 2504'):
            await cmm.session.clear()
        await cmm.session.clear(by_person=True)
        return await measured(cmm)
    found = run(scene, PtMeas=at(3, lambda tag, asked: error(tag, 3, 2504, 'Collision')))
    assert np.linalg.norm(found.centre - [0.5325, 0.26, -0.3]) < NANOMETRE


def test_a_person_clears_after_a_halt():
    """Also where the error came after a cancel: ClearAllErrors is sent, and the next ball is measured."""
    async def scene(server, cmm):
        await cmm.session.halt()
        server.send(unsolicited(3, 500, 'Emergency stop'))
        while not cmm.session.for_person:
            await asyncio.sleep(0)
        with pytest.raises(DmeStopped, match='error 0500'):
            await cmm.session.resume()
        await cmm.session.clear(by_person=True)
        assert server.commands[-1].name == 'ClearAllErrors'
        assert np.linalg.norm((await measured(cmm)).centre - [0.5325, 0.26, -0.3]) < NANOMETRE
    run(scene)


def test_a_server_in_an_error_state():
    """StartSession is refused with 0514: a person has to look; then the errors are cleared, and the session begins."""
    async def scene(server, cmm):
        await cmm.session.end()
        server.replies['StartSession'] = lambda tag, asked: OK if 'ClearAllErrors' in [
            one.name for one in server.commands] else error(tag, 2, 514, 'Use ClearAllErrors')
        with pytest.raises(DmeStopped, match='error 0514 .*a person has to look'):
            await DmeSession.connect('127.0.0.1', server.port)
        session = await DmeSession.connect('127.0.0.1', server.port, by_person=True)
        names = [one.name for one in server.commands]
        assert names[-4:] == ['StartSession', 'StartSession', 'ClearAllErrors', 'StartSession']
        await session.end()
    run(scene)


def test_unsolicited_errors():
    """A warning is noted; an emergency stop ends what runs, although the server never answers the command."""
    async def scene(server, cmm):
        server.send(unsolicited(1, 504, 'clamped'))
        await measured(cmm)
        assert [*cmm.session.warnings] == ['error 0504 (severity 1): clamped']

        async def silent(tag, asked):
            server.send(Response(tag, ACK), unsolicited(3, 500, 'Emergency stop'))
            return []
        server.replies['PtMeas'] = silent
        with pytest.raises(DmeStopped, match='error 0500 .*Emergency stop; a person has to look'):
            await measured(cmm)
        await no_move_after(server, cmm)
    run(scene, settings_of(timeouts={'abort_s': 0.5}))


def test_reordered_quoted_split_and_joined():
    """By name, in any order, in any packets, in both dialects."""
    async def scene(server, cmm):
        async def pieces(tag, asked):
            usual = server.usual(tag, asked)
            x, y, z = (f'{one.name}("{one.values[0]:.12f}")' for one in usual[1].values)
            data = encoded(f'{tag} &') + encoded(f'{tag} #{z}, {x},IJK(0, 0, 1),{y}') + encoded(f'{tag} %')
            for start in range(0, len(data), 7):
                server.send(data[start:start + 7])
                await asyncio.sleep(0)
            return []
        server.replies['PtMeas'] = pieces
        server.blank = False
        found = await measured(cmm)
        assert np.linalg.norm(found.centre - [0.5325, 0.26, -0.3]) < NANOMETRE
    run(scene)


@pytest.mark.parametrize(('words', 'said'), [
    ('X(nan), Y(1), Z(2)', 'X: expected a finite number, found nan'),
    ('X(1), Z(2)', r'expected Y\(...\) with 1 numbers'),
    ('X(1), Y(1), Z(2), X(3)', r'expected one X\(...\), found X\(1\), X\(3\)'),
    ('X(21.4), Y(10.2), Z(-11.8)', 'within 11 mm of .*does the server count in mm'),  # inches
    ('X(0.5379), Y(0.26), Z(-0.286)', 'does the server count in mm'),  # metres
])
def test_answers_that_make_no_sense(words, said):
    """The tip goes up, the touch is named, the next ball is measured."""
    assert 'touch 3: ' in stopped_by(said, person=False, PtMeas=at(3, lambda tag, asked: moved(None, tag, words)))


@pytest.mark.parametrize(('packet', 'said'), [
    (b'HTTP/1.1 400 Bad Request\r\n', 'no I\\+\\+ DME: expected a tag and one of'),
    (b'\xff\xfe\x00\r\n', 'printable ASCII'), (encoded('00777 %'), 'found one with the tag 00777'),
    (encoded('E0000 ! Error(7)'), 'expected Error'),
])
def test_garbage_and_wrong_tags(packet, said):
    """What comes through such a connection cannot be trusted: it is closed."""
    stopped_by(said, PtMeas=at(3, lambda tag, asked: [packet]))


def test_a_server_that_is_restarted():
    """Said in words; nothing connects anew by itself."""
    async def scene(server, cmm):
        server.replies['PtMeas'] = at(3, lambda tag, asked: server.writers[-1].close() or [])
        with pytest.raises(DmeLost, match='the server closed the connection: it was ended or restarted'):
            await measured(cmm)
        await no_move_after(server, cmm)
        assert len(server.writers) == 1
        cmm = await prepared(cmm.settings)
        assert np.linalg.norm((await measured(cmm)).centre - [0.5325, 0.26, -0.3]) < NANOMETRE
        await cmm.session.close()
    run(scene)


@pytest.mark.parametrize(('reply', 'said'), [
    (lambda tag, asked: [],
     'AbortE was not answered within 0.5 s: the machine may still move, press the emergency stop'),
    (lambda tag, asked: [Response(tag, ACK), Response(tag, DONE)], r'GoTo\(.*expected its end within 1.5 s'),
])
def test_slow_server_and_half_open_connection(reply, said):
    """A command that does not end is aborted; where that is not answered either, the machine may move."""
    stopped_by(said, settings_of(timeouts=IMPATIENT), GoTo=at(3, lambda tag, asked: [Response(tag, ACK)]), AbortE=reply)


def test_no_ack():
    """Likewise."""
    stopped_by('expected its Ack within 1 s', settings_of(timeouts=IMPATIENT), GoTo=at(3, lambda tag, asked: []))


def test_the_next_command_waits_for_the_ack():
    """Two that are asked at once come one after the other."""
    async def scene(server, cmm):
        asked = []

        async def late(tag, one):
            asked.append(one.values[0].values[0])
            await asyncio.sleep(0.05)
            assert len(asked) == len(set(asked)) == len([x for x in server.commands if x.name == 'GoTo'])
            return [Response(tag, ACK), Response(tag, DONE)]
        server.replies['GoTo'] = late
        await asyncio.gather(*(cmm.session.request(call('GoTo', call('X', float(x)))) for x in range(3)))
        assert asked == [0, 1, 2]
    run(scene)


@pytest.mark.parametrize('number', [6, 514])
@pytest.mark.parametrize('name', ['GoTo', 'PtMeas'])
def test_abortion(name, number):
    """AbortE is on the wire at once; nothing moves until the machine is told to go on, then the ball is measured.

    A command that AbortE finds waiting is refused until errors are cleared: nobody has to look for that."""
    async def scene(server, cmm):
        started = asyncio.Event()

        async def slow(tag, asked):
            if started.is_set():
                return OK
            started.set()
            running.append(tag)
            return [Response(tag, ACK)]

        running = []
        server.replies[name] = slow
        server.replies['AbortE'] = lambda tag, asked: [
            Response(tag, ACK), *error(running[0], 2, number, 'aborted')[1:], Response(tag, DONE)]
        task = asyncio.create_task(measured(cmm))
        await started.wait()
        await cmm.session.halt()
        with pytest.raises(CellError, match='aborted'):
            await task
        assert server.commands[-1].name == 'AbortE' and not cmm.session.for_person
        await no_move_after(server, cmm)
        server.replies.clear()
        await cmm.session.resume()
        found = await measured(cmm)
        assert np.linalg.norm(found.centre - [0.5325, 0.26, -0.3]) < NANOMETRE
    run(scene)


def test_a_new_run_waits_for_the_end_of_abortion():
    """A target that comes while AbortE is not done yet is measured after it, not refused."""
    async def scene(server, cmm):
        ended = asyncio.Event()

        async def late(tag, asked):
            server.send(Response(tag, ACK))
            await ended.wait()
            return [Response(tag, DONE)]
        server.replies['AbortE'] = late
        halt = asyncio.create_task(cmm.session.halt())
        while 'AbortE' not in [one.name for one in server.commands]:
            await asyncio.sleep(0)
        resume = asyncio.create_task(cmm.session.resume())
        await asyncio.sleep(0)
        with pytest.raises(DmeStopped, match='aborted'):
            await cmm.position()
        assert server.commands[-1].name == 'AbortE'
        ended.set()
        await asyncio.gather(halt, resume)
        assert server.commands[-1].name == 'ClearAllErrors'
        assert np.linalg.norm((await measured(cmm)).centre - [0.5325, 0.26, -0.3]) < NANOMETRE
    run(scene)


def test_nobody_there():
    """Said in words, with what to look at."""
    async def scene():
        with pytest.raises(DmeLost, match=r'127.0.0.1:1: expected a connection, found .*; is the I\+\+ server started'):
            await DmeSession.connect('127.0.0.1', 1, TimeoutSettings(connect_s=1.0))
    asyncio.run(scene())


@pytest.mark.parametrize(('reply', 'said'), [
    (lambda server: server.writers[-1].close(), 'the server closed the connection: it was ended or restarted'),
    (lambda server: None, r'StartSession\(\): expected its Ack within 1 s, found none')])
def test_a_server_that_another_client_uses(reply, said):
    """It closes the connection or is silent: nothing of this client moves, so there is nothing to abort."""
    async def scene(server, cmm):
        server.replies['StartSession'] = lambda tag, asked: reply(server) or []
        with pytest.raises(DmeLost, match=rf'{said}; is another client connected to the server') as caught:
            await DmeSession.connect('127.0.0.1', server.port, TimeoutSettings(**IMPATIENT))
        assert 'emergency stop' not in str(caught.value) and 'a person' not in str(caught.value)
        assert 'AbortE' not in [one.name for one in server.commands]
    run(scene)


def test_an_error_before_the_ball_is_reached():
    """It is cleared; the next ball is measured."""
    async def scene(server, cmm):
        with pytest.raises(CellError, match=r'GoTo\(X\(532.5\), Y\(260\), Z\(-240\)\): the server answered error 2500'):
            await measured(cmm)
        assert np.linalg.norm((await measured(cmm)).centre - [0.5325, 0.26, -0.3]) < NANOMETRE
    run(scene, GoTo=at(3, lambda tag, asked: error(tag, 3, 2500)))


@pytest.mark.parametrize('name', ['GoTo', 'PtMeas'])
def test_a_clamped_move_is_an_error_of_it(name):
    """In words; the tip goes up, the next ball is measured."""
    stopped_by(f'touch [0-9]+: {name}.*: error 0504 .*: clamped; expected a place that the machine '
               'reaches', person=False,
               **{name: at(4, lambda tag, asked: error(tag, 1, 504, 'clamped'))})


def test_cancelled_while_the_tool_is_changed():
    """AbortE is sent before EndSession."""
    async def scene(server, cmm):
        started = asyncio.Event()
        server.replies['ChangeTool'] = lambda tag, asked: started.set() or [Response(tag, ACK)]
        server.replies['GetProp'] = lambda tag, asked: error(tag, 3, 510) if asked.values[0].name == 'Tool.Name' else OK
        there = cmm.settings.model_copy(update={'tool': settings_of(tool={'name': 'P2', 'change': True}).tool})
        task = asyncio.create_task(prepared(there))
        await started.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert [one.name for one in server.commands][-3:] == ['ChangeTool', 'AbortE', 'EndSession']
    run(scene)


def test_a_command_that_is_aborted_and_never_ends():
    """Its end is not waited for for longer than that of AbortE."""
    async def scene(server, cmm):
        started = asyncio.Event()
        server.replies['GoTo'] = lambda tag, asked: started.set() or [Response(tag, ACK)]
        task = asyncio.create_task(measured(cmm))
        await started.wait()
        await cmm.session.halt()
        with pytest.raises(DmeStopped, match='aborted'):
            await asyncio.wait_for(task, 300.0)
    run(scene, settings_of(timeouts={'abort_s': 0.5}))


@pytest.mark.parametrize(('name', 'words'), [
    ('Get', 'X(532,50000), Y(260,00000), Z(-240,00000), R(0,00000)'), ('GetProp', 'Tool.AvrRadius("2,5")')])
def test_decimal_commas(name, words):
    """One line names the setting; nothing is measured."""
    async def scene(server, cmm):
        server.replies[name] = lambda tag, asked: (
            [Response(tag, ACK), encoded(f'{tag} # {words}'), Response(tag, DONE)])
        with pytest.raises(CellError, match='these are decimal commas: set the decimal sign of the I.. server to a po'):
            await (measured(cmm) if name == 'Get' else cmm.prepare())
        assert server.moves == []
    run(scene)

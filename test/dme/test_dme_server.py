# SPDX-License-Identifier: Apache-2.0
"""The server with the simulated machine behind it, over TCP: syntax, states, properties, moves, table, touches."""

import contextlib
import random
import re
import socket
import string
import time

import numpy as np
import pytest
from line_client import LineClient

from rosette_ros.core.run.touches import fit_spheres
from rosette_ros.dme.dme_server import ServeSettings, serving
from rosette_ros.simulation import Machine, MachineConfig

CONFIG = MachineConfig().changed(plate={'balls': 6}, probing={'repeatability_um': 0.0})


@contextlib.contextmanager
def session(**settings):
    """Yield a client in a session, and the server."""
    with serving(CONFIG, ServeSettings(**settings)) as (port, server), LineClient(port) as client:
        assert client.ask('StartSession()') == ['&', '%']
        yield client, server


@pytest.fixture(scope='module')
def served():
    """Yield a client in a session for questions that leave nothing behind."""
    with session() as (client, _):
        yield client


def axes(place):
    """Return a place as the arguments of a move."""
    return ', '.join(f'{axis}({value:.6f})' for axis, value in zip('XYZ', place, strict=True))


def touch_ball_1(client, server, points=20):
    """Touch ball 1 as the machine does and return the points (Q, 3), mm, from lines that come from outside."""
    centre = 1e3 * server.commands.cmm.cell.centres(0.0)[0]
    pattern = server.commands.cmm.cell.pattern
    client.ask('GoTo(Z(-200))')
    found = []
    for one in (pattern.direction @ pattern.axes.T)[:points]:
        for place in (centre + 40 * np.array([one[0], one[1], 1.5]), centre + 20 * one):
            assert client.ask(f'GoTo({axes(place)})') == ['&', '%']
        aim = centre + 1e3 * pattern.radius * one
        point = client.numbers(f'PtMeas({axes(aim)}, IJK({", ".join(f"{value:.9f}" for value in one)}))')
        found.append([point['X'], point['Y'], point['Z']])
        client.ask('GoTo(Z(-200))')
    return np.array(found)


@pytest.mark.parametrize('line', [
    b'1 IsHomed()\r\n', b'A4711 IsHomed()\r\n', b'04711IsHomed()\r\n', b'04711 IsHomed(\r\n', b'04711 \r\n',
    b'04711 IsHomed()\n\r\n', '04711 IsHomed(µ)\r\n'.encode()])
def test_a_line_that_is_no_command(served, line):
    served.send(line)
    assert served.line() == 'E0000 ! Error(3, 0008, "Receive", "Protocol error")'
    assert served.ask('ClearAllErrors()') == ['&', '%']


@pytest.mark.parametrize('command, number', [
    ('Launch()', 501), ('startsession()', 501), ('ReadAllTemperatures()', 501), ('StartSession()', 8),
    ('GoTo(X(441), Y())', 509), ('GoTo(X(1), X(2))', 502), ('GoTo()', 502), ('GoTo(7)', 502), ('GoTo(A(1))', 505),
    ('GoTo(X("x"))', 509), ('GoTo(X(nan))', 509), ('GoTo(X(10000))', 1008), ('GoTo(R(400))', 2505),
    ('GoTo(R(-60))', 2505), ('PtMeas(X(441))', 509), ('PtMeas(X(441),IJK(0,0,0))', 1010),
    ('PtMeas(X(441),IJK(0,0))', 509), ('PtMeas(Z(100),IJK(0,0,1))', 1006), ('Get(Q())', 510),
    ('GetProp(Tool.Colour())', 510), ('SetProp(Tool.PtMeasPar.Speed.Max(1))', 510),
    ('SetProp(Tool.PtMeasPar.Speed("x"))', 509), ('OnPtMeasReport()', 502), ('OnPtMeasReport(Colour())', 510),
    ('ChangeTool("Spoon")', 1502)])
def test_a_command_that_is_refused(served, command, number):
    assert served.error(command) == number
    assert served.ask('ClearAllErrors()') == ['&', '%']


def test_without_a_session_only_one_can_be_started():
    with serving(CONFIG) as (port, _), LineClient(port) as client:
        assert client.error('IsHomed()') == 8
        assert client.ask('ClearAllErrors()') == client.ask('EndSession()') == ['&', '%']
        assert client.ask('StartSession()') == ['&', '%']
        assert client.data('IsHomed()') == 'IsHomed(1)'


def test_an_error_has_to_be_cleared_and_a_warning_has_not(served):
    assert served.error('Launch()') == 501
    assert [served.error(one) for one in ('Get(X())', 'EndSession()', 'StartSession()')] == [514] * 3
    assert served.ask('ClearAllErrors()') == ['&', '%']
    assert served.error('SetProp(Tool.PtMeasPar.Speed(500))') == 504
    assert served.data('GetProp(Tool.PtMeasPar.Speed(), Tool.PtMeasPar.Speed.Max())') == (
        'Tool.PtMeasPar.Speed(20), Tool.PtMeasPar.Speed.Max(20)')
    assert served.ask('ChangeTool("RefTool")') == ['&', '%']
    assert served.data('GetProp(Tool.PtMeasPar.Speed(), Tool.Name())') == (
        'Tool.PtMeasPar.Speed(5), Tool.Name("RefTool")')
    assert served.ask('ChangeTool("Probe1")') == ['&', '%']


def test_a_program_error_is_answered_and_logged(monkeypatch, caplog):
    """Then the server goes on."""
    def fail(*arguments):
        raise ValueError('a number of the wrong kind')

    with session() as (client, server):
        with monkeypatch.context() as changed:
            changed.setattr(server.commands, 'carry_out', fail)
            assert client.error('GoTo(X(400))') == 511
        assert client.ask('ClearAllErrors()') == client.ask('GoTo(X(400))') == ['&', '%']
    [record] = caplog.records
    assert record.getMessage() == 'rosette dme serve: GoTo ended in a program error'
    assert 'a number of the wrong kind' in caplog.text


def test_what_a_client_asks_first(served):
    assert served.data('GetDMEVersion()') == 'DMEVersion("1.4.3")'
    assert served.data('GetMachineClass()') == 'GetMachineClass(SimulatedCartCMMWithRotaryTable)'
    assert served.data('EnumTools()') == '"Probe1" "RefTool"'
    assert served.data('GetProp(Tool.Name(), Tool.AvrRadius())') == 'Tool.Name("Probe1"), Tool.AvrRadius(2.5)'


def test_the_dialect_of_2_x():
    with session(dialect='2.x') as (client, _):
        assert client.ask('GetDMEVersion()')[1] == '#DMEVersion("2.5")'
        found = re.fullmatch(r'Name\("Part"\), Temperature\((.*)\)', client.data('ReadAllTemperatures()'))
        assert float(found[1]) == pytest.approx(20.0, abs=0.1)


def test_commands_wait_for_the_one_before_and_abort_does_not():
    with session(speed=1.0) as (client, _):
        began = time.monotonic()
        client.ask('SetProp(Tool.GoToPar.Speed(400))')
        move, ask = client.send('GoTo(X(450))'), client.send('Get(X())')
        assert [client.line() for _ in range(5)] == [
            f'{move} &', f'{ask} &', f'{move} %', f'{ask} # X(450)', f'{ask} %']
        assert time.monotonic() - began >= 100 / 400 + 400 / 1500
        move = client.send('GoTo(X(850), R(170))')
        client.until(f'{move} &')
        abort = client.send('AbortE()')
        assert client.until(f'{abort} %') == [
            f'{abort} &', f'{move} ! Error(2, 0006, "GoTo", "Transaction aborted (Use ClearAllErrors To Continue)")',
            f'{move} %', f'{abort} %']
        assert client.error('Get(X())') == 514
        client.ask('ClearAllErrors()')
        place = client.numbers('Get(X(), R())')
        assert 450 <= place['X'] < 850 and 0 <= place['R'] < 170
        assert client.numbers('Get(X(), R())') == place


def test_a_ball_in_the_way_is_hit():
    with session() as (client, server):
        x, y, z = 1e3 * server.commands.cmm.cell.centres(0.0)[0]
        assert client.ask(f'GoTo(X({x:.3f}), Y({y:.3f}), Z({z + 60:.3f}))') == ['&', '%']
        assert client.error(f'GoTo(Z({z:.3f}))') == 2504
        client.ask('ClearAllErrors()')
        assert 10.0 <= client.numbers('Get(Z())')['Z'] - z < 11.1
        assert client.ask(f'GoTo(Z({z + 60:.3f}))') == ['&', '%']  # the way back is free
        client.ask(f'GoTo(X({350 + 182.5 * np.cos(np.pi / 6):.3f}), Y({260 + 182.5 * 0.5:.3f}))')
        assert client.ask(f'GoTo(Z({z:.3f}))') == ['&', '%']  # between two balls
        assert client.error('GoTo(R(90))') == 2504
        client.ask('ClearAllErrors()')
        assert 20 < client.numbers('Get(R())')['R'] < 30


def test_the_table_takes_the_short_way_from_0_to_360():
    with session() as (client, server):
        for angle, travel in ((170, 170), (340, 340), (10, 370), (350, 350), (180, 180), (0, 360), (360, 360)):
            assert client.data(f'GoTo(R({angle}))') == ''
            assert np.rad2deg(server.commands.cmm.cell.travel) == pytest.approx(travel)
            assert client.numbers('Get(R())')['R'] == pytest.approx(angle % 360)


def test_the_table_counts_on_and_the_other_way():
    with session(cumulative=True, sign=-1) as (client, server):
        for angle in (170, 540, -90):
            assert client.data(f'GoTo(R({angle}))') == ''
            assert client.numbers('Get(R())')['R'] == angle
            assert np.rad2deg(server.commands.cmm.cell.travel) == pytest.approx(-angle)


@pytest.mark.parametrize('is_compensated, radius', [(False, 10.0), (True, 7.5)])
def test_a_sphere_is_measured(is_compensated, radius):
    with session(compensated=is_compensated) as (client, server):
        points = touch_ball_1(client, server)
        sphere = fit_spheres(1e-3 * points[None])
        reading = Machine(CONFIG).measure(1, 1, aim=server.commands.cmm.cell.centres(0.0)[0])
        np.testing.assert_allclose(sphere.centre[0], reading.centre, rtol=0, atol=1e-10)  # lines have 9 decimals
        assert sphere.form[0] == pytest.approx(reading.form_error, abs=1e-10)
        assert 1e3 * sphere.distance[0] == pytest.approx([radius] * 20, abs=5e-5)


def test_a_touch_is_reported_before_the_retract():
    """I++ DME 1.4.3, 6.3.2.13: the place is latched and reported, then the tip goes back; only then all is done."""
    with session(speed=1.0) as (client, server):
        x, y, z = 1e3 * server.commands.cmm.cell.centres(0.0)[0]
        server.commands.cmm.parked = 1e-3 * np.array([x, y, z + 16.0])
        client.ask('SetProp(Tool.PtMeasPar.Approach(4), Tool.PtMeasPar.Retract(4))')
        touch = f'PtMeas(Z({z + 7.5:.3f}), IJK(0, 0, 1))'
        latched = client.numbers(touch)['Z']
        assert client.numbers('Get(Z())')['Z'] == pytest.approx(latched + 4.0, abs=1e-3)
        client.ask('SetProp(Tool.GoToPar.Speed(1))')  # the retract takes 4 s
        tag = client.send(touch)
        client.until(f'{tag} #')
        abort = client.send('AbortE()')
        assert [line[:7] for line in client.until(f'{abort} %')] == [f'{abort} &', f'{tag} !', f'{tag} %', f'{abort} %']
        client.ask('ClearAllErrors()')
        assert client.numbers('Get(Z())')['Z'] < latched + 3.0


def test_the_machine_stays_as_it_was_for_the_next_client():
    with serving(CONFIG) as (port, _):
        for before, after in ((350, 100), (100, 0)):
            with LineClient(port) as client:
                client.ask('StartSession()')
                assert client.numbers('Get(X())')['X'] == before
                client.ask(f'GoTo(X({after}))')


def test_a_client_that_leaves_stops_the_machine(wait_until):
    """In the middle of a move; the next client finds it there, in no session, and moves it on."""
    with serving(CONFIG, ServeSettings(speed=1.0)) as (port, server):
        with LineClient(port) as client:
            client.ask('StartSession()')
            client.until(f'{client.send("GoTo(X(850))")} &')
            wait_until(lambda: server.commands.cmm.place[0] > 0.351)
        wait_until(lambda: not server._free.locked())
        place = server.commands.cmm.place
        assert 0.351 < place[0] < 0.85
        with LineClient(port) as client:
            assert client.error('Get(X())') == 8
            client.ask('StartSession()')
            assert client.numbers('Get(X())')['X'] == pytest.approx(1e3 * place[0])


def test_the_report_holds_what_was_asked_for(served):
    assert served.data('OnPtMeasReport(R(), IJK(), Z())') == ''
    served.ask('GoTo(X(532.8), Y(259.7), Z(-250))')
    names = re.findall(r'([A-Z]+)\(', served.data('PtMeas(Z(-292), IJK(0, 0, 2))'))
    assert names == ['R', 'IJK', 'Z']


def test_the_next_client_waits():
    with session() as (client, server), LineClient(server._server.sockets[0].getsockname()[1]) as second:
        tag = second.send('StartSession()')
        assert client.data('IsHomed()') == 'IsHomed(1)'
        client._socket.shutdown(socket.SHUT_RDWR)
        assert second.until(f'{tag} %') == [f'{tag} &', f'{tag} %']


def test_10_000_lines_that_are_made_up():
    """Each is answered in the protocol, and the server is as before; the seed is fixed."""
    draw = random.Random(5)
    whole = ['GoTo(X(1), Y(2.5e1), R(60))', 'PtMeas(Z(-292), IJK(0, 0, 1))', 'SetProp(Tool.PtMeasPar.Speed(3))',
             'Get(X(), Y())', 'AbortE()', 'OnPtMeasReport(X(), IJK())', 'ChangeTool("RefTool")', 'ClearAllErrors()',
             'GetProp(Tool.Name())', 'StartSession()']
    with session() as (client, server):
        for batch in range(1000):
            lines = []
            for number in range(10):
                text = draw.choice(whole)
                tag = f'{"E" if text.split("(")[0].endswith("E") else "0"}{number + 1:04d}'
                signs = list(f'{tag} {text}')
                for _ in range(draw.choice((0, 1, 1, 2, 8))):
                    signs[draw.randrange(len(signs))] = draw.choice(string.printable + 'µ\x00()')
                lines.append(''.join(signs).encode('latin-1') + b'\r\n')
            client.send(b''.join(lines))
            client._tag = 10000 + 2 * batch
            tag = client.send('ClearAllErrors()')
            for line in client.until(f'{tag} %'):
                assert re.fullmatch(r'([0-9]{5}|E[0-9]{4}) (&|%|# .*|! Error\([0-39], [0-9]{4}, ".*", ".*"\))', line)
        if client.ask('StartSession()')[1:-1]:  # it was open
            client.ask('ClearAllErrors()')
        assert client.data('IsHomed()') == 'IsHomed(1)'
        assert server.sessions == 1

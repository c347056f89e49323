# SPDX-License-Identifier: Apache-2.0
"""The server with the simulated machine behind it, over TCP: syntax, states, properties, moves, table, touches."""

import contextlib
import re
import time
import tracemalloc

import numpy as np
import pytest
from line_client import LineClient

from rosette_ros.core.errors import CellError
from rosette_ros.core.touches import fit_spheres
from rosette_ros.dme.dme_server import check_loopback, serving
from rosette_ros.dme.serve_settings import ServeSettings
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


@pytest.mark.parametrize('line, answers', [
    (b'1 StartSession()\r\n', ['E0000 ! Error(2, 0001, "Receive", "Illegal tag")']),
    (b'00000 IsHomed()\r\n', ['E0000 ! Error(2, 0001, "Receive", "Illegal tag")']),
    (b'A4711 IsHomed()\r\n', ['E0000 ! Error(2, 0001, "Receive", "Illegal tag")']),
    (b'04711IsHomed()\r\n', ['04711 &', '04711 ! Error(2, 0002, "Receive", "No space at pos. 6")', '04711 %']),
    (b'04711 IsHomed(\r\n', ['04711 &', '04711 ! Error(3, 0008, "Receive", "Protocol error")', '04711 %']),
    (b'04711 \r\n', ['04711 &', '04711 ! Error(3, 0008, "Receive", "Protocol error")', '04711 %']),
    (b'04711 IsHomed()\n\r\n', ['E0000 ! Error(3, 0007, "Receive", "Illegal character")']),
    ('04711 IsHomed(µ)\r\n'.encode(), ['E0000 ! Error(3, 0007, "Receive", "Illegal character")']),
    (b'04711 GetErrStatusE()\r\n', ['04711 &', '04711 ! Error(2, 0001, "GetErrStatusE", "Illegal tag")', '04711 %']),
    (b'E4711 IsHomed()\r\n', ['E4711 &', 'E4711 ! Error(2, 0001, "IsHomed", "Illegal tag")', 'E4711 %']),
])
def test_a_line_that_is_no_command(served, line, answers):
    served.send(line)
    assert [served.line() for _ in answers] == answers
    assert served.ask('ClearAllErrors()') == ['&', '%']


@pytest.mark.parametrize('command, number', [
    ('Launch()', 501), ('startsession()', 501), ('ReadAllTemperatures()', 501), ('StartSession()', 8),
    ('GoTo(X(441), Y())', 502), ('GoTo(X(1), X(2))', 502), ('GoTo()', 502), ('GoTo(7)', 502), ('GoTo(A(1))', 505),
    ('GoTo(X("1"))', 509), ('GoTo(X(nan))', 509), ('GoTo(X(10000))', 1008), ('GoTo(R(400))', 2505),
    ('GoTo(R(-60))', 2505), ('PtMeas(IJK(0,0,1))', 502), ('PtMeas(X(441),IJK(0,0,0))', 1010),
    ('PtMeas(X(441),IJK(0,0))', 502), ('PtMeas(Z(100),IJK(0,0,1))', 1006), ('Get(Q())', 506), ('Get(X(1))', 506),
    ('GetProp(Tool.Colour())', 510), ('GetProp(FoundTool.Name())', 1503), ('GetProp(Table.Speed())', 510),
    ('SetProp(Tool.PtMeasPar.Speed.Max(1))', 510), ('SetProp(Tool.PtMeasPar.Speed("x"))', 509),
    ('EnumProp(Tool.Colour())', 510), ('OnPtMeasReport()', 502), ('OnPtMeasReport(Colour())', 510),
    ('SetCoordSystem("MachineCsy")', 509), ('ChangeTool("Spoon")', 1502), ('ChangeTool(Probe1)', 509),
    ('FindTool("Spoon")', 1502), ('AlignPart(1,0,0)', 502), ('AlignPart(0,0,1,1,0,0,0)', 1010),
    ('StopDaemon(E0001)', 513), ('IsHomed(1)', 502), ('ClearAllErrors(1)', 502)])
def test_a_command_that_is_refused(served, command, number):
    assert served.error(command) == number
    assert served.ask('ClearAllErrors()') == ['&', '%']


def test_without_a_session_only_one_can_be_started():
    with serving(CONFIG) as (port, _), LineClient(port) as client:
        assert client.error('IsHomed()') == 8
        assert client.ask('EndSession()') == ['&', '%']
        assert client.ask('StartSession()') == ['&', '%']
        assert client.data('IsHomed()') == 'IsHomed(1)'
        assert client.ask('EndSession()') == ['&', '%']
        assert client.error('IsHomed()') == 8


def test_an_error_has_to_be_cleared():
    with session() as (client, _):
        assert client.error('Launch()') == 501
        assert [client.error(one) for one in ('Get(X())', 'EndSession()', 'Home()', 'StartSession()')] == [514] * 4
        assert client.data('GetErrStatusE()') == 'ErrStatus(1)'
        assert client.data('GetXtdErrStatus()') == 'IsHomed(1) IsUserEnabled(1)'
        assert client.ask('ClearAllErrors()') == ['&', '%']
        assert client.data('Get(X())') == 'X(350)'


@pytest.mark.parametrize('command, method', [('GoTo(X(400))', 'carry_out'), ('GetPropE(Tool.Id())', 'answer')])
def test_a_program_error_is_answered_and_logged(monkeypatch, caplog, command, method):
    """Then the server goes on."""
    def fail(*arguments):
        raise ValueError('a number of the wrong kind')

    with session() as (client, server):
        with monkeypatch.context() as changed:
            changed.setattr(server.commands, method, fail)
            assert client.error(command) == 511
        assert client.ask('AbortE()') == client.ask('ClearAllErrors()') == ['&', '%']
        assert client.ask('GoTo(X(400))') == ['&', '%']
    [record] = caplog.records
    assert record.getMessage() == f'rosette dme serve: {command.partition("(")[0]} ended in a program error'
    assert 'a number of the wrong kind' in caplog.text


def test_a_warning_has_not(served):
    assert served.error('SetProp(Tool.PtMeasPar.Speed(500))') == 504
    assert served.data('GetProp(Tool.PtMeasPar.Speed(), Tool.PtMeasPar.Speed.Max(), Tool.PtMeasPar.Speed.Def())') == (
        'Tool.PtMeasPar.Speed(20), Tool.PtMeasPar.Speed.Max(20), Tool.PtMeasPar.Speed.Def(5)')
    assert served.error('StopAllDaemons()') == 512
    assert served.data('IsHomed()') == 'IsHomed(1)'


def test_what_a_client_asks_first(served):
    assert served.data('GetDMEVersion()') == 'DMEVersion("1.4.3")'
    assert served.data('GetMachineClass()') == 'GetMachineClass(SimulatedCartCMMWithRotaryTable)'
    assert served.data('EnumTools()') == '"RefTool" "NoTool" "Probe1" "Unqualified"'
    assert served.data('GetProp(Tool.Name(), Tool.AvrRadius())') == 'Tool.Name("Probe1"), Tool.AvrRadius(2.5)'
    assert served.data('GetCoordSystem()') == 'CoordSystem(MachineCsy)'
    assert served.data('EnumProp(Tool())') == (
        '"Name", "String" "Id", "String" "AvrRadius", "Number" "GoToPar", "Property" "PtMeasPar", "Property"')
    assert '"Retract.Min", "Number"' in served.data('EnumAllProp(Tool.PtMeasPar())')
    assert served.data('GetErrorInfo(1006)') == '"Surface not found"'
    assert [served.data(one) for one in ('EnableUser()', 'IsUserEnabled()', 'DisableUser()', 'IsUserEnabled()')] == [
        '', 'IsUserEnabled(1)', '', 'IsUserEnabled(0)']


def test_a_tool_brings_its_own_parameters():
    with session() as (client, _):
        client.ask('SetProp(Tool.GoToPar.Speed(20), Tool.PtMeasPar.Search(9))')
        assert client.data('FindTool("NoTool")') == client.data('ChangeTool("RefTool")') == ''
        assert client.data('GetProp(Tool.GoToPar.Speed(), FoundTool.Name())') == (
            'Tool.GoToPar.Speed(60), FoundTool.Name("NoTool")')
        assert client.data('SetTool("Unqualified")') == ''
        assert client.error('PtMeas(Z(0), IJK(0,0,1))') == 2000


def test_the_dialect_of_2_x():
    with session(dialect='2.x') as (client, _):
        assert client.ask('GetDMEVersion()')[1] == '#DMEVersion("2.5")'
        assert client.data('EnableRotaryTableVarCsy(0)') == ''
        name, temperature = re.fullmatch(r'Name\("(\w+)"\), Temperature\((.*)\)',
                                         client.data('ReadAllTemperatures()')).groups()
        assert client.data(f'ReadTemperatureSensor("{name}")') == temperature
        assert float(temperature) == pytest.approx(20.0, abs=0.1)
        assert client.data('ReadTemperatureSensor("Spoon")') == '-273'


def test_answers_come_while_the_machine_moves_and_end_when_it_stands():
    with session(speed=20.0) as (client, _):
        client.ask('SetProp(Tool.GoToPar.Speed(200))')
        began = time.monotonic()
        move, ask = client.send('GoTo(X(750))'), client.send('Get(X())')
        assert [client.line(), client.line()] == [f'{move} &', f'{ask} &']
        assert client.numbers('GetPropE(Tool.GoToPar.Speed())')['Speed'] == 200
        assert [client.line() for _ in range(3)] == [f'{move} %', f'{ask} # X(750)', f'{ask} %']
        assert time.monotonic() - began >= (400 / 200 + 200 / 1500) / 20


def test_abort_stops_the_machine_where_it_is():
    with session(speed=1.0) as (client, _):
        move, ask = client.send('GoTo(X(850), R(170))'), client.send('Get(X())')
        client.until(f'{ask} &')
        daemon = client.send('OnMoveReportE(Time(0.1), X())')
        assert client.until(f'{daemon} #')[-1].startswith(f'{daemon} # X(')
        abort = client.send('AbortE()')
        assert client.until(f'{abort} %') == [
            f'{abort} &', f'{move} ! Error(2, 0006, "GoTo", "Transaction aborted (Use ClearAllErrors To Continue)")',
            f'{move} %', f'{ask} ! Error(2, 0006, "Get", "Transaction aborted (Use ClearAllErrors To Continue)")',
            f'{ask} %', f'{abort} %']
        assert client.until(f'{daemon} #')
        tag = client.send('Home()')
        assert '0514' in client.until(f'{tag} %')[-2]
        client.until(f'{client.send("ClearAllErrors()")} %')
        client.until(f'{client.send(f"StopDaemon({daemon})")} %')
        place = client.numbers('Get(X(), R())')
        assert 350 < place['X'] < 850 and 0 < place['R'] < 170
        assert client.numbers('Get(X(), R())') == place


def test_abort_overtakes_commands_that_are_not_acknowledged():
    """However many wait: one moves, eight wait, the rest has no Ack yet; all are aborted in their order."""
    with session(speed=1.0) as (client, server):
        tags = [client.send('GoTo(X(850))') for _ in range(20)]
        assert [client.line() for _ in range(9)] == [f'{tag} &' for tag in tags[:9]]
        tag = client.send('AbortE()')
        lines = client.until(f'{tag} %')
        assert lines[0] == f'{tag} &'
        assert [line[:7] for line in lines if line.endswith('%')] == [f'{one} %' for one in [*tags, tag]]
        assert [line[:5] for line in lines if line.endswith('&')] == [tag, *tags[9:]]
        assert sum('Error(2, 0006' in line for line in lines) == 20
        assert server.commands.cmm.moved == 1


def test_what_is_in_the_way_is_hit():
    with session() as (client, server):
        x, y, z = 1e3 * server.commands.cmm.cell.centres(0.0)[0]
        assert client.ask(f'GoTo(X({x:.3f}), Y({y:.3f}), Z({z + 60:.3f}))') == ['&', '%']
        assert client.error(f'GoTo(Z({z:.3f}))') == 2504
        client.ask('ClearAllErrors()')
        assert 10.0 <= client.numbers('Get(Z())')['Z'] - z < 11.1
        assert client.ask(f'GoTo(Z({z + 60:.3f}))') == ['&', '%']  # the way back is free
        # Beside the ball down to its stem, then into it; then the plate under the balls, then the table turns.
        client.ask(f'GoTo(X({x - 30:.3f}))')
        assert client.ask(f'GoTo(Z({z - 18:.3f}))') == ['&', '%']
        assert client.error(f'GoTo(X({x:.3f}))') == 2504
        client.ask('ClearAllErrors()')
        assert 2.5 + 0.35 * 7.5 <= x - client.numbers('Get(X())')['X'] < 2.5 + 0.35 * 7.5 + 1.1
        client.ask(f'GoTo(X({x - 30:.3f}))')
        assert client.error(f'GoTo(Z({z - 60:.3f}))') == 2504
        client.ask('ClearAllErrors()')
        assert -27.6 < client.numbers('Get(Z())')['Z'] - z < -26.4
        client.ask(f'GoTo(X({350 + 182.5 * np.cos(np.pi / 6):.3f}), Y({260 + 182.5 * 0.5:.3f}), Z({z:.3f}))')
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


def test_the_table_is_not_turned_by_more_than_a_hundred_turns_at_once():
    """Beside the balls, where the whole way is looked at: that takes 2 MB, in one piece 78 MB."""
    with session(cumulative=True) as (client, server):
        x, y, z = 1e3 * server.commands.cmm.machine.rough_frame.origin
        client.ask(f'GoTo({axes((x, y, z + 15))})')
        for angle in (36001, -36001, 1e17):
            assert client.error(f'GoTo(R({angle:.0f}))') == 2505
            client.ask('ClearAllErrors()')
        tracemalloc.start()
        try:
            for angle in (36000, 72000, 36000):
                assert client.data(f'GoTo(R({angle}))') == ''
                assert client.numbers('Get(R())')['R'] == angle
            assert tracemalloc.get_traced_memory()[1] < 10e6
        finally:
            tracemalloc.stop()


def test_the_part_is_aligned():
    with session() as (client, server):
        assert client.data('AlignPart(1,0,0, 0,2,0, 0)') == '1, 0, 0, 0, 1, 0'
        assert np.rad2deg(server.commands.cmm.cell.travel) == pytest.approx(90)
        assert client.data('AlignPart(1,0,0, 0,-1,0.5, 0)') == '1, 0, 0, 0, -1, 0'
        assert abs(np.rad2deg(server.commands.cmm.cell.travel)) - 90 == pytest.approx(180) or (
            np.rad2deg(server.commands.cmm.cell.travel) == pytest.approx(-90))


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


def test_the_report_holds_what_was_asked_for(served):
    assert served.data('OnPtMeasReport(R(), IJK(), Z(), ER(), Q())') == ''
    served.ask('GoTo(X(532.8), Y(259.7), Z(-250))')
    names = re.findall(r'([A-Z]+)\(', served.data('PtMeas(Z(-292), IJK(0, 0, 2))'))
    assert names == ['R', 'IJK', 'Z', 'ER', 'Q']


def test_only_the_loopback_address_is_served():
    for host in ('127.0.0.1', 'localhost', '::1', '127.9.9.9'):
        check_loopback(host)
    for host in ('0.0.0.0', '', '::', '192.168.1.7', 'cmm.example'):
        with pytest.raises(CellError, match=re.escape(f'host: wanted the loopback address 127.0.0.1, got {host!r}; the '
                                                      'simulated machine is for clients on this computer only')):
            check_loopback(host)
    with serving(CONFIG) as (port, server):
        assert [one.getsockname()[0] for one in server._server.sockets] == ['127.0.0.1']
        with pytest.raises(CellError, match=f'port: wanted a free one, got {port}: .*choose another one with --port'):
            with serving(CONFIG, port=port):
                pass


def test_one_client_at_a_time():
    with session() as (client, server):
        with LineClient(server._server.sockets[0].getsockname()[1]) as second:
            assert second.until('E0000') == ['E0000 ! Error(3, 0008, "Connect", "Protocol error")']
            assert second.line() == ''
        assert client.data('IsHomed()') == 'IsHomed(1)'


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

# SPDX-License-Identifier: Apache-2.0
"""Every fault of the server, as a client sees it."""

import contextlib
import random
import re
import string
import time
from pathlib import Path

import numpy as np
import pytest
from line_client import LineClient

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.dme.dme_server import serving
from rosette_ros.dme.serve_settings import KINDS, DmeFault, DmeFaults, ServeSettings, fault_of
from rosette_ros.simulation import MachineConfig
from rosette_ros.simulation.setting_types import checked

CONFIG = MachineConfig().changed(plate={'balls': 6}, probing={'repeatability_um': 0.0})
TOUCH = 'PtMeas(Z(-292), IJK(0, 0, 1))'
"""From above on ball 1, over which every test begins."""


@contextlib.contextmanager
def over_ball_1(*faults, **settings):
    """Yield a client in a session with the probe over ball 1, and the server, which has these faults."""
    made = ServeSettings(faults=tuple(fault_of(fault) for fault in faults), **settings)
    with serving(CONFIG, made) as (port, server), LineClient(port) as client:
        client.ask('StartSession()')
        server.commands.cmm.parked = server.commands.cmm.cell.centres(0.0)[0] + [0, 0, 0.03]
        yield client, server


def test_a_surface_is_not_found_on_one_ball():
    with over_ball_1('surface_not_found:ball=1,at=2,times=1') as (client, server):
        assert client.numbers(TOUCH)['Z'] < -280
        assert client.error(TOUCH) == 1006
        client.ask('ClearAllErrors()')
        assert client.numbers('Get(Z())')['Z'] == pytest.approx(-292 + 3 + 2.5)  # back at the approach
        assert client.numbers(TOUCH)['Z'] < -280
        assert server.commands.faults.struck == 1


@pytest.mark.parametrize('fault, error', [('collision', 2504), ('out_of_limits', 2500)])
def test_a_move_ends_half_way(fault, error):
    with over_ball_1(f'{fault}:at=2,times=1') as (client, _):
        client.ask('GoTo(Z(-200))')
        assert client.error('GoTo(Z(-100))') == error
        client.ask('ClearAllErrors()')
        assert client.numbers('Get(Z())')['Z'] == -150
        assert client.ask('GoTo(Z(-100))') == ['&', '%']


def test_an_emergency_stop():
    with over_ball_1('emergency_stop:at=2') as (client, server):
        client.ask('GoTo(Z(-200))')
        moved, tag = server.commands.cmm.moved, client.send('GoTo(Z(-100))')
        assert client.until(f'{tag} %') == [
            f'{tag} &', 'E0000 ! Error(3, 0500, "HealthCheck", "Emergency stop")',
            f'{tag} ! Error(2, 0006, "GoTo", "Transaction aborted (Use ClearAllErrors To Continue)")', f'{tag} %']
        assert client.error('GoTo(Z(-100))') == 514
        assert server.commands.cmm.moved == moved
        client.ask('ClearAllErrors()')
        assert client.ask('GoTo(Z(-100))') == ['&', '%']


def test_parameters_are_clamped():
    with over_ball_1('clamped') as (client, _):
        assert client.error('SetProp(Tool.GoToPar.Speed(100))') == 504
        assert client.numbers('GetProp(Tool.GoToPar.Speed())')['Speed'] == 66


@pytest.mark.parametrize('fault, command, error', [
    ('not_qualified', TOUCH, 2000), ('not_homed', 'GoTo(Z(-200))', 1005), ('r_limited', 'GoTo(R(-60))', 2505)])
def test_a_command_is_refused(fault, command, error):
    with over_ball_1(fault, cumulative=True) as (client, _):
        assert client.error(command) == error
        client.ask('ClearAllErrors()')
        if fault == 'not_homed':
            assert client.data('IsHomed()') == 'IsHomed(0)'
            assert client.ask('Home()') == ['&', '%']
            assert client.data('IsHomed()') == 'IsHomed(1)'


def test_the_table_turns_the_other_way():
    with over_ball_1('turns_other_way') as (client, server):
        before = server.commands.cmm.cell.centres(0.0)
        client.ask('GoTo(Z(-100))')
        client.ask('GoTo(R(60))')
        assert client.numbers('Get(R())')['R'] == 60
        np.testing.assert_allclose(server.commands.cmm.cell.centres(0.0)[1], before[0], atol=1e-3)


def test_lengths_in_inches():
    with over_ball_1('inch') as (client, server):
        z = 1e3 * server.commands.cmm.place[2] / 25.4
        assert client.numbers('Get(Z())')['Z'] == pytest.approx(z)
        assert client.numbers('GetProp(Tool.AvrRadius())')['AvrRadius'] == pytest.approx(2.5 / 25.4)
        client.ask(f'GoTo(Z({z + 1}))')
        assert client.numbers('Get(Z())')['Z'] == pytest.approx(z + 1)
        assert client.error('GoTo(Z(-100))') == 1008


def test_no_sensor():
    with over_ball_1('no_sensor', dialect='2.x') as (client, _):
        assert client.data('ReadTemperatureSensor("Part")') == '-273'


def test_fields_in_another_order():
    with over_ball_1('reordered') as (client, _):
        assert re.findall(r'([A-Z])\(', client.data('Get(X(), Y(), R())')) == ['R', 'Y', 'X']


def test_numbers_in_quotes():
    with over_ball_1('quoted') as (client, _):
        assert re.fullmatch(r'X\("[0-9.]+"\), R\("0"\)', client.data('Get(X(), R())'))
        assert client.ask('Launch()')[1] == '! Error(3, "0501", "Launch", "Unsupported command")'


def test_not_a_number():
    with over_ball_1('nan:at=2') as (client, _):
        assert client.data(TOUCH).startswith('X(5')
        assert client.data(TOUCH).startswith('X(nan), Y(2')
        assert client.data(TOUCH).startswith('X(5')


def test_a_wrong_tag():
    with over_ball_1('wrong_tag:at=2') as (client, _):
        client.ask(TOUCH)
        tag = client.send(TOUCH)
        assert [line[:7] for line in client.until(f'{tag} %')] == [f'{tag} &', f'{int(tag) + 1:05d} #', f'{tag} %']


def test_garbage():
    with over_ball_1('garbage') as (client, _):
        answers = client.ask(TOUCH)
        assert not answers[1].isascii()
        assert [answers[0], answers[2][0], answers[3]] == ['&', '#', '%']


def test_an_error_that_nobody_asked_for():
    with over_ball_1('unsolicited') as (client, _):
        assert client.ask(TOUCH)[2] == 'E0000 ! Error(3, 1009, "HealthCheck", "Air pressure out of range")'
        assert client.error(TOUCH) == 514


def test_abort_that_is_ignored():
    with over_ball_1('abort_ignored', speed=5.0) as (client, _):
        move = client.send('GoTo(Z(-200))')
        client.until(f'{move} &')
        abort = client.send('AbortE()')
        assert client.until(f'{move} %') == [f'{abort} &', f'{move} %']
        assert client.numbers('Get(Z())')['Z'] == -200


@pytest.mark.parametrize('fault', ['split:seconds=0.02', 'joined', 'slow:seconds=0.02'])
def test_packets_that_are_no_lines(fault):
    """What a client reads is the same; how it comes is seen in the packets."""
    with over_ball_1(fault) as (client, _):
        began = time.monotonic()
        tag = client.send('Get(R())')
        packets = []
        while not packets or not packets[-1].endswith(b'%\r\n'):
            packets.append(client._socket.recv(4096))
        assert b''.join(packets).decode() == f'{tag} &\r\n{tag} # R(0)\r\n{tag} %\r\n'
        if fault == 'joined':
            assert len(packets) == 1
        else:
            assert time.monotonic() - began >= 0.06
        assert not fault.startswith('split') or not packets[0].endswith(b'\n')


def test_a_connection_that_says_nothing_more():
    with over_ball_1('half_open:at=2') as (client, _):
        client.ask(TOUCH)
        tag = client.send(TOUCH)
        assert client.line() == f'{tag} &'
        client._socket.settimeout(0.1)
        with pytest.raises(TimeoutError):
            client._socket.recv(1)


def test_a_restart_in_the_middle():
    with over_ball_1('restart:at=2') as (client, server):
        client.ask(TOUCH)
        tag = client.send(TOUCH)
        assert client.line() == f'{tag} &'
        with contextlib.suppress(ConnectionError):
            assert client.line() == ''
        with LineClient(server._server.sockets[0].getsockname()[1]) as again:
            assert again.error('Get(X())') == 8
            assert again.ask('StartSession()') == ['&', '%']
            assert again.numbers(TOUCH)['Z'] < -280
            assert server.sessions == 2


def test_all_kinds_are_tried():
    assert [kind for kind in KINDS if f"'{kind}" not in Path(__file__).read_text(encoding='utf-8')] == []


def test_occasions_are_counted():
    faults = DmeFaults([DmeFault(kind='nan', at=2, times=2), DmeFault(kind='surface_not_found', ball=3)])
    assert [faults.strike('nan') is not None for _ in range(5)] == [False, True, True, False, False]
    assert [faults.strike('surface_not_found', ball) is not None for ball in (1, 3, 2, 3)] == [False, True] * 2
    assert faults.struck == 4


@pytest.mark.parametrize('text, complaint', [
    ('spoon', r"fault 'spoon': kind: wanted one of surface_not_found, .*, restart, got 'spoon'"),
    ('nan:at=0', "fault 'nan:at=0': at: wanted greater than or equal to 1, got 0"),
    ('nan:at=x', "fault: wanted at=NUMBER, got 'at=x' in 'nan:at=x'"),
    ('collision:ball=5', "fault '.*': ball: wanted it with surface_not_found only, got it with collision"),
    ('nan:after=2', "fault 'nan:after=2': after: wanted one of .*, got 'after'")])
def test_no_fault(text, complaint):
    with pytest.raises(InvalidConfig, match=complaint):
        fault_of(text)


@pytest.mark.parametrize('name, value, complaint', [
    ('sign', 0, 'sign: wanted one of -1, 1, got 0'), ('tool', 'a"b c', "tool: wanted .* got 'a\"b c'"),
    ('tool', 'Probe1\n', 'tool: wanted .* got'), ('tool', '1', 'tool: wanted .* got')])
def test_no_settings(name, value, complaint):
    """A table turns one way or the other; the name of a tool is a word."""
    with pytest.raises(InvalidConfig, match=f'^server: {complaint}'):
        checked(ServeSettings, {name: value}, 'server')


def test_10_000_lines_that_are_made_up():
    """Each is answered in the protocol, and the server is as before; the seed is fixed."""
    draw = random.Random(5)
    whole = ['GoTo(X(1), Y(2.5e1), R(60))', TOUCH, 'SetProp(Tool.PtMeasPar.Speed(3))', 'Get(X(), Y())', 'AbortE()',
             'OnPtMeasReport(X(), IJK())', 'AlignPart(1,0,0,0,1,0,0)', 'ChangeTool("RefTool")', 'ClearAllErrors()',
             'EnumAllProp(Tool())', 'StartSession()', 'GetErrorInfo(1006)', 'OnMoveReportE(Time(1), X())']
    with over_ball_1() as (client, server):
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
            tag = client.send('ClearAllErrors()')  # is aborted if an error comes before it
            for line in client.until(f'{tag} %'):
                assert re.fullmatch(r'([0-9]{5}|E[0-9]{4}) (&|%|# .*|! Error\([0-39], [0-9]{4}, ".*", ".*"\))', line)
            client.ask('ClearAllErrors()')
        assert '# IsHomed(1)' in client.ask('IsHomed()')  # a report of OnMoveReportE may come between
        assert server.sessions == 1

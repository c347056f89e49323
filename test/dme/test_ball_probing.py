# SPDX-License-Identifier: Apache-2.0
"""One ball by an ideal machine over TCP: what is asked before, tables of all kinds, what is measured and refused."""

import math

import numpy as np
import pytest
from scripted_server import OK, error, measured, run, settings_of

from rosette_ros.core.run.errors import CellError, InvalidPlan
from rosette_ros.dme.wire import ACK, DATA, DONE, Response, call, encoded

NANOMETRE = 1e-9


def test_clamped_arguments_are_told():
    """The server's value counts."""
    async def scene(server, cmm):
        assert cmm.remarks == ['Tool.GoToPar.Speed: asked 200, the server has 50']

    def clamps(tag, asked):
        if asked.values[0].name == 'Tool.GoToPar.Speed':
            return [*error(tag, 1, 504, 'clamped')[:-1], Response(tag, DONE)]
        return OK
    asked = []
    run(scene, settings_of(motion={'speed_mm_s': 200.0}), SetProp=clamps,
        GetProp=lambda tag, one: asked.append(one) or (
            [Response(tag, ACK), Response(tag, DATA, (call('Tool.GoToPar.Speed', 50.0),)), Response(tag, DONE)]
            if 'GoToPar' in one.values[0].name else OK))


@pytest.mark.parametrize(('changes', 'replies', 'said'), [
    ({}, {'IsHomed': lambda tag, asked: [Response(tag, ACK), encoded(f'{tag} # IsHomed(0)'), Response(tag, DONE)]},
     'expected a homed machine'),
    ({}, {'SetCoordSystem': lambda tag, asked: error(tag, 2, 514, 'Use ClearAllErrors')}, 'error 0514 .*a person has'),
    ({}, {'GetMachineClass': lambda tag, asked: [
        Response(tag, ACK), encoded(f'{tag} # GetMachineClass(SimulatedCMM)'), Response(tag, DONE)]},
     'expected "simulated: true" in the settings, since the server says that its machine is simulated'),
    ({'tool': {'name': 'P2'}}, {'SetTool': lambda tag, asked: error(tag, 3, 1502, 'Tool not found')},
     r'SetTool\("P2"\): the server answered error 1502'),
    ({'tool': {'tip_radius_mm': 1.5}}, {}, r'expected a tip radius of 1.5 mm \(tool.tip_radius_mm\), found 2.5'),
    ({}, {'StartSession': lambda tag, asked: error(tag, 3, 508, 'Bad context')}, 'error 0508'),
])
def test_a_machine_that_is_not_ready(changes, replies, said):
    """It is not connected, and nothing has moved."""
    async def scene(server, cmm):
        raise AssertionError
    with pytest.raises(CellError, match=said):
        run(scene, settings_of(**changes), **replies)


def test_an_old_server():
    """One of 1.4: no temperatures, no properties of the tool, no IsHomed: it measures all the same."""
    async def scene(server, cmm):
        found = [await measured(cmm), await measured(cmm)]
        assert all(math.isnan(one.temperature) for one in found)
        assert [one.name for one in server.commands].count('ReadAllTemperatures') == 1
    refused = {name: lambda tag, asked: error(tag, 3, 501, 'Unsupported command')
               for name in ('IsHomed', 'ReadAllTemperatures', 'GetProp')}
    run(scene, **refused)


def test_tables_that_turn_the_other_way():
    """R that moves against its command is refused at once."""
    async def scene(server, cmm):
        server.turns = -1
        with pytest.raises(CellError, match='expected the table at 60.0000 deg, found -60.0000 from R; see table.sign'):
            await measured(cmm, position=2)
        assert 'PtMeas' not in [one.name for one in server.commands]
    run(scene)


@pytest.mark.parametrize('changes', [
    {'sign': -1}, {'zero_deg': 90.0}, {'reading': 'cumulative'}, {'limits_deg': [0, 360]}, {'turn': 'align'},
    {'sign': -1, 'limits_deg': [-180, 180]}])
def test_tables_of_all_kinds(changes):
    """Two turns forward, one back: travel and sense are those that were asked."""
    settings = settings_of(table=changes)

    async def scene(server, cmm):
        table = settings.table
        real = type(server).balls

        def balls(self):  # the ring has six places alike: the angle of R does not matter
            r, self.r = self.r, (self.r - table.zero_deg) * table.sign
            try:
                return real(self)
            finally:
                self.r = r
        server.balls = balls.__get__(server)
        server.r = table.zero_deg
        cmm.table.angle = 0.0
        travel = []
        for position, sense in [(1, 1), (3, 1), (5, 1), (1, 1), (3, 1), (1, -1), (5, -1)]:
            found = await measured(cmm, 2, position, sense)
            travel.append(found.table_travel)
            assert abs(found.table_angle - np.pi / 3 * (position - 1)) < 1e-6
            assert found.approach == sense
        if 'limits_deg' not in changes:
            assert np.allclose(np.rad2deg(travel), [0, 120, 240, 360, 480, 360, 240])
        turned = [one.values[0].values[0] for one in server.moves if one.name == 'GoTo' and one.values[0].name == 'R']
        low, high = changes.get('limits_deg', (-1e9, 1e9))
        assert all(low <= one <= high for one in turned)
    run(scene, settings)


def test_targets_elsewhere():
    """Another plate or table than the settings have: refused before anything moves."""
    async def scene(server, cmm):
        before = len(server.commands)
        for arguments, said in [((7, [0.5325, 0.26, -0.3], 0.0, 1), 'expected one of the 6 balls'),
                                ((1, [0.6, 0.26, -0.3], 0.0, 1), r'expected the ball within 20 mm of \(532, 260, '
                                                                 r'-300\)'),
                                ((1, [np.nan, 0.26, -0.3], 0.0, 1), 'expected the ball within'),
                                ((1, [0.5325, 0.26, -0.3], 0.0, 1, [1, 0, 0]), r'expected the pole along \(0, 0, 1\)'),
                                ((1, [0.5325, 0.26, -0.3], 0.0, 1, [0, 0, 1], 7), 'touches: expected one of')]:
            with pytest.raises(InvalidPlan, match=said):
                await cmm.measure(*arguments)
        assert len(server.commands) == before
    run(scene)


def test_wrong_ball():
    """The fitted radius tells."""
    async def scene(server, cmm):
        server.settings = settings_of(ball={'radius_mm': 16.0})
        with pytest.raises(CellError, match=r'expected a sphere of radius 15 mm, or 17.5 with the tip, found 18.5'):
            await measured(cmm)
    run(scene)


def test_a_ball_that_is_off_its_place():
    """By 2 mm: found where it is."""
    async def scene(server, cmm):
        server.off = np.array([1.0, -1.5, 0.8])
        found = await measured(cmm)
        assert np.linalg.norm(found.centre - [0.5335, 0.2585, -0.2992]) < NANOMETRE
    run(scene)


def test_dry_run():
    """All moves above the balls, no touch."""
    async def scene(server, cmm):
        with pytest.raises(CellError, match='dry run: the way around ball 1 was made above the plate'):
            await measured(cmm)
        assert 'PtMeas' not in [one.name for one in server.commands]
        assert min(one.values[2].values[0] for one in server.moves if one.values[0].name == 'X') > -300 + 15 + 10
        assert server.properties['Tool.GoToPar.Speed'] == 10.0
    run(scene, settings_of(dry_run=True))


def test_a_table_that_was_turned_meanwhile():
    """By a person, or by a move that was aborted: its angle is read before anything moves."""
    async def scene(server, cmm):
        await measured(cmm)
        server.r = 90.0
        found = await measured(cmm, position=2)
        assert np.rad2deg(found.table_travel) == pytest.approx(420)
        turned = [one.values[0].values[0] for one in server.moves if one.values[0].name == 'R']
        assert turned == pytest.approx([300, 0, 200, 310, 60])  # at first nobody knows how it came to where it stands
    run(scene)


def test_changing_the_tool_moves_the_machine():
    """Only where another one is in use, and never while a server is only looked at."""
    async def scene(server, cmm):
        names = [one.name for one in server.commands]
        assert 'ChangeTool' in names
        cmm.settings = settings_of(tool={'name': 'P3', 'change': True})
        with pytest.raises(CellError, match="expected the tool 'P3' in use, found \"P1\"; it .* before the first ball"):
            await cmm.prepare(may_move=False)
        assert names.count('ChangeTool') == 1
    replies = {'GetProp': lambda tag, asked: [Response(tag, ACK), encoded(f'{tag} # Tool.Name("P1")'),
                                              Response(tag, DONE)] if asked.values[0].name == 'Tool.Name' else OK}
    run(scene, settings_of(tool={'name': 'P2', 'change': True}), **replies)


@pytest.mark.parametrize(('words', 'found'), [
    ('Name("1"), Temperature("20.25")', 20.25), ('"Part", 20.25', 20.25), ('T(-273)', math.nan), ('"x"', math.nan)])
def test_temperatures(words, found):
    """As servers write them."""
    async def scene(server, cmm):
        assert (await measured(cmm)).temperature == pytest.approx(found, nan_ok=True)
    run(scene, ReadAllTemperatures=lambda tag, asked: [Response(tag, ACK), encoded(f'{tag} # {words}'),
                                                       Response(tag, DONE)])

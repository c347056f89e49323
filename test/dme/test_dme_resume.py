# SPDX-License-Identifier: Apache-2.0
"""Runs that a fault stops, over TCP: nothing moves until a person has looked, then the rest is measured and no more."""

import asyncio
import functools
import re

import numpy as np
import pytest
from faulty_proxy import FaultyProxy
from scripted_server import prepared

from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.calibration.state_machine import Ask, Limits, Sequence
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.scheme import plan
from rosette_ros.dme.dme_server import DmeServer
from rosette_ros.dme.dme_session import DmeSession, DmeStopped
from rosette_ros.dme.dme_settings import client_settings, dme_settings
from rosette_ros.io.messages import Answer, Phase
from rosette_ros.simulation import MachineConfig

pytestmark = pytest.mark.long

N, TOUCHES = 3, 6
CONFIG = MachineConfig().changed(plate={'balls': N}, probing={'repeatability_um': 0.0})
NANOMETRE = 1e-9


class Stopped(Exception):  # noqa: N818
    """What was measured until nothing was sent any more."""


async def carry_out(sequence, cmm):
    """Measure what a calibration asks for until all is measured; raises Stopped in the words of the machine."""
    commands, asked = sequence.begin(0.0), []
    while targets := [one.target for one in commands if isinstance(one, Ask)]:
        [target] = targets
        asked.append(target.seq)
        place = target.run_id, target.seq, target.table_position, target.ball, target.cmm_position
        try:
            ball = await cmm.measure(target.ball, target.centre, target.table_angle, target.approach, target.pole)
        except DmeStopped as error:
            sequence.fail(str(error))
            raise Stopped(str(error)) from error
        except CellError as error:
            answer = Answer(*place, 1, str(error), 0.0, 0.0, 0, (0.0,) * 3, 0.0, 0.0, 'machine', 0)
        else:
            answer = Answer(*place, 0, '', ball.table_angle, ball.table_travel, ball.approach,
                            tuple(ball.centre.tolist()), ball.form_error, ball.temperature, 'machine', 1)
        commands = sequence.answer(answer, 0.0)
    assert sequence.phase is Phase.EVALUATION
    return asked


def calibration(settings, earlier=None):
    """Return the sequence of a whole calibration of three balls, or of what an earlier part lacks."""
    planned = plan_calibration(plan(N, 'row'), 1e-3 * settings.table.radius_mm, settings.table.frame, repeats=1)
    return Sequence('run', planned, Limits(), earlier)


def places(sequence):
    """Return the ball centres by target, (N, 3), m."""
    return np.array([answer.centre for _, answer in sorted(sequence.answers.counting(), key=lambda one: one[0].seq)])


async def interrupted(*faults, **timeouts):
    """Calibrate with faults, look at the machine where it stops, resume; return the words, what was asked, the centres.
    """
    server, proxy = DmeServer(CONFIG), FaultyProxy(faults)
    values = client_settings(CONFIG, await proxy.start(await server.start()))
    values['ball']['touches'], values['timeouts'] = TOUCHES, timeouts
    settings = dme_settings(values)
    machine, words, asked, sequence = server.commands.cmm, '', [], calibration(settings)
    cmm = await prepared(settings)
    try:
        asked.append(await carry_out(sequence, cmm))
    except Stopped as stopped:
        words, moved, before = str(stopped), machine.moved, sequence
        for attempt in (cmm.session.resume, cmm.session.clear, lambda: cmm.measure(1, settings.table.frame.to_outer(
                settings.table.balls_at(0.0))[0], 0.0)):
            with pytest.raises(DmeStopped):
                await attempt()
        assert machine.moved == moved
        if cmm.session.is_lost:
            there = settings.server
            cmm.session = await DmeSession.connect(there.host, there.port, settings.timeouts, by_person=True)
        else:
            await cmm.session.clear(by_person=True)
        await cmm.prepare(may_move=False)
        assert machine.moved == moved
        sequence = calibration(settings, before.answers)
        asked = [{answer.seq for _, answer in before.answers.counting()}, await carry_out(sequence, cmm)]
    finally:
        await cmm.session.end()
        await proxy.stop()
        await server.stop()
    return words, asked, places(sequence)


@pytest.fixture
def undisturbed():
    """Return the ball centres of a run that nothing stops."""
    return centres_of_an_undisturbed_run()


@functools.cache
def centres_of_an_undisturbed_run():
    """Measure once; not as a fixture of the module, which would start in the event loop of another module's browser."""
    words, asked, centres = asyncio.run(interrupted())
    assert not words
    assert len(asked[0]) == len(centres) == 1 + 2 * N + N * N + 1
    return centres


@pytest.mark.parametrize(('fault', 'said', 'timeouts'), [
    ('collision:at=300', 'error 2504 .*a person has to look', {}),
    ('emergency_stop:at=300', 'error 0500 .*a person has to look', {}),
    ('unsolicited:at=50', 'error 1009 .*a person has to look', {}),
    ('garbage:at=50', r'no I\+\+ DME: expected printable ASCII', {}),
    ('wrong_tag:at=50', 'found one with the tag', {}),
    ('restart:at=50', 'the connection|the server closed the connection', {}),
    ('half_open:at=50', 'AbortE was not answered within 0.5 s', {'command_s': 1.5, 'abort_s': 0.5}),
])
def test_resume_completes_the_run(undisturbed, fault, said, timeouts):
    """Nothing moves after the stop, no answered ball is lost or measured twice, and all centres are those of an
    undisturbed run."""
    words, (answered, asked), centres = asyncio.run(interrupted(fault, **timeouts))
    assert re.search(said, words)
    assert 5 <= len(answered) < 15
    assert sorted([*answered, *asked]) == list(range(1, len(undisturbed) + 1))
    assert np.abs(centres - undisturbed).max() < NANOMETRE


@pytest.mark.parametrize('faults', [
    ['surface_not_found:at=20'], ['out_of_limits:at=100'], ['nan:at=20'], ['reordered', 'quoted'],
    ['split'], ['joined'], ['slow'], ['clamped']])
def test_faults_that_stop_no_run(undisturbed, faults):
    """A ball that fails is asked again; how the lines come does not matter."""
    words, [asked], centres = asyncio.run(interrupted(*faults))
    assert not words
    assert set(asked) == set(range(1, len(undisturbed) + 1))
    assert np.abs(centres - undisturbed).max() < NANOMETRE

# SPDX-License-Identifier: Apache-2.0
"""A whole calibration through the client and the server, touch by touch, beside that of the simulated cell itself."""

import asyncio

import numpy as np
import pytest
from through_dme import calibrate

from rosette_ros.analysis import analyse
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.dme.dme_server import DmeServer, ServeSettings
from rosette_ros.dme.dme_settings import client_settings, dme_settings
from rosette_ros.simulation import Machine, MachineConfig

ONE_NM, FIVE_NRAD = 1e-9, 5e-9
"""What a noise-free run of the simulated cell differs from the truth by: docs/machine.md."""


async def calibrated(config, served, touches):
    """Return the run and the table frame that a client finds through the server."""
    server = DmeServer(config, served)
    settings = dme_settings(client_settings(config, await server.start(), served.sign, served.cumulative))
    run, frame, _ = await calibrate(settings, plan(config.plate.balls, 'diagonal'), touches)
    await server.stop()
    return run, frame


@pytest.mark.parametrize('n, touches, served', [
    (6, 8, ServeSettings()), (4, 6, ServeSettings(sign=-1, cumulative=True, compensated=True, dialect='2.x'))])
def test_without_noise_the_curves_are_the_truth(n, touches, served):
    config = MachineConfig().changed(plate={'balls': n}, probing={'repeatability_um': 0.0})
    run, frame = asyncio.run(calibrated(config, served, touches))
    found = analyse(run).error_motions
    error = found.values - remove_gauge(Machine(config).table_truth(found.angle, frame))
    assert np.abs(error[:, :3]).max() < ONE_NM
    assert np.abs(error[:, 3:]).max() < FIVE_NRAD
    assert np.isfinite(run.temperature).all() == (served.dialect == '2.x')


def test_noise_and_what_is_hidden_are_those_of_the_simulated_cell():
    """Noise and effects that do not depend on time are the same ones; only 1e-12 m of the answers are rounded."""
    config = MachineConfig().changed(plate={'balls': 4}, hidden=[
        {'kind': 'table_backlash', 'width_urad': 5.0}, {'kind': 'ball_form', 'ball': 2, 'order': 3, 'centre_um': 2.0},
        {'kind': 'cmm_reversal', 'value_um': [1.0, 1.0, 0.0]}])
    run, frame = asyncio.run(calibrated(config, ServeSettings(), 20))
    direct, alignment, _ = Machine(config).calibrate(plan(4, 'diagonal'), repeats=0)
    np.testing.assert_allclose(frame.origin, alignment.frame.origin, rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.centre, direct.centre, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(run.approach, direct.approach)

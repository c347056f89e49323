# SPDX-License-Identifier: Apache-2.0
"""A calibration of 6 balls through anyone's I++ server: ROSETTE_DME=host:port, ROSETTE_DME_SETTINGS=FILE.

THE MACHINE MOVES. The settings file (rosette-dme/1) says where the plate is and how the table turns; without one the
server is taken for one like `rosette dme serve`, with a plate of 6 balls.
"""

import asyncio
import os

import numpy as np
import pytest
from through_dme import calibrate

from rosette_ros.analysis import analyse
from rosette_ros.core.run.scheme import plan
from rosette_ros.dme.dme_settings import ServerSettings, client_settings, dme_settings, load_dme_settings
from rosette_ros.simulation import MachineConfig

SERVER = os.environ.get('ROSETTE_DME', '')
SETTINGS = os.environ.get('ROSETTE_DME_SETTINGS', '')


@pytest.mark.skipif(not SERVER, reason='set ROSETTE_DME=host:port to calibrate through that I++ server; it moves')
@pytest.mark.timeout(36000)
def test_six_balls_through_anyones_server():
    """All balls are found, and what table, plate and CMM cannot explain is as small as the form of the touches."""
    host, _, port = SERVER.rpartition(':')
    settings = load_dme_settings(SETTINGS) if SETTINGS else dme_settings(
        client_settings(MachineConfig().changed(plate={'balls': 6}), int(port)))
    settings = settings.model_copy(update={'server': ServerSettings(host=host, port=int(port))})
    run, _, balls = asyncio.run(calibrate(settings, plan(settings.table.balls, 'diagonal')))
    fit = analyse(run)
    form = max(ball.form_error for ball in balls)
    print(f'{len(balls)} balls, form at most {1e6 * form:.2f} um, residual {1e6 * fit.rms:.3f} um, '
          f'temperatures {np.nanmin(run.temperature) if np.isfinite(run.temperature).any() else "none"}')
    assert fit.rms < max(form, 1e-7)

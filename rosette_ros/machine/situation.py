# SPDX-License-Identifier: Apache-2.0
"""Estimates how long a run takes and when it begins, so that drawn effects fall into it."""

import numpy as np

from rosette_ros.machine.hidden import Situation


def expected_situation(config, touches):
    """Return the Situation of a complete run on the machine of a MachineConfig.

    touches: Q per ball. A ball is counted with one step of the table or of the CMM.
    """
    n, timing = config.plate.balls, config.timing
    pitch = 2e3 * config.radius * np.sin(np.pi / n)
    table = 360.0 / n / timing.table_speed_deg_per_s + timing.table_settle_s
    cmm = pitch / timing.cmm_speed_mm_per_s + timing.cmm_settle_s
    ball_h = (touches * timing.touch_s + max(table, cmm) + 0.8 * timing.jitter_s) / 3600.0
    before = config.hidden_draw.readings_before
    before = 2 * n + 10 if before is None else before
    return Situation(balls=n, radius=config.radius, start_h=float(before * ball_h),
                     duration_h=float(n * n * ball_h),
                     sigma_um=config.probing.repeatability_um)

# SPDX-License-Identifier: Apache-2.0
"""A calibration through an I++ server without ROS: the axis, the plane, then a scheme."""

import numpy as np
from scripted_server import prepared

from rosette_ros.core.run.geometry import TWO_PI, table_frame
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import nominal_places


async def calibrate(settings, scheme, touches=0):
    """Return the run of a scheme by the machine of the settings, the table frame that is found, and all balls."""
    table, n = settings.table, scheme.n
    cmm, radius, taught = await prepared(settings), 1e-3 * table.radius_mm, table.frame
    nominal = nominal_places(n, radius, 1, np.arange(1, n + 1))

    async def measured(frame, position, ball, approach=1):
        aim = frame.to_outer(nominal[(position + ball - 2) % n])
        return await cmm.measure(ball, aim, TWO_PI * (position - 1) / n, approach, taught.rotation[:, 2], touches)

    try:
        axis = [await measured(taught, one, 1) for one in range(1, n + 1)]
        plane = [await measured(taught, 1, one) for one in range(1, n + 1)]
        frame = table_frame(np.array([ball.centre for ball in axis]), np.array([ball.centre for ball in plane]))
        balls = [await measured(frame, int(position), int(ball), int(approach)) for position, ball, approach
                 in zip(scheme.table_position, scheme.ball, scheme.approach, strict=True)]
    finally:
        await cmm.session.end()
    column = {name: np.array([getattr(ball, name) for ball in balls])
              for name in ('table_angle', 'time', 'temperature', 'approach', 'table_travel', 'centre')}
    return Run(n=n, radius=radius, table_position=scheme.table_position, ball=scheme.ball, rotation=frame.rotation,
               **column | {'centre': frame.to_inner(column['centre'])}), frame, [*axis, *plane, *balls]

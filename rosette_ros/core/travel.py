# SPDX-License-Identifier: Apache-2.0
"""What a measuring scheme costs in motion: turns of the table, way of the CMM."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.scheme import unwrap_travel


@dataclass(frozen=True)
class Travel:
    """Motion of one run: table_angle turned in all, rad; table_moves; cmm_way straight from target
    to target, m; cmm_moves; seconds of motion are for whoever knows the speeds."""

    table_angle: float
    table_moves: int
    cmm_way: float
    cmm_moves: int

    @property
    def table_turns(self):
        """How often the table turns round, both senses counted."""
        return self.table_angle / TWO_PI


def travel(scheme, radius):
    """Return the Travel of a scheme from its first target to its last; radius in m."""
    table = np.abs(np.diff(unwrap_travel(scheme.table_angle, scheme.approach, scheme.n)))
    cmm = np.linalg.norm(np.diff(scheme.centres(radius), axis=0), axis=1)
    moved = cmm > 1e-9 * radius
    return Travel(float(table.sum()), int(np.count_nonzero(table > 1e-9)),
                  float(cmm[moved].sum()), int(np.count_nonzero(moved)))

# SPDX-License-Identifier: Apache-2.0
"""A simulated CMM that takes every plan, but not the first block of readings that is to be added to one."""

from functools import partial

from rosette_msgs.msg import ProbeTarget

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.nodes import names
from rosette_ros.nodes.base_node import run_node
from rosette_ros.nodes.simulated_cmm import SimulatedCmm


class RefusingCmm(SimulatedCmm):
    """Refuses the block that it is asked for first, whenever it is asked for."""

    refused = None

    def check_plan(self, targets):
        """Raise InvalidPlan for the first block; a plan begins before its run."""
        super().check_plan(targets)
        if targets[0].phase == ProbeTarget.PHASE_RUN:
            block = [(one.table_position, one.ball, one.approach) for one in targets]
            self.refused = self.refused or block
            if block == self.refused:
                raise InvalidPlan(f'no way to ball {targets[0].ball}')


main = partial(run_node, names.CMM, RefusingCmm)
"""Run the node; returns the exit code."""

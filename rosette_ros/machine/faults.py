# SPDX-License-Identifier: Apache-2.0
"""Faults of a cell that is not at its best: drawn from the seed, configured as a list.

Unlike what is hidden (hidden/), which moves balls by physics, a fault makes an answer come late, twice,
wrongly or not at all. A new kind is a word in FaultKind, a line in docs/machine.md and a case where the
node that answers carries it out.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.machine.settings import NotNegative, Settings
from rosette_ros.machine.streams import part_generator

FaultKind = Literal[
    'silent', 'late', 'twice', 'again', 'wrong_seq', 'wrong_run', 'not_a_number', 'infinite', 'failed',
    'wrong_ball', 'neighbour', 'outlier', 'clock_back', 'table_short', 'crash']


class FaultSettings(Settings):
    """One kind of fault: which share of the answers it strikes, how hard, how often at most."""

    kind: FaultKind
    share: Annotated[float, Field(ge=0, le=1, description='of the answers it strikes')] = 0.0
    at: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(
        strict=False, description='seq of targets that it strikes at their first attempt')] = ()
    always: bool = Field(False, description='whether it strikes those targets at every attempt')
    late_s: NotNegative = Field(1.0, description='late: wall time')
    size_um: NotNegative = Field(50.0, description='outlier: displacement of the ball centre')
    short_urad: NotNegative = Field(200.0, description='table_short: the table stops before its place, '
                                    'as its encoder shows')
    back_s: NotNegative = Field(5.0, description='clock_back: jump of the clock')


FaultList = Annotated[tuple[FaultSettings, ...], Field(strict=False, max_length=100)]


@dataclass(frozen=True, eq=False)
class Strike:
    """A fault that strikes one answer; direction: (3,) random unit vector for what needs one."""

    fault: FaultSettings
    direction: np.ndarray

    @property
    def kind(self):
        """The kind of fault."""
        return self.fault.kind


def strikes(faults, seed, seq, attempt):
    """Return the Strikes on the answer to a target, a tuple; the same for the same arguments.

    faults: FaultSettings; seed: of the machine; seq, attempt: of the target.
    """
    out = []
    for place, fault in enumerate(faults):
        draw = part_generator(seed, f'fault {place} {seq} {attempt}')
        struck = draw.random() < fault.share or (seq in fault.at and (fault.always or attempt == 1))
        direction = draw.standard_normal(3)
        if struck:
            out.append(Strike(fault, direction / np.linalg.norm(direction)))
    return tuple(out)

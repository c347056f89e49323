# SPDX-License-Identifier: Apache-2.0
"""Faults of the simulated cell: drawn from the seed, configured as a list; which answers they strike, and how.

Unlike what is hidden (hidden_kinds.py), which moves balls by physics, a fault makes an answer come late, twice, wrongly
or not at all. A new fault is a name in FaultKind, the case that carries it out, and a line in docs/machine.md.
"""

import copy
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from rosette_ros.core.run.records import Floats
from rosette_ros.simulation.random_streams import part_generator
from rosette_ros.simulation.setting_types import NotNegative, Settings, Share

FaultKind = Literal[
    'silent', 'late', 'twice', 'again',  # when and how often an answer comes: `distort`
    'wrong_seq', 'wrong_run', 'not_a_number', 'infinite', 'failed', 'wrong_ball', 'outlier',  # its content: `distort`
    'neighbour', 'table_short', 'clock_back', 'crash',  # what is measured, or the process: nodes/simulated_cmm.py
]


class FaultSettings(Settings):
    """One kind of fault: which share of the answers it strikes, how hard, how often at most."""

    kind: FaultKind
    share: Share = Field(0.0, description='of the answers it strikes')
    at: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(
        strict=False, description='seq of targets that it strikes at their first attempt')] = ()
    always: bool = Field(False, description='whether it strikes those targets at every attempt')
    late_s: NotNegative = Field(1.0, description='late: wall time')
    size_um: NotNegative = Field(50.0, description='outlier: displacement of the ball centre')
    short_urad: NotNegative = Field(200.0, description='table_short: the table stops before its place, '
                                    'as its encoder shows')
    back_s: NotNegative = Field(5.0, description='clock_back: jump of the clock')


FaultList = Annotated[tuple[FaultSettings, ...], Field(strict=False, max_length=100)]


class Strike(NamedTuple):
    """A fault that strikes one answer; direction: (3,) random unit vector for what needs one."""

    fault: FaultSettings
    direction: Floats


def strikes(faults: Sequence[FaultSettings], seed: int, seq: int, attempt: int) -> tuple[Strike, ...]:
    """Return what strikes the answer to a target; the same for the same seed of the machine, target and attempt."""
    out = []
    for place, fault in enumerate(faults):
        draw = part_generator(seed, f'fault {place} {seq} {attempt}')
        struck = draw.random() < fault.share or (seq in fault.at and (fault.always or attempt == 1))
        direction = draw.standard_normal(3)
        if struck:
            out.append(Strike(fault, direction / np.linalg.norm(direction)))
    return tuple(out)


def distort(answer: Any, struck: Sequence[Strike], previous: Any, now: float) -> list[tuple[Any, float | None]]:
    """Return what is published instead of an answer: pairs of a message and when (steady s, None: now).

    answer: a rosette_msgs/BallCentre, not changed; previous: the one before, or None; several faults act one after the
    other.
    """
    changed = copy.deepcopy(answer)
    out: list[tuple[Any, float | None]] = []
    due = None
    for strike in struck:
        match strike.fault.kind:
            case 'silent':
                return []
            case 'late':
                due = now + strike.fault.late_s
            case 'twice':
                out.append((copy.deepcopy(changed), due))
            case 'again' if previous is not None:
                out.append((copy.deepcopy(previous), due))
            case 'wrong_seq':
                changed.seq += 1
            case 'wrong_run':
                changed.run_id = 'another_run'
            case 'not_a_number':
                changed.centre.y = float('nan')
            case 'infinite':
                changed.centre.z = float('inf')
            case 'failed':
                changed.status, changed.text = changed.STATUS_FAILED, 'the stylus did not trigger'
            case 'wrong_ball':
                changed.ball += 1
            case 'outlier' if changed.status == changed.STATUS_OK:
                x, y, z = (1e-6 * strike.fault.size_um * strike.direction).tolist()
                changed.centre.x += x
                changed.centre.y += y
                changed.centre.z += z
    return [*out, (changed, due)]

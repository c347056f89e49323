# SPDX-License-Identifier: Apache-2.0
"""What the simulated server of I++ DME is like: dialect, speed, table, and the faults of its protocol or machine.

A new fault is a name in DmeFaultKind, the place that carries it out, and a line in docs/dme-server.md.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from rosette_ros.core.errors import InvalidConfig
from rosette_ros.simulation.setting_types import NotNegative, Positive, Settings, checked

DmeFaultKind = Literal[
    'surface_not_found', 'collision', 'emergency_stop', 'out_of_limits', 'clamped', 'not_qualified', 'not_homed',
    'turns_other_way', 'r_limited', 'inch', 'no_sensor',  # the machine: virtual_cmm.py, serve_commands.py
    'reordered', 'quoted', 'nan', 'wrong_tag', 'garbage', 'unsolicited', 'abort_ignored',  # lines: serve_session.py
    'split', 'joined', 'slow', 'half_open', 'restart',  # the connection: serve_session.py
]
KINDS = get_args(DmeFaultKind)


class DmeFault(Settings):
    """A fault; at, times: from its at-th occasion on, so many times (0: always); ball: only there (0: any).

    Of all kinds only surface_not_found is told at which ball it has occasion to strike."""

    kind: DmeFaultKind
    at: Annotated[int, Field(ge=1)] = 1
    times: Annotated[int, Field(ge=0)] = 0
    ball: Annotated[int, Field(ge=0)] = 0
    seconds: NotNegative = Field(0.2, description='slow: delay of each line; split: of its second part')

    @model_validator(mode='after')
    def _has_ball(self) -> Self:
        if self.ball and self.kind != 'surface_not_found':
            raise ValueError(f'ball: wanted it with surface_not_found only, got it with {self.kind}')
        return self


ONCE = frozenset(('collision', 'emergency_stop', 'garbage', 'unsolicited', 'wrong_tag', 'restart', 'half_open', 'nan'))
"""Kinds that strike once unless `times` is given."""


class ServeSettings(Settings):
    """The server: speed None is as fast as the computer allows, 1 real time, 60 sixty times that."""

    dialect: Literal['1.4', '2.x'] = '1.4'
    speed: Positive | None = None
    sign: Literal[-1, 1] = Field(1, description='of R: 1 counts counter-clockwise about the axis')
    cumulative: bool = Field(False, description='R counts over turns; else it is 0 to 360 and the short way is taken')
    compensated: bool = Field(False, description='points lie on the surface; else the centre of the tip is reported')
    tool: Annotated[str, Field(pattern='^[A-Za-z][A-Za-z0-9]*$')] = 'Probe1'
    decimals: Annotated[int, Field(ge=1, le=9)] = 9
    faults: Annotated[tuple[DmeFault, ...], Field(strict=False, max_length=100)] = ()


def fault_of(text: str) -> DmeFault:
    """Return the fault of KIND or KIND:NAME=VALUE,...; raises InvalidConfig where it is none."""
    kind, _, rest = text.partition(':')
    values: dict[str, object] = {'times': 1} if kind in ONCE else {}
    for pair in filter(None, rest.split(',')):
        name, _, value = pair.partition('=')
        try:
            values[name] = float(value) if name == 'seconds' else int(value)
        except ValueError:
            raise InvalidConfig(f'fault: wanted {name}=NUMBER, got {pair!r:.40} in {text!r:.60}') from None
    return checked(DmeFault, {'kind': kind, **values}, f'fault {text!r:.60}')


class DmeFaults:
    """The faults of a server and how often they had occasion to strike."""

    def __init__(self, faults: Sequence[DmeFault] = ()) -> None:
        self._faults = tuple(faults)
        self._occasions = [0] * len(self._faults)
        self.struck = 0

    def strike(self, kind: DmeFaultKind, ball: int = 0) -> DmeFault | None:
        """Count an occasion for a kind of fault, at a ball or anywhere; return the fault that strikes, if one does."""
        for place, fault in enumerate(self._faults):
            if fault.kind == kind and fault.ball in (0, ball):
                self._occasions[place] += 1
                since = self._occasions[place] - fault.at
                if since >= 0 and (fault.times == 0 or since < fault.times):
                    self.struck += 1
                    return fault
        return None

    def has(self, *kinds: DmeFaultKind) -> bool:
        """Whether a fault of these kinds is configured, whenever it strikes."""
        return any(fault.kind in kinds for fault in self._faults)

# SPDX-License-Identifier: Apache-2.0
"""Which unknowns several runs share."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

SEATS = {'free': (True,) * 6, 'plane': (True, True, False, False, False, True),
         'pilot': (False, False, True, True, True, False), 'both': (False,) * 6}
"""What a plate that is clamped anew may change, along and about x, y, z: nothing is given; its face lies on a plane
that reproduces (height and tilt stay); a pilot reproduces (eccentricity and turn stay); both."""
PARTS = ('table', 'plate', 'clamping', 'cmm', 'frame')

Names = tuple[str, ...]
"""A name for each run: runs of one name share."""
ITEMS = {'table': 'error motions of the table', 'plate': 'ball centre deviations', 'clamping': 'placement of the plate',
         'cmm': 'CMM measurement errors at the same positions', 'frame': 'machine frame',
         'seat': 'what the seat reproduces', 'calibrated plate': 'the calibration of the plate',
         'calibrated CMM': 'the calibration of the CMM', 'sense': 'curves of both senses of turning'}
"""What runs can share, in words."""


@dataclass(frozen=True)
class Sharing:
    """What runs share; each of PARTS has a name for each run.

    table: table motions; plate: plate deviations; clamping: the placement of the plate on the table; cmm: deviations at
    the same CMM positions; frame: the machine frame, which a run otherwise determines anew; by_sense: whether
    table motions are told apart by the sense of turning; turn: by how much the plate was turned, rad, for each run;
    seat: of SEATS, what a new clamping reproduces; trusts_plates: whether plates that say so are calibrated;
    cmm_is_calibrated: whether CMM deviations are zero.
    """

    table: Names
    plate: Names
    clamping: Names
    cmm: Names
    frame: Names
    turn: tuple[float, ...]
    by_sense: bool = False
    seat: str = 'free'
    trusts_plates: bool = True
    cmm_is_calibrated: bool = False

    @staticmethod
    def of(runs: int, separate: Iterable[str] = (), **rest: Any) -> 'Sharing':
        """Return the Sharing of all parts by all runs, but some of PARTS; rest: other fields."""
        names = {part: apart(runs) if part in separate else ('1',) * runs for part in PARTS}
        return Sharing(**{**names, 'turn': (0.0,) * runs, **rest})

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.table)

    def without(self, item: str) -> 'Sharing':
        """Return the Sharing without one of its items."""
        changed: dict[str, Any] = _SINGLE.get(item, {item: apart(self.runs)})
        if item == 'clamping':
            changed = {**changed, 'seat': 'free'}
        return replace(self, **changed)

    def of_one(self) -> 'Sharing':
        """Return the Sharing of one run alone, all else as here."""
        return Sharing.of(1, by_sense=self.by_sense, seat=self.seat, trusts_plates=self.trusts_plates,
                          cmm_is_calibrated=self.cmm_is_calibrated)

    def is_all(self, item: str) -> bool:
        """Return whether an item is all that the runs share of table, plate and CMM."""
        return [one for one in self.items if one in ('table', 'plate', 'cmm')] == [item]

    @property
    def items(self) -> tuple[str, ...]:
        """What is declared, and could be untrue."""
        shared = [part for part in PARTS if len({*getattr(self, part)}) < self.runs]
        if 'plate' not in shared and 'clamping' in shared:
            shared.remove('clamping')
        if 'plate' in shared and 'clamping' not in shared and self.seat != 'free':
            shared.append('seat')
        return (*shared, *['calibrated plate'] * self.trusts_plates, *['calibrated CMM'] * self.cmm_is_calibrated)


_SINGLE: dict[str, dict[str, Any]] = {
    'seat': {'seat': 'free'}, 'calibrated plate': {'trusts_plates': False},
    'calibrated CMM': {'cmm_is_calibrated': False}, 'sense': {'by_sense': False}}
"""Items that are one field: how they look where they do not hold; the sense of turning where it does."""


def apart(runs: int) -> Names:
    """Return a name of its own for each run."""
    return tuple(str(number) for number in range(1, runs + 1))

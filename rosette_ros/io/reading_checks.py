# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a CMM's node, or of a table of readings, that each single reading hides and all together show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.geometry import Floats, wrap
from rosette_ros.core.run.records import Run, resolution_of
from rosette_ros.core.run.remarks import Remark, RemarkKind, remark
from rosette_ros.core.run.touches import USUAL, USUAL_PACE, Pace
from rosette_ros.io.messages import Answer, Phase, Target

Pairs = Sequence[tuple[Target, Answer]]
"""Targets, and of each the answer that counts, in the order of asking."""
ECHO = 1e-12  # an answer that is no farther from the expected place is that place, m
SAME_TURN = 0.1  # a travel that differs by less from what was asked, rad, is that of the asked move
PACES, TEMPERATURES, REPEATABILITIES = (1.0, 600.0), (5.0, 45.0), (1e-9, 1e-3)  # what can be: s a ball; °C; m
RADII = (0.02, 5.0)
"""Circles of ball centres that can be, m."""
QUICKEST, SLOWEST = 1.0, 5.0
"""No machine touches a ball and leaves it in less, s, nor moves more than ten times as fast as is usual; one that takes
so many times as long for moves and touches as is usual is doubted."""
STANDS_STILL = 12, 600.0  # so many readings, in so many s, of one temperature: a thermometer shows more
LONG_GAP = 3000.0, 20.0  # longer within a session, s and paces, is no part of measuring: nearly an hour
_TIMES = {'µs': 1e-6, 'ms': 1e-3, '1/100 s': 1e-2, '1/10 s': 0.1, 'minutes': 60.0, 'hours': 3600.0,
          'days': 86400.0, 'ns': 1e-9}
_LENGTHS = {'m': 1e3, 'inch': 25.4, 'cm': 10.0, 'µm': 1e-3}
RADIUS = 2e-3  # a radius is wrong that differs by more than this share from the circle of the ball centres


@dataclass(frozen=True)
class Check:
    """One check of a CMM: its name, whether it is passed (None: for information), and what was found."""

    name: str
    passed: bool | None
    text: str


def check_answers(pairs: Pairs, known: float | None = None) -> dict[str, Remark | None]:
    """Return what is wrong with answered targets by the name of the check, None where nothing is.

    known: repeatability, m, where no reading was repeated for it. A check that these targets do not allow is left out:
    without a move of the table nothing is known of its travel."""
    moves = [_Move(before, after) for before, after in pairwise(pairs) if _is_move(before, after)]
    found = {'stamps': _stamps(pairs)}
    if len(moves) > 1:
        found |= {'travel': _travel(moves), 'approach': _approach(moves)}
    found['places'] = _echo(pairs)
    repeated = np.array([answer.centre for target, answer in pairs if target.phase == Phase.REPEATABILITY])
    found['resolution'] = _resolution([answer.centre for _, answer in pairs], repeated, known)
    if len(repeated) > 1:
        same = not np.ptp(repeated, axis=0).any() and not (found['resolution'] or found['places'])
        found['repeatability'] = remark(RemarkKind.REPEATED_ALIKE, readings=len(repeated)) if same else None
    return found


def remarks_on_answers(pairs: Pairs, known: float | None = None) -> tuple[Remark, ...]:
    """Return what is wrong with answered targets; known: as of check_answers."""
    return tuple(filter(None, check_answers(pairs, known).values()))


def remark_on_two_answers(apart: Mapping[str, float]) -> tuple[Remark, ...]:
    """Return which targets have two answers; apart: by how much they differ, m, by target."""
    if not apart:
        return ()
    first = next(iter(apart))
    return (remark(RemarkKind.TWO_ANSWERS, target=first, apart=apart[first], others=len(apart) - 1),)


def remarks_on_table(run: Run, step: float, is_timed: bool) -> tuple[Remark, ...]:
    """Return what is wrong with the readings of a table.

    step: to which its coordinates are rounded, m; is_timed: whether it has times."""
    same = run.size > 1 and not np.ptp(run.time)
    found = (remark(RemarkKind.SAME_TIME, readings=run.size) if same else None,
             remark_on_resolution(step, run.repeatability))
    return (*filter(None, found), *_remarks_on_units(run, is_timed), *remarks_on_run(run))


def is_in_seconds(time: Floats) -> bool:
    """Return whether readings follow each other as those of a CMM do, or all at one time."""
    step = _pace(time)
    return not step or PACES[0] <= step <= PACES[1]


def _pace(time: Floats) -> float:
    """Return the time from one reading to the next, median, s."""
    return float(np.median(np.diff(time))) if time.size > 1 else 0.0


def _remarks_on_units(run: Run, is_timed: bool) -> tuple[Remark, ...]:
    """Return which quantities of a table cannot be in the unit of their column."""
    found = []
    step = _pace(run.time)
    if is_timed and step and run.size > 1:
        usual = Pace.touch * USUAL
        moving = float(np.median(np.diff(USUAL_PACE.times(np.zeros(run.size), *_moves(run)))))
        if not QUICKEST + moving / 10 <= step <= SLOWEST * (usual + moving):
            unit = min(_TIMES, key=lambda unit: abs(np.log(step * _TIMES[unit] / (usual + moving))))
            found.append(remark(RemarkKind.UNIT_OF_TIME, step=step, usual=usual + moving, unit=unit,
                                in_unit=step * _TIMES[unit], is_used=is_in_seconds(run.time)))
    known, (least, most) = run.repeatability, REPEATABILITIES
    if known is not None and not least <= known <= most:
        found.append(remark(RemarkKind.UNIT_OF_REPEATABILITY, repeatability=known))
    return tuple(found)


def _moves(run: Run) -> tuple[Floats, Floats]:
    """Return by how much the table, rad, and the CMM, m, moved before each reading, (N,), 0 before the first."""
    centre = run.centre
    return (np.abs(np.diff(run.table_travel, prepend=run.table_travel[:1])),
            np.linalg.norm(np.diff(centre, axis=0, prepend=centre[:1]), axis=1))


def remark_on_radius(radius: float) -> Remark | None:
    """Return why a radius, m, is not that of a plate of balls, with those in other units, m, that may be one."""
    if RADII[0] <= radius <= RADII[1]:
        return None
    likely = {unit: radius * factor for unit, factor in _LENGTHS.items() if 0.05 <= radius * factor <= 1}
    return remark(RemarkKind.UNIT_OF_COORDINATES, radius=radius, likely=likely)


def remark_on_temperature(temperature: Floats) -> Remark | None:
    """Return why temperatures, °C, NaN where not measured, are not those of a CMM's room, None where they are.

    A thermometer that is missing, or a field that nobody sets, gives 0.
    """
    known = temperature[np.isfinite(temperature)]
    if not known.size or (TEMPERATURES[0] <= known.min() and known.max() <= TEMPERATURES[1]):
        return None
    if zeros := int(np.count_nonzero(known == 0)):
        return remark(RemarkKind.NO_TEMPERATURE, zeros=zeros, readings=temperature.size)
    return remark(RemarkKind.UNIT_OF_TEMPERATURE, least=float(known.min()), most=float(known.max()))


def known_temperatures(run: Run) -> Floats:
    """Return the temperatures that were measured, °C, of all that states or uses one; none where they cannot be."""
    known = run.temperature[np.isfinite(run.temperature)]
    return known[:0] if remark_on_temperature(known) or _same_temperature(run) else known


def _same_temperature(run: Run) -> Remark | None:
    """Return that a thermometer stands still, None where it does not: nothing follows of a change in the run then."""
    known, (readings, seconds) = run.temperature[np.isfinite(run.temperature)], STANDS_STILL
    if known.size < readings or np.ptp(known) or np.ptp(run.time) < seconds or remark_on_temperature(known):
        return None
    return remark(RemarkKind.SAME_TEMPERATURE, temperature=float(known[0]), readings=known.size,
                  seconds=float(np.ptp(run.time)))


def remarks_on_run(run: Run) -> tuple[Remark, ...]:
    """Return what is wrong with the readings of a table or a log: radius, temperature, gaps."""
    return tuple(filter(None, (remark_on_radius(run.radius), remark_on_temperature(run.temperature),
                               _same_temperature(run), _gaps(run), _other_radius(run))))


def _gaps(run: Run) -> Remark | None:
    """Return after which readings how much time, s, lies that is too much, but for pauses that are stated and for
    waits before readings that are made again."""
    cell = run.table_position * (run.n + 1) + run.ball
    again = np.setdiff1d(np.arange(run.size), np.unique(cell, return_index=True)[1])
    (least, paces), gap = LONG_GAP, np.diff(run.time[:again[0]] if again.size else run.time)
    long = np.flatnonzero((gap > max(least, paces * _pace(run.time))) & (np.diff(run.session)[:gap.size] == 0))
    after = tuple((row + 1, float(gap[row])) for row in long.tolist())
    return remark(RemarkKind.GAPS, after=after) if after else None


def _other_radius(run: Run) -> Remark | None:
    """Return that the stated radius is not that of the circle of ball centres, None where it is."""
    lies = float(np.mean(np.hypot(run.centre[:, 0], run.centre[:, 1])))
    return (remark(RemarkKind.OTHER_RADIUS, lies=lies, stated=run.radius) if abs(lies / run.radius - 1) > RADIUS
            else None)


def remark_on_resolution(step: float, repeatability: float | None) -> Remark | None:
    """Return that coordinates are rounded to steps larger than the repeatability, m, None where they are not."""
    if not step or (repeatability is not None and step <= repeatability):
        return None
    return remark(RemarkKind.ROUNDED, step=step, repeatability=repeatability)


class _Move:
    """A table move between two targets that follow each other: asked and answered, rad."""

    def __init__(self, before: tuple[Target, Answer], after: tuple[Target, Answer]) -> None:
        sense = after[0].approach
        self.sense, self.approach = sense, after[1].approach
        self.asked = sense * ((sense * (after[0].table_angle - before[0].table_angle)) % (2 * np.pi))
        self.travelled = after[1].table_travel - before[1].table_travel


def _is_move(before: tuple[Target, Answer], after: tuple[Target, Answer]) -> bool:
    """Whether the table went from one target straight to the other: neither was asked twice."""
    (one, _), (other, _) = before, after
    return (other.seq == one.seq + 1 and one.session == other.session and one.attempt == other.attempt == 1
            and other.approach != 0 and one.table_position != other.table_position)


def _stamps(pairs: Pairs) -> Remark | None:
    stamps = [answer.stamp_ns for _, answer in pairs]
    zeros, alike = stamps.count(0), len(stamps) - len(set(stamps))  # the first of an imported run is 0
    if alike:
        return remark(RemarkKind.SAME_STAMPS, zeros=zeros, alike=alike, answers=len(stamps))
    once = sorted(((target.session, target.seq, answer.stamp_ns) for target, answer in pairs if target.attempt == 1))
    back, seq = min(((after[2] - before[2], before[1]) for before, after in pairwise(once) if before[0] == after[0]),
                    default=(0, 0))
    return remark(RemarkKind.CLOCK_SET_BACK, seconds=-1e-9 * back, seq=seq) if back < 0 else None


def _travel(moves: Sequence[_Move]) -> Remark | None:
    wrong = [move for move in moves if abs(move.travelled - move.asked) > SAME_TURN]
    if not wrong:
        return None
    if all(move.travelled == 0 for move in moves):
        return remark(RemarkKind.TRAVEL_STAYS, moves=len(moves))
    if all(abs(wrap(move.travelled - move.asked)) < SAME_TURN for move in wrong):
        return remark(RemarkKind.TRAVEL_JUMPS, wrong=len(wrong), moves=len(moves))
    return remark(RemarkKind.TRAVEL_DIFFERS, travelled=wrong[0].travelled, asked=wrong[0].asked, wrong=len(wrong),
                  moves=len(moves))


def _approach(moves: Sequence[_Move]) -> Remark | None:
    wrong = [move for move in moves if move.approach != move.sense]
    if not wrong:
        return None
    kind = RemarkKind.OTHER_APPROACH if any(move.approach for move in moves) else RemarkKind.NO_APPROACH
    return remark(kind, wrong=len(wrong), moves=len(moves))


def _echo(pairs: Pairs) -> Remark | None:
    away = np.array([np.subtract(answer.centre, target.centre) for target, answer in pairs
                     if target.frame_id == answer.frame_id]).reshape(-1, 3)
    echoed = int(np.count_nonzero(np.abs(away).max(axis=1, initial=0) < ECHO)) if len(away) else 0
    return remark(RemarkKind.ECHO, echoed=echoed, answers=len(pairs)) if 2 * echoed > len(pairs) else None


def _resolution(centres: ArrayLike, repeated: Floats, known: float | None) -> Remark | None:
    spread = float(np.sqrt(np.mean(np.var(repeated, axis=0, ddof=1)))) if len(repeated) > 1 else 0.0
    measured = spread if spread > ECHO else None  # all the same: not 0 to the last bit
    return remark_on_resolution(resolution_of(centres), measured if len(repeated) > 1 else known)

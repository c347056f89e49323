# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a CMM's node, or of a table of readings, that each single reading hides and all together show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.run.geometry import Floats, wrap
from rosette_ros.core.run.number_words import micrometres, significant
from rosette_ros.core.run.records import ROUNDED, UNIT_DOUBT, Run, resolution_of
from rosette_ros.io.messages import Answer, Phase, Target

Pairs = Sequence[tuple[Target, Answer]]
"""Targets, and of each the answer that counts, in the order of asking."""
ECHO = 1e-12  # an answer that is no farther from the expected place is that place, m
SAME_TURN = 0.1  # a travel that differs by less from what was asked, rad, is that of the asked move
PACES, TEMPERATURES, REPEATABILITIES = (1.0, 3600.0), (5.0, 45.0), (1e-9, 1e-3)  # what can be: s a ball; °C; m
RADII = (0.02, 5.0)
"""Circles of ball centres that can be, m."""
USUAL_PACE = 30.0  # s a ball
MOST_GAPS = 3
LONG_GAP = 3000.0, 20.0  # longer within a session, s and paces, is no part of measuring: nearly an hour
_TIMES = {'µs': 1e-6, 'ms': 1e-3, 'minutes': 60.0, 'hours': 3600.0, 'days': 86400.0, 'ns': 1e-9}
_LENGTHS = {'m': 1e3, 'inch': 25.4, 'cm': 10.0, 'µm': 1e-3}
RADIUS = 2e-3  # a radius is wrong that differs by more than this share from the circle of the ball centres


@dataclass(frozen=True)
class Check:
    """One check of a CMM: its name, whether it is passed (None: for information), and what was found."""

    name: str
    passed: bool | None
    text: str


def check_answers(pairs: Pairs) -> dict[str, str]:
    """Return what is wrong with answered targets by the name of the check, '' where nothing is.

    A check that these targets do not allow is left out: without a move of the table nothing is known of its travel."""
    moves = [_Move(before, after) for before, after in pairwise(pairs) if _is_move(before, after)]
    found = {'stamps': _stamps(pairs)}
    if len(moves) > 1:
        found |= {'travel': _travel(moves), 'approach': _approach(moves)}
    found['places'] = _echo(pairs)
    repeated = np.array([answer.centre for target, answer in pairs if target.phase == Phase.REPEATABILITY])
    found['resolution'] = _resolution([answer.centre for _, answer in pairs], repeated)
    if len(repeated) > 1:
        same = not np.ptp(repeated, axis=0).any() and not (found['resolution'] or found['places'])
        found['repeatability'] = (f'the {len(repeated)} readings of the repeatability check are all the same; does the '
                                  'CMM measure anew each time?' if same else '')
    return found


def remarks_on_answers(pairs: Pairs) -> tuple[str, ...]:
    """Return what is wrong with answered targets, in words."""
    return tuple(filter(None, check_answers(pairs).values()))


def remark_on_two_answers(apart: Mapping[str, float]) -> tuple[str, ...]:
    """Return which targets have two answers, in words; apart: by how much they differ, m, by target."""
    if not apart:
        return ()
    first, *others = apart
    more = f'; so have {len(others)} more targets' if others else ''
    return (f'{first} has two answers that differ by {micrometres(apart[first])}, of which the first counts{more}; did '
            'a second node answer? Measure again with one CMM',)


def remarks_on_table(run: Run, step: float, is_timed: bool) -> tuple[str, ...]:
    """Return what is wrong with the readings of a table, in words.

    step: to which its coordinates are rounded, m; is_timed: whether it has times."""
    same = f'the time is the same in all {run.size} readings: effects in time cannot be found'
    found = (same if run.size > 1 and not np.ptp(run.time) else '', resolution_words(step, run.repeatability))
    return (*filter(None, found), *_remarks_on_units(run, is_timed), *remarks_on_run(run))


def is_in_seconds(time: Floats) -> bool:
    """Return whether readings follow each other as those of a CMM do, or all at one time."""
    step = _pace(time)
    return not step or PACES[0] <= step <= PACES[1]


def _pace(time: Floats) -> float:
    """Return the time from one reading to the next, median, s."""
    return float(np.median(np.diff(time))) if time.size > 1 else 0.0


def _remarks_on_units(run: Run, is_timed: bool) -> tuple[str, ...]:
    """Return which quantities of a table cannot be in the unit of their column, in words."""
    found = []
    if is_timed and not is_in_seconds(run.time):
        step = _pace(run.time)
        unit = min(_TIMES, key=lambda unit: abs(np.log(step * _TIMES[unit] / USUAL_PACE)))
        found.append(f'ball centres are {significant(step, 2)} s apart, {"quicker" if step < 1 else "slower"} than a '
                     f'CMM measures; is time_s in {unit}, which would be {significant(step * _TIMES[unit], 2)} s? give '
                     'seconds; until then effects in time cannot be found')
    known, (least, most) = run.repeatability, REPEATABILITIES
    if known is not None and not least <= known <= most:
        found.append(f'the stated repeatability is {micrometres(known)}; is it in mm or m? give µm')
    return tuple(found)


def radius_words(radius: float) -> str:
    """Return why a radius, m, is not that of a plate of balls, in words; '' where it may be one."""
    if RADII[0] <= radius <= RADII[1]:
        return ''
    likely = [f'{unit} (R = {1e3 * radius * factor:.6g} mm)' for unit, factor in _LENGTHS.items()
              if 0.05 <= radius * factor <= 1]
    return (f'{UNIT_DOUBT} of R = {1e3 * radius:.6g} mm is beyond any plate of balls; are radius and coordinates in '
            f'{" or ".join(likely) or "another unit"}? give mm')


def note_on_offset(offset: float) -> tuple[str, ...]:
    """Return where the positions of a table that do not begin at angle 0 are, in words; offset: rad."""
    degrees = f'{np.rad2deg(offset):.6g} deg'
    return (f'table position 1 is at {degrees}; x and y, of the curves too, are turned by {degrees} against a run from '
            'angle 0, and evaluated with such a run (--joint) are those of angle 0',) if offset else ()


def temperature_words(temperature: Floats) -> str:
    """Return why temperatures, °C, NaN where not measured, are not those of a CMM's room, in words; '' where they are.

    A thermometer that is missing, or a field that nobody sets, gives 0.
    """
    known = temperature[np.isfinite(temperature)]
    if not known.size or (TEMPERATURES[0] <= known.min() and known.max() <= TEMPERATURES[1]):
        return ''
    if zeros := int(np.count_nonzero(known == 0)):
        return (f'the temperature is 0 °C in {zeros} of {temperature.size} readings; was it measured? Leave it empty '
                '(in messages NaN) where it was not')
    return f'the temperature is {known.min():.2f} to {known.max():.2f} °C; is it in °F or K? give °C'


def known_temperatures(run: Run) -> Floats:
    """Return the temperatures that were measured, °C, of all that states or uses one; none where they cannot be."""
    known = run.temperature[np.isfinite(run.temperature)]
    return known[:0] if temperature_words(known) else known


def remarks_on_run(run: Run) -> tuple[str, ...]:
    """Return what is wrong with the readings of a table or a log, in words: radius, temperature, gaps."""
    return (*filter(None, [radius_words(run.radius), temperature_words(run.temperature)]), *_remarks_on_gaps(run),
            *_remarks_on_radius(run))


def _remarks_on_gaps(run: Run) -> tuple[str, ...]:
    """Return between which readings too much time lies, in words, but for pauses that are stated and for waits before
    readings that are made again."""
    cell = run.table_position * (run.n + 1) + run.ball
    again = np.setdiff1d(np.arange(run.size), np.unique(cell, return_index=True)[1])
    (least, paces), gap = LONG_GAP, np.diff(run.time[:again[0]] if again.size else run.time)
    long = np.flatnonzero((gap > max(least, paces * _pace(run.time))) & (np.diff(run.session)[:gap.size] == 0))
    places = ', '.join(f'{one + 1} and {one + 2} ({gap[one] / 60:.0f} min)' for one in long[:MOST_GAPS].tolist())
    return (f'much time lies between readings {places}; was the clock changed, as to summer time, or the run '
            'interrupted? Correct the times, or state pauses_before',) if places else ()


def _remarks_on_radius(run: Run) -> tuple[str, ...]:
    """Return that the stated radius is not that of the circle of ball centres, in words; nothing where it is."""
    lies = float(np.mean(np.hypot(run.centre[:, 0], run.centre[:, 1])))
    if abs(lies / run.radius - 1) > RADIUS:
        return (f'the ball centres lie on a circle of R = {1e3 * lies:.3f} mm, not of {1e3 * run.radius:.6g} mm as '
                'stated; correct the radius of the plate',)
    return ()


def resolution_words(step: float, repeatability: float | None) -> str:
    """Return that coordinates are rounded to steps larger than the repeatability, m; '' where they are not."""
    if not step or (repeatability is not None and step <= repeatability):
        return ''
    beside = '' if repeatability is None else f', more than the repeatability of {micrometres(repeatability, 2)}'
    return f'{ROUNDED} {1e6 * step:g} µm{beside}; give every digit that the CMM has'


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


def _stamps(pairs: Pairs) -> str:
    stamps = [answer.stamp_ns for _, answer in pairs]
    zero, alike = stamps.count(0), len(stamps) - len(set(stamps))  # the first of an imported run is 0
    words = f'0 in {zero}' if zero > 1 else f'the same as another in {alike}'
    if alike:
        return (f'header.stamp is {words} of {len(stamps)} answers: effects in time cannot be found; give the mean '
                'time of the touches')
    once = sorted(((target.session, target.seq, answer.stamp_ns) for target, answer in pairs if target.attempt == 1))
    back, seq = min(((after[2] - before[2], before[1]) for before, after in pairwise(once) if before[0] == after[0]),
                    default=(0, 0))
    return (f'the clock was set back by {-1e-9 * back:.3g} s after target {seq}: times and the order of the readings '
            'are wrong, and so are effects in time; measure again with a clock that runs evenly') if back < 0 else ''


def _travel(moves: Sequence[_Move]) -> str:
    wrong = [move for move in moves if abs(move.travelled - move.asked) > SAME_TURN]
    if not wrong:
        return ''
    if all(move.travelled == 0 for move in moves):
        what = f'stays the same in {len(moves)} moves of the table'
    elif all(abs(wrap(move.travelled - move.asked)) < SAME_TURN for move in wrong):
        what = f'is not cumulative: it jumps by whole turns in {len(wrong)} of {len(moves)} moves'
    else:
        what = (f'changes by {wrong[0].travelled:.6g} where the table was asked to turn by {wrong[0].asked:.6g} rad, '
                f'in {len(wrong)} of {len(moves)} moves')
    return f'table_travel {what}; count on over full turns, backwards too, in rad'


def _approach(moves: Sequence[_Move]) -> str:
    wrong = [move for move in moves if move.approach != move.sense]
    if not wrong:
        return ''
    what = 'always 0' if not any(move.approach for move in moves) else 'not the asked sense'
    return (f'approach is {what} after {len(wrong)} of {len(moves)} moves of the table; give the sense of its last '
            'move, +1 or -1')


def _echo(pairs: Pairs) -> str:
    away = np.array([np.subtract(answer.centre, target.centre) for target, answer in pairs
                     if target.frame_id == answer.frame_id]).reshape(-1, 3)
    echoed = int(np.count_nonzero(np.abs(away).max(axis=1, initial=0) < ECHO)) if len(away) else 0
    return (f'{echoed} of {len(pairs)} answers are exactly the place where the ball was expected: is it measured? The '
            'curves would be those of a perfect table') if 2 * echoed > len(pairs) else ''


def _resolution(centres: ArrayLike, repeated: Floats) -> str:
    spread = float(np.sqrt(np.mean(np.var(repeated, axis=0, ddof=1)))) if len(repeated) > 1 else 0.0
    known = spread if spread > ECHO else None  # all the same: not 0 to the last bit
    return resolution_words(resolution_of(centres), known)

# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the readings of a run, and how they were read, in words."""

from collections.abc import Callable, Mapping, Sequence
from math import pi

from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.number_words import micrometres, significant
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.remarks import Remark, RemarkKind

MOST_GAPS = 3


def remark_words(one: Remark) -> str:
    """Return what is wrong, and after '; ' what to do: 'readings are rounded to 1 µm; give every digit ...'."""
    return '; '.join(filter(None, _SAYS[one.kind](**one.numbers)))


def fact_words(one: Remark) -> str:
    """Return what is wrong, without what to do."""
    return _SAYS[one.kind](**one.numbers)[0]


def notes_of(run: Run) -> tuple[str, ...]:
    """Return how the readings of a run were read, in words, with where its table position 1 is."""
    if not run.table_offset:
        return run.notes
    degrees = f'{180 / pi * run.table_offset:.6g} deg'
    return (*run.notes,
            f'table position 1 is at {degrees}; x and y, of the curves too, are turned by {degrees} against a run from '
            'angle 0, and evaluated with such a run (--joint) are those of angle 0')


def readings_notes(readings: Readings) -> tuple[str, ...]:
    """Return the same of one of several runs, with what is wrong with its readings."""
    run = readings.run
    return (*notes_of(run), *map(remark_words, run.remarks)) if run else readings.notes


def _log_damaged(problem: str, others: int) -> tuple[str, str]:
    more = f', and {others} more problems' if others else ''
    return f'the log is damaged: {problem}{more}', 'rosette info lists them' if others else ''


def _two_answers(target: str, apart: float, others: int) -> tuple[str, str]:
    more = f'; so have {others} more targets' if others else ''
    return (f'{target} has two answers that differ by {micrometres(apart)}, of which the first counts{more}',
            'did a second node answer? Measure again with one CMM')


def _same_stamps(zeros: int, alike: int, answers: int) -> tuple[str, str]:
    words = f'0 in {zeros}' if zeros > 1 else f'the same as another in {alike}'
    return (f'header.stamp is {words} of {answers} answers: effects in time cannot be found',
            'give the mean time of the touches')


def _same_time(readings: int) -> tuple[str, str]:
    return f'the time is the same in all {readings} readings: effects in time cannot be found', ''


def _clock_set_back(seconds: float, seq: int) -> tuple[str, str]:
    return (f'the clock was set back by {seconds:.3g} s after target {seq}: times and the order of the readings are '
            'wrong, and so are effects in time', 'measure again with a clock that runs evenly')


def _travel(what: str) -> tuple[str, str]:
    return f'table_travel {what}', 'count on over full turns, backwards too, in rad'


def _travel_differs(travelled: float, asked: float, wrong: int, moves: int) -> tuple[str, str]:
    return _travel(f'changes by {travelled:.6g} where the table was asked to turn by {asked:.6g} rad, in {wrong} of '
                   f'{moves} moves')


def _approach(what: str, wrong: int, moves: int) -> tuple[str, str]:
    return (f'approach is {what} after {wrong} of {moves} moves of the table',
            'give the sense of its last move, +1 or -1')


def _echo(echoed: int, answers: int) -> tuple[str, str]:
    return (f'{echoed} of {answers} answers are exactly the place where the ball was expected: is it measured? The '
            'curves would be those of a perfect table', '')


def _rounded(step: float, repeatability: float | None) -> tuple[str, str]:
    beside = '' if repeatability is None else f', more than the repeatability of {micrometres(repeatability, 2)}'
    return f'readings are rounded to {1e6 * step:g} µm{beside}', 'give every digit that the CMM has'


def _unit_of_time(step: float, usual: float, unit: str, in_unit: float, is_used: bool) -> tuple[str, str]:
    lost = '' if is_used else '; until then effects in time cannot be found'
    return (f'ball centres are {significant(step, 2)} s apart, {"quicker" if step < usual else "slower"} than a CMM '
            'measures and the table turns', f'is time_s in {unit}, which would be {significant(in_unit, 2)} s? give '
            f'seconds{lost}')


def _unit_of_coordinates(radius: float, likely: Mapping[str, float]) -> tuple[str, str]:
    units = ' or '.join(f'{unit} (R = {1e3 * one:.6g} mm)' for unit, one in likely.items())
    return (f'a circle of ball centres of R = {1e3 * radius:.6g} mm is beyond any plate of balls',
            f'are radius and coordinates in {units or "another unit"}? give mm')


def _gaps(after: Sequence[tuple[int, float]]) -> tuple[str, str]:
    places = ', '.join(f'{reading} and {reading + 1} ({gap / 60:.0f} min)' for reading, gap in after[:MOST_GAPS])
    return (f'much time lies between readings {places}',
            'was the clock changed, as to summer time, or the run interrupted? Correct the times, or state '
            'pauses_before')


def _not_finite(centre: Sequence[float], angle: float, travel: float) -> tuple[str, str]:
    return f'expected finite numbers, found centre {centre}, table_angle {angle}, table_travel {travel}', ''


def _other_frame(frames: Sequence[str], got: str) -> tuple[str, str]:
    most = ' as in most answers' if len(frames) == 1 else ''
    return f'expected frame_id {" or ".join(map(repr, frames))}{most}, found {got!r}', ''


def _other_angle(limit: float, wanted: float, got: float, is_in_degrees: bool) -> tuple[str, str]:
    return (f'expected the table within {limit:g} rad of {wanted:.6f} rad, found {got:.6f} rad',
            'that is degrees, give radians' if is_in_degrees else '')


def _far_away(limit: float, away: float, is_in_millimetres: bool) -> tuple[str, str]:
    return (f'expected a ball within {1e3 * limit:g} mm of the target, found {1e3 * away:.3f} mm',
            'these are millimetres, give metres' if is_in_millimetres else '')


_SAYS: Mapping[str, Callable[..., tuple[str, str]]] = {
    RemarkKind.LOG_DAMAGED: _log_damaged,
    RemarkKind.TWO_ANSWERS: _two_answers,
    RemarkKind.SAME_STAMPS: _same_stamps,
    RemarkKind.SAME_TIME: _same_time,
    RemarkKind.CLOCK_SET_BACK: _clock_set_back,
    RemarkKind.TRAVEL_STAYS: lambda moves: _travel(f'stays the same in {moves} moves of the table'),
    RemarkKind.TRAVEL_JUMPS: lambda wrong, moves: _travel(
        f'is not cumulative: it jumps by whole turns in {wrong} of {moves} moves'),
    RemarkKind.TRAVEL_DIFFERS: _travel_differs,
    RemarkKind.NO_APPROACH: lambda wrong, moves: _approach('always 0', wrong, moves),
    RemarkKind.OTHER_APPROACH: lambda wrong, moves: _approach('not the asked sense', wrong, moves),
    RemarkKind.ECHO: _echo,
    RemarkKind.ROUNDED: _rounded,
    RemarkKind.REPEATED_ALIKE: lambda readings: (
        f'the {readings} readings of the repeatability check are all the same', 'does the CMM measure anew each time?'),
    RemarkKind.UNIT_OF_TIME: _unit_of_time,
    RemarkKind.UNIT_OF_REPEATABILITY: lambda repeatability: (
        f'the stated repeatability is {micrometres(repeatability)}', 'is it in mm or m? give µm'),
    RemarkKind.UNIT_OF_COORDINATES: _unit_of_coordinates,
    RemarkKind.UNIT_OF_TEMPERATURE: lambda least, most: (
        f'the temperature is {least:.2f} to {most:.2f} °C', 'is it in °F or K? give °C'),
    RemarkKind.NO_TEMPERATURE: lambda zeros, readings: (
        f'the temperature is 0 °C in {zeros} of {readings} readings',
        'was it measured? Leave it empty (in messages NaN) where it was not'),
    RemarkKind.SAME_TEMPERATURE: lambda temperature, readings, seconds: (
        f'the temperature is {temperature:.6g} °C in all {readings} readings of {seconds / 60:.0f} min',
        'was it measured? It is taken as not known; leave it empty where it was typed in or the thermometer stood still'
        ),
    RemarkKind.GAPS: _gaps,
    RemarkKind.OTHER_RADIUS: lambda lies, stated: (
        f'the ball centres lie on a circle of R = {1e3 * lies:.3f} mm, not of {1e3 * stated:.6g} mm as stated',
        'correct the radius of the plate'),
    RemarkKind.OTHER_BALL: lambda wanted, got: (f'expected table position, ball, CMM position {wanted}, found '
                                                f'{got}', ''),
    RemarkKind.CMM_FAILED: lambda reason: (f'the CMM reports: {reason or "failed, without a reason"}', ''),
    RemarkKind.NOT_FINITE: _not_finite,
    RemarkKind.OTHER_FRAME: _other_frame,
    RemarkKind.OTHER_ANGLE: _other_angle,
    RemarkKind.FAR_AWAY: _far_away}

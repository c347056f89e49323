# SPDX-License-Identifier: Apache-2.0
"""What runs that are evaluated as one determine, and what is said of them, in words."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import pi

from rosette_ros.core.joint.knowledge import MEANS, JointRemark, Part
from rosette_ros.core.run.remarks import Remark
from rosette_ros.words.effect_words import names
from rosette_ros.words.motion_words import titles
from rosette_ros.words.verdict_words import kind_words


def part_words(every: Iterable[Remark]) -> tuple[str, ...]:
    """Return what is determined, or what is not: 'table clockwise: mean of crz', 'harmonics 12'."""
    return tuple(f'{one.numbers["of"]}: {_part(one)}' if one.numbers['of'] else _part(one) for one in every)


def note_words(one: Remark) -> str:
    """Return a remark on several runs, as a part of a sentence."""
    return _NOTES[one.kind](**one.numbers)


def _part(one: Remark) -> str:
    numbers = one.numbers
    match one.kind:
        case Part.HARMONICS:
            return _harmonics(numbers['waves'])
        case Part.HARMONICS_UP_TO:
            but = f' except {_spans(numbers["without"])}' if numbers['without'] else ''
            return f'harmonics up to {numbers["highest"]}{but}, at {numbers["angles"]} table angles'
        case Part.REVERSAL:
            return f'the reversal of all six curves, {_with_or_but(numbers["without"], numbers["waves"])}'
    return _PARTS[one.kind]


def _with_or_but(parts: Sequence[Part], waves: Sequence[int]) -> str:
    """Return that a reversal is known with its means, or what of it is not."""
    if not parts and not waves:
        return 'with its means'
    has_no_mean = {*MEANS} <= {*parts}
    but = ['means'] * has_no_mean + [_PARTS[one] for one in parts if not (has_no_mean and one in MEANS)]
    return f'but for its {", ".join([*but, *[_harmonics(waves)] * bool(waves)])}'


def _harmonics(waves: Iterable[int]) -> str:
    return f'harmonics {_spans(waves)}'


def _spans(rising: Iterable[int]) -> str:
    """Return rising numbers as text, such as 2, 5 to 8."""
    spans = list[list[int]]()
    for one in rising:
        if spans and one == spans[-1][1] + 1:
            spans[-1][1] = one
        else:
            spans.append([one, one])
    return ', '.join(str(low) if low == high else f'{low} to {high}' for low, high in spans)


def _turned(run: str, against: str, turn: float) -> str:
    return (f'{run}: the deviations of the balls show that the plate was turned by {180 / pi * turn:.6g}° against '
            f'{against}')


def _no_reversal(of: str, angles: Sequence[float], lacks: int) -> str:
    return (f'{of}: no reversal at {", ".join(f"{180 / pi * angle:.6g}" for angle in angles)} deg, where nothing was '
            f'measured {"counter-" * (lacks > 0)}clockwise')


_PARTS: Mapping[str, str] = {
    Part.RADIAL: 'mean of ctx and cty',
    Part.AXIAL: 'mean of ctz',
    Part.TILT: 'mean of crx and cry',
    Part.ANGULAR: 'mean of crz',
    Part.ECCENTRICITY: 'once-per-turn part of (ctx, cty): eccentricity',
    Part.WOBBLE: 'once-per-turn part of (crx, cry): tilt',
    Part.SCALE: 'radial scale of plate and CMM',
    Part.HEIGHT: 'height and turn about z between plate and CMM'}

_NOTES: Mapping[str, Callable[..., str]] = {
    JointRemark.FRAMES_APART: lambda: (
        'each run has determined its table frame anew, so what differs by a displacement or a turn of the frame is not '
        'compared'),
    JointRemark.ONE_SENSE: lambda: (
        'too little was measured clockwise, or counter-clockwise, for curves of both senses'),
    JointRemark.NOT_IN_U: lambda run: (
        f'{run}: what its order hides is not in U, as its plate is of no regular pitch'),
    JointRemark.EFFECTS: lambda run, effects: f'{run}: in its model: {titles(effects)}',
    JointRemark.NOISE: lambda run, kinds: f'{run}: its noise: {names(map(kind_words, kinds))}',
    JointRemark.TURNED: _turned,
    JointRemark.NO_REVERSAL: _no_reversal}

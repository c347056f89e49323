# SPDX-License-Identifier: Apache-2.0
"""What a missing effect does in this run, in words: which body moves by how much, where and when."""

from collections.abc import Sequence

from rosette_ros.core.diagnosis.verdict import MissingEffect
from rosette_ros.core.effects import motions as move
from rosette_ros.core.effects.effect import Motion, PhysicalEffect
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.words.effect_words import MEANINGS, between_words, decimals, fixed, scale_of, setting_words

MOVES: dict[type[Motion], str] = {
    move.FrameAxes: 'the probe moves', move.TableTurn: 'the table turns', move.AxisTilt: 'the table axis tilts',
    move.AxisShiftAndTilt: 'the table axis moves', move.TableAxial: 'the table grows',
    move.PlateSlide: 'the plate moves', move.PlateSlideAndTurn: 'the plate moves', move.PlateGrowth: 'the plate grows',
    move.PlateOnSupports: 'the plate tilts', move.PlateSaddle: 'the plate warps', move.PlateBending: 'the plate bends',
    move.BallInPlate: 'a ball moves', move.AlongTableFrame: 'the ball centre is off',
    move.BallForm: 'the balls are not round', move.CmmScales: 'the scales of the CMM grow',
    move.CmmSquareness: 'the angle between x and y changes', move.CmmReversal: 'the CMM lags',
    move.CmmReversalByPosition: 'the CMM lags', move.ProbeDeflection: 'the ball centre is off'}
"""What each motion does, before 'by' and a size."""
SIGNIFICANT = 2.0
"""Standard uncertainties from which on a component is said; the largest always is."""
MOST_SIZES = 3
SAID_ELSEWHERE = ('axes', 'ball', 'reading', 't0', 't1')


def does_words(one: MissingEffect) -> str:
    """Return what it does: 'ball 11 moves by 1.92 µm in x between 37.4 and 49.7 min'; a base term: its meaning."""
    effect = MEANINGS.get(one.name)
    if not isinstance(effect, PhysicalEffect):
        return effect.meaning if effect else ''
    verb, setting = MOVES[type(effect.motion)], one.setting
    for key in ('ball', 'reading'):
        number = str(setting.get(key, ''))
        if number.isdigit():
            who = f'{key} {number}' if number != '0' else f'every {key}'
            verb = f'{who} {"moves" if verb.endswith("moves") else "is off"}'
    sizes = _sizes([part for part in one.parameters if part.name not in setting])
    rest = setting_words(one.name, setting, SAID_ELSEWHERE)
    return ' '.join(filter(None, [verb, f'by {sizes}' if sizes else '', _when(one), f'({rest})' if rest else '']))


def _sizes(parameters: Sequence[Parameter]) -> str:
    """Return the sizes of amplitudes, those along one axis and of one unit together: '2.52 µm/h in x, 1.54 in z'."""
    groups: dict[tuple[str, str], list[Parameter]] = {}
    for one in parameters:
        axis = one.name[-1] if one.name[-2:] in ('_x', '_y', '_z') else ''
        groups.setdefault((one.unit, axis), []).append(one)
    found = []
    for (unit, axis), some in groups.items():
        value = some[0].value if len(some) == 1 else sum(one.value**2 for one in some)**0.5
        found.append((abs(value) / max(one.u for one in some), value, max(one.u for one in some), unit, axis))
    found.sort(key=lambda each: -each[0])
    said = [each for each in found[:MOST_SIZES] if each[0] > SIGNIFICANT] or found[:1]
    out, last = [], ''
    for _, value, u, unit, axis in sorted(said, key=lambda each: (each[3], each[4])):
        scale = scale_of(unit)
        word = '' if scale.unit == last else f' {scale.unit}'
        last = scale.unit
        out.append(f'{fixed(scale.factor * value, decimals(2 * scale.factor * u, 1))}{word}'
                   + (f' {"about" if unit.startswith("rad") else "in"} {axis}' if axis else ''))
    return ', '.join(out)


def _when(one: MissingEffect) -> str:
    """Return when it begins and ends, where that is a part of it."""
    out = []
    for name, lead, at in (('t0', '', 'from'), ('t1', 'until ', 'to')):
        if name in one.moments:
            out.append(f'{lead}{between_words(*one.moments[name])}')
        elif name in one.setting:
            out.append(f'{at} {setting_words(one.name, {name: one.setting[name]}).partition(" ")[2]}')
    return ' '.join(out)

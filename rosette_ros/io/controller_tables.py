# SPDX-License-Identifier: Apache-2.0
"""Compensation tables of controllers: LinuxCNC, SINUMERIK (ENC, CEC), HEIDENHAIN (.COM), FANUC pitch errors.

Each turns the table only: crz is what it takes. On the scale of the axis the table is at theta = sign (a - zero), and
stands beside the commanded angle a by d(a) = sign crz(theta), which the controller has to take off."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.core.run.number_words import SCALES
from rosette_ros.core.run.records import Floats
from rosette_ros.core.table.correction import Correction

MOST_LOST = 0.1
"""Share of the largest correction that straight lines between the lines of such a file may lose."""
LINUXCNC_LINES = 256
"""Lines that LinuxCNC 2.9 reads of a compensation file."""
SINUMERIK_POINTS = 200
"""Interpolation points of a table of 808D and 828D; 840D: MD38000, MD18342."""
HEIDENHAIN_POINTS, HEIDENHAIN_SLOPE = 256, 1 / 64
"""Entries of a .COM table, and the most that two in a row differ by, of their distance."""
TNC_UNIT = 1e-4
"""The distance of the entries of a .COM table is this times a power of two, deg, for TNC controls."""
FANUC_POINTS, FANUC_STEP, FANUC_TIMES = 128, 7, 100
"""Points of an axis, and the largest value of one, in detection units times the magnification, which is 100 at most."""


@dataclass(frozen=True)
class Axis:
    """The axis of a controller that turns the table: its name, its sense (-1: clockwise, as C' of ISO 841) and where it
    is at table angle 0, deg; unit: of detection, deg; count: -1 where the controller takes the values of `heidenhain`,
    `fanuc` and `sinumerik_cec` the other way."""

    name: str = 'C'
    sign: int = 1
    zero: float = 0.0
    unit: float = 1e-4
    count: int = 1

    def deviation(self, correction: Correction, angle: Floats, sense: int) -> Floats:
        """Return d at angles of the axis (m,), deg, that it came to in a sense of its own, (m,), deg."""
        theta = self.sign * np.deg2rad(np.asarray(angle) - self.zero)
        return np.asarray(self.sign * np.rad2deg(correction.errors(theta, self.sign * sense)[:, 5]) + 0.0)


def linuxcnc(correction: Correction, low: float, high: float, step: float, axis: Axis) -> tuple[str, list[str]]:
    """Return the text of a compensation file (COMP_FILE_TYPE = 1): nominal, forward and reverse trim, deg.

    low, high: MIN_LIMIT and MAX_LIMIT of the axis, which is not taken modulo a turn; step: between lines, deg. The trim
    is added to the motor. Raises InvalidConfig where LinuxCNC would not read so many lines, or crz is not in it.
    """
    lines = math.ceil((high - low) / step - 1e-9) + 1
    size, widest = _size_and_widest(correction)
    least = math.ceil((high - low) / (LINUXCNC_LINES - 1) * 1000) / 1000
    if lines > LINUXCNC_LINES and least > widest:
        raise InvalidConfig(
            f'correct: expected at most {LINUXCNC_LINES} lines, which LinuxCNC reads, no farther apart than {widest:g} '
            f'deg, found a range of {high - low:g} deg; LinuxCNC repeats no table, so narrow MIN_LIMIT and MAX_LIMIT '
            'of '
            f'the axis, and --range, to {math.floor(widest * (LINUXCNC_LINES - 1)):g} deg together')
    if lines > LINUXCNC_LINES:
        raise InvalidConfig(f'correct: expected at most {LINUXCNC_LINES} lines, which LinuxCNC reads, found {lines}; '
                            'take '
                            f'--step {least:g} to {widest:g}, or a smaller --range')
    nominal = np.append(low + step * np.arange(lines - 1), high)
    trims = [-axis.deviation(correction, nominal, sense) + 0.0 for sense in (1, -1)]
    _check_lost(correction, nominal, step, size, widest, axis)
    return ''.join(f'{angle:.6f} {forward:.9f} {backward:.9f}\n'
                   for angle, forward, backward in zip(nominal, *trims, strict=True)), []


def sinumerik_enc(correction: Correction, step: float, axis: Axis) -> tuple[str, list[str]]:
    """Return measuring system error compensation: the position plus the value is the actual one, so d, in both senses.

    K3: a positive value moves the axis in its negative direction; it is 0 at the reference point, here at 0 deg."""
    angle, values, notes = _both_senses(correction, _turn(correction, step, SINUMERIK_POINTS, 'SINUMERIK', axis), axis,
                                        'MD32450 $MA_BACKLASH')
    name = axis.name
    lines = [f'$AA_ENC_COMP[0,{place},{name}]={value:.7f}' for place, value in enumerate(values)]
    lines += [f'$AA_ENC_COMP_{key}[0,{name}]={value}' for key, value in (
        ('STEP', f'{step:g}'), ('MIN', '0.0'), ('MAX', '360.0'), ('IS_MODULO', '1'))]
    return _archive('AX_EEC', lines), [*notes, f'MD38000 $MA_MM_ENC_COMP_MAX_POINTS of {name}: {angle.size} or more. '
                                       'MD32700 $MA_ENC_COMP_ENABLE[0]: 0 before the file is loaded, 1 makes it '
                                       'active.']


def sinumerik_cec(correction: Correction, step: float, axis: Axis) -> tuple[str, list[str]]:
    """Return sag compensation with the axis as input and output: a table for both senses, or one for each."""
    angle = _turn(correction, step, SINUMERIK_POINTS, 'SINUMERIK', axis)
    both = correction.backward is not correction.forward
    zero = axis.deviation(correction, np.zeros(1), 1)
    lines = []
    for table, sense in enumerate((1, -1) if both else (0,)):
        values = axis.count * (axis.deviation(correction, angle, sense or 1) - zero)
        lines += [f'$AN_CEC[{table},{place}]={value + 0.0:.7f}' for place, value in enumerate(values)]
        lines += [f'$AN_CEC_{key}[{table}]={value}' for key, value in (
            ('INPUT_AXIS', f'({axis.name})'), ('OUTPUT_AXIS', f'({axis.name})'), ('STEP', f'{step:g}'), ('MIN', '0.0'),
            ('MAX', '360.0'), ('DIRECTION', sense), ('MULT_BY_TABLE', 0), ('IS_MODULO', 1))]
    return _archive('NC_CEC', lines), [f'MD18342 $MN_MM_CEC_MAX_POINTS of each table: {angle.size} or more. '
                                       'SD41300 $SN_CEC_TABLE_ENABLE and MD32710 $MA_CEC_ENABLE: 0 before the file is '
                                       'loaded, 1 makes it active.',
                                       _trial(axis, angle, axis.deviation(correction, angle, 1) - zero)]


def heidenhain(correction: Correction, step: float, axis: Axis) -> tuple[str, list[str]]:
    """Return a .COM table: at AXISPOS the error of the axis, positive where it goes too far; BACKLASH: backwards.

    The control takes entries of 0 to 360 deg, and begins with 0 at the datum. TNC controls want them 2^n/10^4 deg
    apart: the last one is then beyond a turn, and has the value of its angle less 360. Source: HEIDENHAIN, Technical
    Manual TNC 407/415/425, 4-26 (error: positive where the travel is too long; power of two) and 4-28 (example)."""
    angle = _turn(correction, step, HEIDENHAIN_POINTS, 'HEIDENHAIN', axis)
    zero = axis.deviation(correction, np.zeros(1), 1)
    forward, backward = (axis.deviation(correction, angle, sense) - zero + 0.0 for sense in (1, -1))
    largest = max(np.abs(np.diff(one)).max() for one in (forward, backward))
    if largest > HEIDENHAIN_SLOPE * step:
        raise InvalidConfig('correct: expected values of a .COM table that differ by at most '
                            f'{HEIDENHAIN_SLOPE * step:g} deg from one to the next, found {largest:.3g}; is the table '
                            'measured right?')
    name = f'{axis.name}.COM'
    rows = [f'{place:<6}{at:<+12.4f}{axis.count * back + 0.0:<+14.7f}{axis.count * value + 0.0:+.7f}'
            for place, (at, back, value) in enumerate(zip(angle, backward, forward))]
    head = f'{"NR":<6}{"AXISPOS":<12}{"BACKLASH":<14}{axis.name}'
    said = [] if _is_binary(step) else [
        f'TNC controls want a distance of 2^n/10^4 deg between the entries; {step:g} is none, --step '
        f'{TNC_UNIT * 2 ** math.floor(math.log2(step / TNC_UNIT)):g} is one.']
    return '\n'.join((f'BEGIN {name} MM', head, *rows, '[END]', '')), [
        *said,
        f'Enter {name} in the column {axis.name} of the active line of the .CMA table.', _trial(axis, angle, forward)]


def fanuc(correction: Correction, step: float, axis: Axis) -> tuple[str, list[str]]:
    """Return pitch error data: by how many detection units the axis goes farther at each point than at the one before.

    N10000 is the reference position, at 0 deg of the axis; its value is that of the last point. Source: FANUC, Series
    0i Parameter Manual B-63980EN, pp. 99-100, which does not state in words what a positive value does."""
    angle, values, notes = _both_senses(correction, _turn(correction, step, FANUC_POINTS, 'FANUC', axis), axis,
                                        'parameter 1851')
    for times in range(1, FANUC_TIMES + 1):
        steps = np.diff(np.rint(-axis.count * values / (axis.unit * times))).astype(int)
        if np.abs(steps).max() <= FANUC_STEP:
            break
    else:
        raise InvalidConfig(f'correct: expected steps of at most {FANUC_STEP} times {FANUC_TIMES} detection units, '
                            'found '
                            f'more with {axis.unit:g} deg; take a smaller --step or a larger --detection-unit')
    if not steps.any():
        raise InvalidConfig('correct: expected a crz of more than half a detection unit, found less than '
                            f'{axis.unit:g} '
                            'deg; state that of the controller by --detection-unit')
    lines = [f'N{10000 + place}P{value};' for place, value in enumerate((steps[-1], *steps))]
    last = angle.size - 1
    return '\n'.join(('%', *lines, '%', '')), [
        *notes, f'Parameters of {axis.name}: 3620 = 0, 3621 = 0, 3622 = {last}, 3623 = {times}, 3624 = {step:g}, '
        f'3625 = 360 (deg); rounding to {times} times {axis.unit:g} deg leaves up to {1800 * times * axis.unit:.2g} '
        'arcsec.', _trial(axis, angle, values)]


Writer = Callable[[Correction, float, Axis], tuple[str, list[str]]]
OF_A_TURN: dict[str, Writer] = {'sinumerik-enc': sinumerik_enc, 'sinumerik-cec': sinumerik_cec,
                                'heidenhain': heidenhain, 'fanuc': fanuc}
"""Formats of an axis that begins again after a turn."""


def _archive(name: str, lines: list[str]) -> str:
    return '\n'.join((f'%_N_{name}_INI', 'CHANDATA(1)', *lines, 'M17', ''))


def _turn(correction: Correction, step: float, most: int, maker: str, axis: Axis) -> Floats:
    """Return the angles of the axis, 0 to 360 deg or just beyond; raises InvalidConfig where they cannot be."""
    size, widest = _size_and_widest(correction)
    steps = math.ceil(360 / step - 1e-9)
    if abs(steps * step - 360) > 1e-9 and not (maker == 'HEIDENHAIN' and _is_binary(step)):
        raise InvalidConfig(f'correct: expected a --step that divides a turn, found {step:g} deg')
    if steps + 1 > most:
        raise InvalidConfig(f'correct: expected at most {most} points, which a table of {maker} holds, found '
                            f'{steps + 1}; '
                            f'take a --step from {360 / (most - 1):.3g} to {widest:g}')
    angle: Floats = step * np.arange(steps + 1.0)
    _check_lost(correction, angle, step, size, widest, axis)
    return angle


def _is_binary(step: float) -> bool:
    """Return whether a distance is a power of two of the unit of TNC controls."""
    return abs(math.frexp(round(step / TNC_UNIT, 6))[0] - 0.5) < 1e-12


def _both_senses(correction: Correction, angle: Floats, axis: Axis, backlash: str) -> tuple[Floats, Floats, list[str]]:
    """Return angles, d in the mean of both senses (0 at 0 deg), and where the reversal goes, in words."""
    forward, backward = (axis.deviation(correction, angle, sense) for sense in (1, -1))
    mean = (forward + backward) / 2
    notes = [] if correction.backward is correction.forward else [
        'The format has one value for both senses: it is their mean; the reversal of '
        f'{3600 * np.mean((forward - backward)[:-1]):.2f} arcsec (forward minus backward, mean) goes into {backlash}.']
    return angle, mean - mean[0] + 0.0, notes


def _trial(axis: Axis, angle: Floats, values: Floats) -> str:
    """Return how the sign of a table is tried at the angle of its largest value, in words."""
    at = int(np.abs(values[:-1]).argmax())
    off = 3600 * values[at]
    return (f'Try the sign first, the manuals do not state it for every version: from {axis.name} = 0 to {angle[at]:g} '
            f'deg the table turns {abs(off):.2f} arcsec too {"far" if off > 0 else "little"}; with the file active it '
            'is right within U. Where it is twice as much, write the file again with --invert.')


def _size_and_widest(correction: Correction) -> tuple[float, float]:
    """Return the largest crz, rad, and how far apart lines may be that lose little, deg; raises InvalidConfig."""
    if 'crz' not in correction.corrected:
        raise InvalidConfig('correct: expected crz among the errors to correct, since a compensation file turns the '
                            f'table only, found {", ".join(correction.corrected)}')
    turn = np.deg2rad(np.arange(0.0, 360.0, 0.25))
    size = float(max(np.abs(correction.errors(turn, sense)[:, 5]).max() for sense in (1, -1)))
    bound = correction.curvature()[5] / 8
    return size, math.floor(1e3 * np.rad2deg(np.sqrt(MOST_LOST * size / bound))) / 1e3 if bound else 360.0


def _check_lost(correction: Correction, nominal: Floats, step: float, size: float, widest: float, axis: Axis) -> None:
    """Raise InvalidConfig where straight lines between the lines of a table lose too much of crz."""
    between = nominal[0] + (nominal[-1] - nominal[0]) * np.arange(40 * nominal.size) / (40 * nominal.size - 1)
    lost = max(np.abs(np.interp(between, nominal, axis.deviation(correction, nominal, sense))
                      - axis.deviation(correction, between, sense)).max() for sense in (1, -1))
    factor, unit = SCALES['rad']
    if np.deg2rad(lost) > MOST_LOST * size:
        raise InvalidConfig(f'correct: expected lines between which straight lines lose at most {MOST_LOST:.0%} of '
                            'crz, '
                            f'found --step {step:g}, which loses {factor * np.deg2rad(lost):.3g} of '
                            f'{factor * size:.3g} {unit}; take --step {widest:g} or less')

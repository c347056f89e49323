# SPDX-License-Identifier: Apache-2.0
"""Numbers, units and names as a person reads them: µm, µrad or arcsec, mm, min, p-values, settings of effects."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from rosette_ros.core.model.least_squares import Fit, Parameter
from rosette_ros.core.model.model import Model
from rosette_ros.core.run import axes
from rosette_ros.core.run.number_words import UNKNOWN, Scale, micrometres, multiple, p_words, significant
from rosette_ros.core.run.records import CURVES, SI_UNITS, Floats, Run
from rosette_ros.core.run.scheme import cmm_position
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.words.effect_words import (
    MEANINGS,
    MICRO_DECIMALS,
    capital,
    decimals,
    exact,
    fixed,
    scale_of,
    setting_words,
    title_of,
)

P_VALUE, CROSS_VALIDATION, SENSITIVITY, LIMIT = (
    'p-value', 'cross-validation residual', 'sensitivity', 'detection limit')
"""Terms that every interface uses in the same words."""
_GLUED = re.compile(r'(?<=\d) (?=(?:µ|mm\b|ppm\b|min\b|h\b|s\b|%|°|σ|→))|(?<=[±→=]) (?=[\d−])|(?<=[kR]) (?==)|'
                    r'(?<=\)) (?=/)|(?<=/) (?=µ)')
DATED = 10**17
"""Earlier times, ns since the epoch (March 1973), are no dates: those of an imported table count from its start."""
MOST_MISSING = 5
SEQUENCES = {
    'row': 'balls within table position', 'diagonal': 'table positions within CMM position',
    'column': 'table positions within ball', 'random': 'randomised', 'interleaved': 'interleaved sweeps of the table',
    'there_and_back': 'table positions within CMM position, then backwards',
    'row_there_and_back': 'balls within table position, then backwards', 'as measured': 'no order with a name'}
"""What an order is, as a document says it."""


def curve_scales() -> tuple[Scale, ...]:
    """Return how the six curves are shown: in µm, and in the unit of small angles."""
    return tuple(map(scale_of, SI_UNITS.values()))


def curve_factors() -> Floats:
    """Return the factors of `curve_scales` (6,)."""
    return np.array([one.factor for one in curve_scales()])


def curve_units() -> tuple[str, ...]:
    """Return the units of `curve_scales`."""
    return tuple(one.unit for one in curve_scales())


def file_unit(unit: str) -> str:
    """Return how a unit ends a key: um, urad, arcsec."""
    return unit.replace('µ', 'u')


def sized(value: float, si: str = 'rad', places: int = 2) -> str:
    """Return a small angle or length, SI, with its unit, as exact as with so many decimals of a µrad or µm."""
    factor, unit = scale_of(si)
    return f'{fixed(factor * value, places + (factor < 1e6))} {unit}'


def sequence_words(order: str) -> str:
    """Return an order, with what follows its name, as a document says it: 'balls within table position (row)'."""
    name, comma, rest = order.partition(',')
    return f'{SEQUENCES[name]} ({name}){comma}{rest}' if name in SEQUENCES else order


def iso_name(curve: str, rotation: Floats | None) -> str:
    """Return the name of a curve after ISO 230-1, with a minus sign where it counts the other way."""
    return axes.iso_names(rotation)[curve].replace('-', '−')


def curve_names(rotation: Floats | None) -> tuple[str, ...]:
    """Return the names of the six curves by both standards: ctx (EXC)."""
    return tuple(f'{curve} ({iso_name(curve, rotation)})' for curve in CURVES)


def iso_range(rotation: Floats | None) -> str:
    """Return the first and the last of the ISO names, between which the others are: EXC … ECC."""
    return f'{iso_name(CURVES[0], rotation)} … {iso_name(CURVES[-1], rotation)}'


def axis_words(rotation: Floats | None) -> str:
    """Return how the table stands in the machine, rotation: as of Run; '' where that is not known."""
    if rotation is None:
        return ''
    axis, ball = (', '.join(f'{value + 0.0:.4f}' for value in np.round(rotation[:, place], 4)) for place in (2, 0))
    note = axis_note(rotation)
    return f'({axis}) in the machine, ball 1 at ({ball}){f"; {note}" if note else ""}'.replace('-', '−')


def axis_note(rotation: Floats | None) -> str:
    """Return what the ISO names of the curves of a table mean, '' where its axis is along z of the machine."""
    along = axes.machine_axis(rotation)
    if along == (2, 1):
        return ''
    if along is None:
        return ('the table axis is oblique to the machine: in the ISO names X, Y, Z are the axes of the table frame, C '
                'is the table axis')
    axis, sense = along
    minus, name = '−' * (sense < 0), axes.LETTERS[axis]
    counted = ', a minus sign: counted against the axis of the machine' if sense < 0 else ''
    turned = axes.azimuth(rotation) if rotation is not None else 0.0
    across = f'; the letters across the axis are turned by {np.rad2deg(turned):.1f}° as ball 1 is' if (
        abs(turned) > axes.ALONG) else ''
    return (f'the table axis is along {minus}{name} of the machine, {("an A", "a B", "a C")[axis]} axis in the ISO '
            f'names{counted}{across}; x, y, z are those of the table frame').replace('-', '−')


def at_least(value: float, places: int) -> str:
    """Return a number of 0 or more with so many decimals, 0 where it is 0, '<0.001' where they would not show it."""
    least = 10.0**-places
    return '0' if not value else f'<{fixed(least, places)}' if value < least / 2 else fixed(value, places)


def signed(value: float, places: int) -> str:
    """Return a number with its sign and a fixed number of decimals, never −0."""
    return f'{round(value, places) + 0.0:+.{places}f}'.replace('-', '−') if math.isfinite(value) else UNKNOWN


def micro(value: float, places: int = MICRO_DECIMALS) -> str:
    """Return metres as µm, without the unit."""
    return fixed(1e6 * value, places)


def millimetres(metres: float) -> str:
    """Return a length with as many decimals as it needs: 182.5 mm."""
    return f'{exact(1e3 * metres, 6)} mm'


def before_after(before: float, after: float) -> str:
    """Return how a residual changes: '0.541 → 0.103' (µm)."""
    return f'{micro(before)} → {micro(after)}' if math.isfinite(before) or math.isfinite(after) else UNKNOWN


def percent(share: float) -> str:
    """Return a share from 0 to 1 in percent."""
    return f'{fixed(100 * share, 0)} %' if math.isfinite(share) else UNKNOWN


def sigmas(value: float) -> str:
    """Return a multiple of the standard deviation."""
    return f'{exact(value, 1) if 0.1 <= value < 100 else significant(value, 2) if value < 0.1 else fixed(value, 0)} σ'


def duration(seconds: float) -> str:
    """Return a duration: 41 s, 12 min, 1 h 52 min."""
    if seconds < 90:
        return f'{seconds:.3g} s'
    minutes = round(seconds / 60)
    return f'{minutes} min' if minutes < 90 else f'{minutes // 60} h {minutes % 60} min'


def seconds_of(run: Run) -> float:
    """Return the time from the first reading of a run to the last, s; 0 where its times only count readings."""
    return float(np.ptp(run.time)) if run.time_unit == 's' else 0.0


def run_duration(seconds: float) -> str:
    """Return how long the readings of a run took, which is less than its log lasts; '' for one reading."""
    return f'{duration(seconds)} from the first ball of the run to the last' if seconds else ''


def instant(stamp_ns: int) -> str:
    """Return a time in ns since the epoch as date and time of day, '' where it counts from another origin."""
    return '' if stamp_ns < DATED else f'{datetime.fromtimestamp(stamp_ns * 1e-9, UTC):%Y-%m-%d %H:%M:%S UTC}'


def glued(text: str) -> str:
    """Return a text in which no line breaks between a number and its unit, nor in `k = 2`."""
    return _GLUED.sub('\u00a0', text)


def signs(text: str) -> str:
    """Return a text with minus signs in its numbers."""
    return re.sub(r'(?<![\w.-])-(?=\d)', '−', text)


def joined(parameters: 'Sequence[Parameter]') -> 'list[Parameter]':
    """Return parameters, those of one unit that are not determined as one: a_1_2 … bz_12_5 (192)."""
    groups: dict[object, list[Parameter]] = {}
    for one in parameters:
        groups.setdefault(one.name if math.isfinite(one.u) else (one.unit,), []).append(one)
    return [first if len(group) == 1 else replace(first, name=f'{first.name} … {group[-1].name} ({len(group)})')
            for group in groups.values() for first in group[:1]]


def sized_parameter(parameter: Parameter) -> tuple[float, float]:
    """Return value and expanded uncertainty of a parameter in the unit in which it is shown."""
    factor = scale_of(parameter.unit, parameter.name).factor
    return factor * parameter.value, COVERAGE_FACTOR * factor * parameter.u


def shown_parameter(parameter: Parameter) -> tuple[str, str, str]:
    """Return value, expanded uncertainty and unit of a parameter."""
    scale, (value, spread) = scale_of(parameter.unit, parameter.name), sized_parameter(parameter)
    if not math.isfinite(spread):
        return UNKNOWN, 'not determined', scale.unit
    places = decimals(spread)
    return signed(value, places), f'±{fixed(spread, places)}', scale.unit


def _unmeasured(run: Run) -> tuple[str, list[int]]:
    """Return at which places a run was measured, '' at all, and the cells that it lacks there."""
    words, wanted = [], np.ones((run.n, run.n), dtype=bool)
    position, ball = np.indices((run.n, run.n)) + 1
    for what, used, place in (('CMM positions', run.cmm_position, cmm_position(run.n, position, ball)),
                              ('ball places', run.ball, ball)):
        numbers = np.unique(used)
        if numbers.size < run.n:
            words.append(f'only {what} {", ".join(map(str, numbers))} of {run.n} in use, deviations of the others '
                         'are not measured')
            wanted &= np.isin(place, numbers)
    return '; '.join(words), np.setdiff1d(np.flatnonzero(wanted), run.cells).tolist()


def plate_words(n: int, balls: int, radius: float) -> str:
    """Return a plate: '12 balls on R = 182.5 mm'; with fewer balls than table positions how many these are, too."""
    places = f', {n} table positions' if balls < n else ''
    return f'{balls} balls on R = {millimetres(radius)}{places}'


def wanted_size(run: Run) -> int:
    """Return the number of readings of a run that lacks nothing of the balls and CMM positions in use."""
    return run.size + len(_unmeasured(run)[1])


def run_size(run: Run) -> str:
    """Return what was measured: '12 balls on R = 182.5 mm, 144 ball centres'."""
    wanted = wanted_size(run)
    share = f' of {wanted}' if wanted > run.size else ''
    return f'{plate_words(run.n, np.unique(run.ball).size, run.radius)}, {run.size}{share} ball centres'


def unmeasured_words(run: Run) -> str:
    """Return which places and balls were not measured, at most MOST_MISSING balls, '' where nothing is missing."""
    places, cells = _unmeasured(run)
    names = ', '.join(f'ball {cell % run.n + 1} at table position {cell // run.n + 1}' for cell in cells[:MOST_MISSING])
    missing = f'{len(cells)} missing: {names}{" ..." if len(cells) > MOST_MISSING else ""}' if cells else ''
    return '; '.join(filter(None, (places, missing)))


def not_known(run: Run, gauge: Sequence[str], doubts: Iterable[str]) -> list[str]:
    """Return what the readings of a run do not tell, in sentences.

    gauge: combinations that no run tells; doubts: what is wrong with its readings, in words."""
    missing = unmeasured_words(run).replace(' ...', ' and more')
    return [f'Cannot be measured by this method; removed: {"; ".join(gauge)}.',
            *([f'{missing[0].upper()}{missing[1:]}.'] if missing else []),
            *(['The repeatability is not known: lack of fit cannot be judged.'] if run.repeatability is None else []),
            *(f'{capital(words)}.' for words in doubts)]


def clamping_words(shift: Floats, turn: Floats, u: Floats | None = None) -> str:
    """Return how a plate lies on the table: shift (3,), m, and rotation (3,), rad; u: of these, (6,), is said as U."""
    parts = []
    for name, value, si, places, which in (
            ('eccentricity', float(np.hypot(*shift[:2])), 'm', 2, slice(2)), ('height', shift[2], 'm', 2, slice(2, 3)),
            ('tilt', float(np.hypot(*turn[:2])), 'rad', 1, slice(3, 5)), ('turn', turn[2], 'rad', 1, slice(5, 6))):
        if u is None:
            parts.append(f'{name} {sized(value, si, places)}')
            continue
        factor, unit = scale_of(si)
        expanded = COVERAGE_FACTOR * factor * float(u[which].max())
        digits = decimals(expanded)
        parts.append(f'{name} {fixed(factor * value, digits)} ± {fixed(expanded, digits)} {unit}')
    return ', '.join(parts)


def model_words(model: Model) -> str:
    """Return a model as a sum of titles, fixed settings with their units, custom terms with their formula."""
    fixed_ones = [setting_words(term.name, term.fixed) if term.name in MEANINGS else term.effect.formula
                  for term in model.terms]
    return ' + '.join([*map(title_of, model.base), *(f'{title_of(term.name)} ({words})' if words else title_of(
        term.name) for term, words in zip(model.terms, fixed_ones, strict=True))]) or 'nothing'


def angle_words(run: Run) -> str:
    """Return how far the table angles are off their nominal values."""
    factor, unit = scale_of('rad')
    off = factor * float(np.abs(run.angle_deviation).max())
    return f'at most {significant(off)} {unit} off nominal' if off else 'nominal'


def pauses(run: Run) -> str:
    """Return the pauses of a run: 'before reading 74 (2 h 10 min)'; '' where there is none."""
    return ', '.join(f'before reading {first + 1}'
                     + f' ({duration(run.time[first] - run.time[first - 1])})' * (run.time_unit == 's')
                     for first in run.pauses)


def repeatability_words(repeatability: float | None, dof: float | None, axes: Sequence[float] | None = None) -> str:
    """Return a repeatability, m, its degrees of freedom, and the same along x, y and z."""
    if repeatability is None:
        return 'not known'
    freedom = '' if dof is None else f', {dof:g} degrees of freedom'
    by_axis = ', '.join(f'{name} {micro(one, 3)}' for name, one in zip('xyz', axes or ()))
    return f'{micro(repeatability, 4)} µm per coordinate{freedom}{f" ({by_axis} µm)" * bool(by_axis)}'


def residual_words(fit: Fit) -> str:
    """Return the size of the residual, and what it is of the repeatability."""
    text, known = f'{micrometres(fit.rms)} rms per coordinate', fit.run.repeatability
    if known is None or fit.lack_of_fit_p is None:
        return f'{text}; the repeatability is not known'
    dof = '' if fit.run.repeatability_dof is None else f' ({fit.run.repeatability_dof:g} degrees of freedom)'
    together = math.hypot(known, fit.run.rounding)
    rounded = f' with rounding, together {micrometres(together)}' * bool(fit.step)
    return (f'{text}, {multiple(fit.rms / together)} times the repeatability of '
            f'{micrometres(known)}{dof}{rounded}; '
            f'{p_words(fit.lack_of_fit_p)}')


def uncertainty_words(fit: Fit) -> str:
    """Return what the uncertainties are worked out from, by axis where these repeat unequally."""
    axes = fit.noise.axes
    size = f'{micrometres(fit.sigma)} per coordinate of a ball centre'
    if np.ptp(axes) and not fit.noise.wander.any():
        x, y, z = (micrometres(fit.sigma * one) for one in axes)
        size = f'{x} along x, {y} along y and {z} along z of a ball centre'
    return f'from {size}, estimated from {fit.sigma_source}'

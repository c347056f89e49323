# SPDX-License-Identifier: Apache-2.0
"""Numbers and words of an analysis as a person reads them, for every door: µm, chances, settings."""

import math

from rosette_ros.core.effects.basic import BASE_EFFECTS
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.units import scale_of

SMALLEST_P = 1e-6
MEANINGS = {effect.name: effect for effect in (*BASE_EFFECTS, *EFFECTS.values())}
"""Every name that a diagnosis can give, with what it means."""
MOST_DECIMALS = 9
UM_PLACES = 3


def decimals(uncertainty, digits=2):
    """Return how many decimals show `digits` significant digits of an uncertainty (GUM 7.2.6)."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(max(digits - 1 - math.floor(math.log10(uncertainty)), 0), MOST_DECIMALS)


def signed(value, places):
    """Return a number with its sign and a fixed number of decimals, never -0."""
    if not math.isfinite(value):
        return '–'
    return f'{round(value, places) + 0.0:+.{places}f}'


def fixed(value, places):
    """Return a number with a fixed number of decimals, never -0."""
    if not math.isfinite(value):
        return '–'
    return f'{round(value, places) + 0.0:.{places}f}'


def exact(value, places):
    """Return a number with as many decimals as it needs, at most `places`: 60, 22.5, 51.428571."""
    text = fixed(value, places)
    return text.rstrip('0').rstrip('.') if '.' in text else text


def duration(seconds):
    """Return a duration for a person: 41 s, 12 min, 1 h 52 min."""
    if seconds < 90:
        return f'{seconds:.3g} s'
    minutes = round(seconds / 60)
    return f'{minutes} min' if minutes < 90 else f'{minutes // 60} h {minutes % 60} min'


def pauses(run):
    """Return the pauses of a Run for a person: 'before reading 74 (2 h 10 min)'; '' where there is none."""
    return ', '.join(f'before reading {first + 1} ({duration(run.time[first] - run.time[first - 1])})'
                     for first in run.pauses)


def chance(p):
    """Return a probability in words: '<1e-6', '0.0042 %', '37 %'."""
    if not math.isfinite(p):
        return '–'
    if p < SMALLEST_P:
        return '<1e-6'
    return f'{100 * p:.2g} %' if p < 0.995 else '>99 %'


def micro(value, places=UM_PLACES):
    """Return metres as µm or radians as µrad, without the unit."""
    return fixed(1e6 * value, places)


def fall(before, after):
    """Return how an error changes: '0.541 → 0.103' (µm)."""
    return f'{micro(before)} → {micro(after)}'


def percent(share):
    """Return a share from 0 to 1 in percent."""
    return f'{100 * share:.0f} %'


def names(words):
    """Return names as an enumeration."""
    words = list(words)
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} and {words[-1]}'


def setting_words(effect, setting, without=()):
    """Return the values of a setting with their units; `without`: names shown elsewhere.

    effect: its name; setting: mapping of searched parameters.
    """
    units = {one.name: one.unit for one in MEANINGS[effect].searched} if effect in MEANINGS else {}
    words = []
    for name, value in setting.items():
        if name in without:
            continue
        if isinstance(value, float):
            scale = scale_of(units.get(name, ''), name)
            words.append(f'{name} {value * scale.factor:.4g} {scale.unit}'.strip())
        else:
            words.append(f'{name} {value}')
    return ', '.join(words)


def shown_parameter(parameter):
    """Return value, expanded uncertainty and unit of a Parameter as texts."""
    scale = scale_of(parameter.unit, parameter.name)
    spread = COVERAGE_FACTOR * scale.factor * parameter.u
    if not math.isfinite(spread):
        return '–', 'not determined', scale.unit
    places = decimals(spread)
    return signed(scale.factor * parameter.value, places), f'±{fixed(spread, places)}', scale.unit


def times(value):
    """Return a size in sigma."""
    return f'{exact(value, 1) if value < 100 else f"{value:.0f}"} σ'

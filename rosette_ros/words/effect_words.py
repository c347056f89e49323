# SPDX-License-Identifier: Apache-2.0
"""Effects in words: names, settings with their units, and the numbers of these."""

import math
from collections import ChainMap
from collections.abc import Container, Iterable, Mapping
from typing import Any

from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.effect import Effect
from rosette_ros.core.effects.library import BASE_EFFECTS
from rosette_ros.core.run.number_words import SCALES, UNKNOWN, Scale, Tolerance
from rosette_ros.core.run.records import in_time

MEANINGS: Mapping[str, Effect] = ChainMap[str, Any](LAWS, {effect.name: effect for effect in BASE_EFFECTS})
"""Every name that a diagnosis can give, with what it means."""
MICRO_DECIMALS = 3
OF_PARAMETER = {'psi0': Scale(0.5 / math.pi, 'turns'), 'nu': Scale(1.0, 'per turn'), 'height': Scale(1e3, 'mm'),
                'theta0': Scale(180 / math.pi, '°'), 'width': Scale(180 / math.pi, '°')}
"""Parameters that are no small deviations and have a scale of their own, by name."""


def scale_of(unit: str, parameter: str = '') -> Scale:
    """Return the Scale of an SI unit, or of a parameter that has its own."""
    return OF_PARAMETER.get(parameter) or SCALES.get(unit, Scale(1.0, unit))


def decimals(uncertainty: float, digits: int = 2) -> int:
    """Return how many decimals show `digits` significant digits of an uncertainty (GUM 7.2.6)."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return MICRO_DECIMALS
    return min(max(digits - 1 - math.floor(math.log10(uncertainty)), 0), 9)


def plain(value: float, places: int) -> str:
    """Return a number with a fixed number of decimals as files hold it: hyphen-minus, never -0."""
    return f'{round(value, places) + 0.0:.{places}f}'


def fixed(value: float, places: int) -> str:
    """Return a number with a fixed number of decimals and a minus sign, never −0."""
    return plain(value, places).replace('-', '−') if math.isfinite(value) else UNKNOWN


def exact(value: float, places: int) -> str:
    """Return a number with as many decimals as it needs, at most `places`: 60, 22.5, 51.428571."""
    text = fixed(value, places)
    return text.rstrip('0').rstrip('.') if '.' in text else text


def tolerance_words(limit: Tolerance, unit: str = '') -> str:
    """Return a tolerance as it was stated, with its unit unless that is `unit`: '1 arcsec'."""
    return limit.number if limit.unit == unit else f'{limit.number} {limit.unit}'


def names(words: Iterable[str], last_by: str = 'and') -> str:
    """Return names as an enumeration."""
    *others, last = words
    return f'{", ".join(others)} {last_by} {last}' if others else last


def capital(text: str) -> str:
    """Return a text as the beginning of a sentence."""
    return f'{text[:1].upper()}{text[1:]}'


def plain_name(name: str) -> str:
    """Return an effect or a base term in words, '' for one that has none; a setting in brackets is left out."""
    known = MEANINGS.get(name.partition('(')[0])
    return known.plain if known else ''


def title_of(name: str) -> str:
    """Return the plain title of an effect, its name where it has none."""
    return plain_name(name) or name


def words_of(name: str) -> str:
    """Return an effect in words with its identifier: 'creep of the plate (plate_creep)'."""
    return f'{plain_name(name)} ({name})' if plain_name(name) else name


def setting_words(effect: str, setting: Mapping[str, object], without: Container[str] = (),
                  moments: Mapping[str, tuple[float, float]] | None = None, time: str = 's') -> str:
    """Return the values of the searched parameters of an effect with their units, but for those of `without`.

    moments: between which times, s, moments lie that a run places no better; they stand in place of the values;
    time: the unit of times, as of Run.time_unit.
    """
    units = {one.name: one.unit for one in MEANINGS[effect].searched} if effect in MEANINGS else {}
    words = []
    for name, value in setting.items():
        if name not in without:
            if moments and name in moments:
                words.append(f'{name} {between_words(*moments[name], time)}')
                continue
            scale = scale_of(in_time(units.get(name, ''), time), name)
            senses = _first_senses(value) if name == 'first' and isinstance(value, str) else None
            if isinstance(value, float) or (isinstance(value, int) and scale.unit):
                size = value * scale.factor
                value = f'{exact(size, decimals(abs(size), 4))} {scale.unit}'.rstrip()
            words.append(f'{name} {value}' if senses is None else senses)
    return ', '.join(words)


def between_words(low: float, high: float, time: str = 's') -> str:
    """Return between which times since the first reading something lies: 'between 37.4 and 49.7 min'.

    time: their unit, as of Run.time_unit; with 'reading' between which readings, counted from 1."""
    if time == 'reading':
        return f'between readings {math.floor(low) + 1} and {math.ceil(high) + 1}'
    return f'between {minutes_words(low, high, to="and")}'


def minutes_words(low: float, high: float, to: str = 'to') -> str:
    """Return times, s since the first reading, between which something lies: '37.4 to 49.7 min'."""
    scale = SCALES['s']
    places = max(decimals(scale.factor * (high - low)), 1)
    first, last = (exact(scale.factor * one, places) for one in (low, high))
    return f'{first} {to} {last} {scale.unit}'


def _first_senses(value: str) -> str:
    """Return in words in which senses the CMM came to its first readings, such as '+-'."""
    return (f'before they turn back, x moves {value[0]} and y {value[1]}'.replace('-', '−') if len(value) == 2 else
            'the first senses of x and y are not known')

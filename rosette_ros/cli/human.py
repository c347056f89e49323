# SPDX-License-Identifier: Apache-2.0
"""Numbers and words of a diagnosis as a person reads them: µm, chances, settings, bars."""

import math

import numpy as np
from rich.markup import escape

from rosette_ros.cli.screen import decimals, exact, fixed, signed, table
from rosette_ros.core.effects.basic import BASE_EFFECTS
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.units import scale_of

SMALLEST_P = 1e-6
BARS = '▁▂▃▄▅▆▇█'
MEANINGS = {effect.name: effect for effect in (*BASE_EFFECTS, *EFFECTS.values())}
"""Every name that a diagnosis can give, with what it means."""
UM_PLACES = 3


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


def sentence(text):
    """Return a sentence of the core with the sign for micro, safe to print."""
    return escape(text.replace(' um', ' µm'))


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


def parameter_table(effects, title='Parameters'):
    """Return the table of parameters of (name, setting, parameters) entries."""
    made = table(title=title)
    for head, side in (('effect', 'left'), ('parameter', 'left'), ('value', 'right'),
                       (f'U (k={COVERAGE_FACTOR})', 'right'), ('unit', 'left'),
                       ('found at', 'left')):
        made.add_column(head, justify=side, no_wrap=head != 'found at')
    for name, setting, parameters in effects:
        at = setting_words(name, setting, [one.name for one in parameters])
        for place, one in enumerate(parameters):
            value, spread, unit = shown_parameter(one)
            made.add_row(escape(name) if place == 0 else '', one.name, value, spread,
                         escape(unit), escape(at) if place == 0 else '')
    return made


def shown_parameter(parameter):
    """Return value, expanded uncertainty and unit of a Parameter as texts."""
    scale = scale_of(parameter.unit, parameter.name)
    spread = COVERAGE_FACTOR * scale.factor * parameter.u
    if not math.isfinite(spread):
        return '–', 'not determined', scale.unit
    places = decimals(spread)
    return signed(scale.factor * parameter.value, places), f'±{fixed(spread, places)}', scale.unit


def spark(values, top):
    """Return a row of bars, one per value, `top` being the highest."""
    share = np.clip(np.asarray(values) / top, 0, 1) if top > 0 else np.zeros(len(values))
    return ''.join(BARS[min(int(part * len(BARS)), len(BARS) - 1)] for part in share)


def times(value):
    """Return a size in sigma."""
    return f'{exact(value, 1) if value < 100 else f"{value:.0f}"} σ'

# SPDX-License-Identifier: Apache-2.0
"""Sentences, parameters and bars of a diagnosis on a terminal."""

import numpy as np
from rich.markup import escape

from rosette_ros.cli.screen import table
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.words import setting_words, shown_parameter

BARS = '▁▂▃▄▅▆▇█'


def sentence(text):
    """Return a sentence of the core with the sign for micro, safe to print."""
    return escape(text.replace(' um', ' µm'))


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


def spark(values, top):
    """Return a row of bars, one per value, `top` being the highest."""
    share = np.clip(np.asarray(values) / top, 0, 1) if top > 0 else np.zeros(len(values))
    return ''.join(BARS[min(int(part * len(BARS)), len(BARS) - 1)] for part in share)



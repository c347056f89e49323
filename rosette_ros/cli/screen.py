# SPDX-License-Identifier: Apache-2.0
"""What every verb prints with: a console, tables, digits."""

import json
import math
import sys

from rich import box
from rich.console import Console
from rich.table import Table

WIDTH = 100
"""Widest output, columns; what is no terminal gets this width."""
MOST_DECIMALS = 9


def console(file=None):
    """Return a console on stdout (or `file`), without colour where it is no terminal."""
    out = Console(file=file or sys.stdout, highlight=False, emoji=False, markup=True)
    if not out.is_terminal or out.width > WIDTH:
        out.width = WIDTH
    return out


def table(*heads, title=None, **settings):
    """Return an empty table with right-aligned columns of these heads."""
    made = Table(box=box.SIMPLE_HEAD, title=title, title_justify='left', title_style='bold',
                 padding=(0, 1), collapse_padding=True, pad_edge=False, show_edge=False,
                 **settings)
    for head in heads:
        made.add_column(head, justify='right', no_wrap=True)
    return made


def pairs(rows):
    """Return a table of (name, text) rows without lines, texts wrapped."""
    made = Table.grid(padding=(0, 2))
    made.add_column(no_wrap=True, style='bold')
    made.add_column(overflow='fold')
    for name, text in rows:
        made.add_row(name, text)
    return made


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


def print_json(mapping):
    """Print one JSON object, strict: no NaN, no Infinity."""
    json.dump(mapping, sys.stdout, allow_nan=False, ensure_ascii=False)
    sys.stdout.write('\n')

# SPDX-License-Identifier: Apache-2.0
"""What every verb prints with: a console, tables, JSON."""

import json
import sys

from rich import box
from rich.console import Console
from rich.table import Table

WIDTH = 100
"""Widest output, columns; what is no terminal gets this width."""
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


def print_json(mapping):
    """Print one JSON object, strict: no NaN, no Infinity."""
    json.dump(mapping, sys.stdout, allow_nan=False, ensure_ascii=False)
    sys.stdout.write('\n')

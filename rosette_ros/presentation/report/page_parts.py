# SPDX-License-Identifier: Apache-2.0
"""What all pages have in common: templates and figures."""

import io
import re
from collections.abc import Mapping, Sequence

import matplotlib as mpl
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from rosette_ros.presentation.formatting import glued

PAGES = Environment(loader=PackageLoader('rosette_ros.presentation.report'), autoescape=True, trim_blocks=True,
                    lstrip_blocks=True, undefined=StrictUndefined)
PAGES.filters['glued'] = glued
PAGES.filters['css_text'] = lambda words: ''.join(f'\\{ord(one):06x}' for one in words)
"""A text for a string of a style sheet: every character by its number."""
_HEAD = re.compile(r'\A.*?(?=<svg\b)', re.DOTALL)
_METADATA = re.compile(r'\s*<metadata>.*?</metadata>', re.DOTALL)
_NAMESPACE = re.compile(r'\s+xmlns(?::\w+)?="[^"]*"')
_IMAGE_IDENTITY = re.compile(r'(<image\b[^>]*?)\s+id="[^"]*"')
"""Nothing refers to it, and equal images have equal ones."""
_MARKER = re.compile(r'(<use\b[^>]*?)\s*/>')
_IDENTITY = re.compile(r'(\bid="|\bhref="#|\burl\(#)')


def inline_svgs(figures: Mapping[str, Figure], points: Mapping[str, Mapping[str, Sequence[str]]] | None = None,
                ) -> dict[str, Markup]:
    """Return figures as `<svg>` elements for HTML, the same for the same figure, with ids of their own.

    points: what the points of a line are, in words that a reader sees who points at them, by figure and line."""
    out = {}
    for name, figure in figures.items():
        stream = io.StringIO()
        with mpl.rc_context({'svg.hashsalt': name}):
            figure.savefig(stream, format='svg', dpi=110, metadata={'Date': None})
        begin, _, rest = _METADATA.sub('', _HEAD.sub('', stream.getvalue())).partition('>')
        rest = _IMAGE_IDENTITY.sub(r'\1', rest).replace('xlink:href=', 'href=')
        rest = _IDENTITY.sub(rf'\g<1>{name}-', rest)
        for line, texts in (points or {}).get(name, {}).items():
            rest = _with_titles(rest, f'<g id="{name}-{line}">', texts)
        out[name] = Markup(f'{_NAMESPACE.sub("", begin)}>{rest}')
    return out


def _with_titles(svg: str, group: str, texts: Sequence[str]) -> str:
    """Return a picture in which the markers of a line have titles."""
    before, found, behind = svg.partition(group)
    titles = iter(texts)
    marked = _MARKER.sub(lambda use: f'{use[1]}><title>{escape(next(titles))}</title></use>', behind, len(texts))
    return before + found + marked

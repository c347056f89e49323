# SPDX-License-Identifier: Apache-2.0
"""A figure as SVG that stands inside a page: text stays text, nothing refers to the outside."""

import io
import re
from html import escape

import matplotlib as mpl

from rosette_ros.pictures.style import LOOK

RASTER_DPI = 110
"""Of what is painted rather than drawn inside an SVG: maps, and points that are too many."""
_HEAD = re.compile(r'\A.*?(?=<svg\b)', re.DOTALL)
_METADATA = re.compile(r'\s*<metadata>.*?</metadata>', re.DOTALL)
_NAMESPACE = re.compile(r'\s+xmlns(?::\w+)?="[^"]*"')
_IMAGE_IDENTITY = re.compile(r'(<image\b[^>]*?)\s+id="[^"]*"')
"""Nothing refers to it, and equal images have equal ones."""
_IDENTITY = re.compile(r'(\bid="|\bhref="#|\burl\(#)')


def inline_svg(made, name, text):
    """Return a figure as an `<svg>` element for HTML, the same for the same figure.

    name: unlike that of any other figure of the page, its ids begin with it; text: what the picture
    shows, for those who cannot see it.
    """
    stream = io.StringIO()
    with mpl.rc_context({**LOOK, 'svg.hashsalt': name}):
        made.savefig(stream, format='svg', dpi=RASTER_DPI, metadata={'Date': None})
    svg = _METADATA.sub('', _HEAD.sub('', stream.getvalue()))
    begin, _, rest = svg.partition('>')
    begin = _NAMESPACE.sub('', begin)
    rest = _IMAGE_IDENTITY.sub(r'\1', rest)
    rest = _IDENTITY.sub(rf'\g<1>{name}-', rest.replace('xlink:href=', 'href='))
    return f'{begin} role="img" aria-label="{escape(text)}">{rest}'

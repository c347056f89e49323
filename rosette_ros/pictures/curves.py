# SPDX-License-Identifier: Apache-2.0
"""The six error motions against the table angle, as in Figure 5 of Kniel et al. (2019)."""

from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import MultipleLocator

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.records import CURVES, ISO_NAMES, ErrorMotions
from rosette_ros.pictures.style import COLOURS, DPI, INK, MARKERS, figure, quieten
from rosette_ros.report_json import COVERAGE_FACTOR

MEANING = {'ctx': 'radial in x', 'cty': 'radial in y', 'ctz': 'axial', 'crx': 'tilt about x',
           'cry': 'tilt about y', 'crz': 'angular positioning'}
LAYOUT = ('ctx', 'crx', 'cty', 'cry', 'ctz', 'crz')
"""Translations on the left, rotations on the right."""


@dataclass(frozen=True, eq=False)
class Series:
    """Six curves to draw, with what stands in the legend."""

    label: str
    motions: ErrorMotions


def six_curves(series, title='', truth=None):
    """Return a figure of six panels, µm and µrad against degrees, with bands of U (k = 2).

    series: one or several Series, drawn over one another; truth: (n, 6) true curves at the angles
    of the first one, m and rad, or None.
    """
    made = figure(10, 8.6)
    panels = made.subplots(3, 2, sharex=True).flat
    for panel, curve in zip(panels, LAYOUT, strict=True):
        quieten(panel)
        panel.axhline(0, color=INK, linewidth=0.8)
        for place, one in enumerate(series):
            _draw(panel, one, curve, place)
        if truth is not None:
            angle, value = _closed(series[0].motions.angle, truth[:, CURVES.index(curve)])
            panel.plot(angle, value, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), marker='x',
                       markersize=5, label='truth of the simulated machine')
        panel.set_title(f'{curve} ({ISO_NAMES[curve]}), {MEANING[curve]}', loc='left', fontsize=11,
                        color=INK)
        panel.set_ylabel('µm' if curve.startswith('ct') else 'µrad', color=INK)
        panel.set_xlim(-8, 368)
        panel.xaxis.set_major_locator(MultipleLocator(60))
        panel.xaxis.set_minor_locator(MultipleLocator(30))
    for panel in made.axes[-2:]:
        panel.set_xlabel('table angle in degrees', color=INK)
    handles, labels = made.axes[0].get_legend_handles_labels()
    made.legend(handles, labels, loc='outside lower center', ncols=min(len(labels), 3),
                frameon=False, fontsize=10)
    if title:
        made.suptitle(title, fontsize=12, color=INK, x=0.01, ha='left')
    return made


def save(made, path):
    """Write a figure; the ending of `path` says as what (png, svg, pdf)."""
    try:
        made.savefig(path, dpi=DPI)
    except OSError as error:
        raise InvalidData(f'{path}: cannot be written: {error.strerror}') from error


def _draw(panel, one, curve, place):
    colour = COLOURS[place % len(COLOURS)]
    motions = one.motions
    angle, value = _closed(motions.angle, motions[curve])
    spread = COVERAGE_FACTOR * _closed(motions.angle, motions.uncertainty(curve))[1]
    panel.fill_between(angle, value - spread, value + spread, color=colour, alpha=0.2, linewidth=0,
                       label=f'{one.label}: U (k = {COVERAGE_FACTOR})')
    panel.plot(angle, value, color=colour, linewidth=1.6, marker=MARKERS[place % len(MARKERS)],
               markersize=4.5, label=one.label)


def _closed(angle, value):
    """Return angle in degrees and value in µm or µrad, the first point again a turn later."""
    degrees = np.rad2deg(angle)
    return np.append(degrees, degrees[0] + 360), 1e6 * np.append(value, value[0])

# SPDX-License-Identifier: Apache-2.0
"""The six error motions against the table angle, as in Figure 5 of Kniel et al. (2019)."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.records import CURVES, ISO_NAMES, ErrorMotions
from rosette_ros.pictures.style import (
    COLOURS,
    INK,
    MARKERS,
    QUIET,
    figure,
    label_of,
    panels,
    save,
    scale,
    title,
)
from rosette_ros.report_json import COVERAGE_FACTOR

ANGLES = {angle: str(angle) for angle in range(0, 361, 60)}
MEANING = {'ctx': 'radial in x', 'cty': 'radial in y', 'ctz': 'axial', 'crx': 'tilt about x',
           'cry': 'tilt about y', 'crz': 'angular positioning'}
LAYOUT = ('ctx', 'crx', 'cty', 'cry', 'ctz', 'crz')
"""Translations on the left, rotations on the right."""
INCH = {'width': 10.0, 'panels': 7.4, 'title': 0.4, 'legend': 0.27, 'foot': 0.58, 'head': 0.32}
EXTRA_LOOKS = ((INK, 'x'), ('#7f4a88', '+'))
MOST_NAMED_BANDS = 3
"""Up to so many series each band has a line of its own in the legend."""


@dataclass(frozen=True, eq=False)
class Series:
    """Six curves to draw, with what stands in the legend; without `banded` no uncertainty."""

    label: str
    motions: ErrorMotions
    banded: bool = True


@dataclass(frozen=True, eq=False)
class Extra:
    """A line in one panel alone: angle, rad; value, m or rad; how it stands in the legend."""

    curve: str
    label: str
    angle: np.ndarray
    value: np.ndarray


def six_curves(series, heading='', truth=None, extras=()):
    """Return a figure of six panels, µm and µrad against degrees, with bands of U (k = 2).

    series: one or several Series, drawn over one another, the first on top; truth: (n, 6) true curves
    at the angles of the first one, m and rad, or None; extras: Extra lines of single panels, dashed.
    """
    few = len(series) <= MOST_NAMED_BANDS
    columns = len(series) + (truth is not None) if few else 3
    rows = 2 if few else -(-(len(series) + 1) // columns)
    made, grid = empty_panels(heading, rows)
    for panel, curve in zip(grid, LAYOUT, strict=True):
        drawn = [_draw(panel, one, curve, place) for place, one in enumerate(series)]
        if truth is not None:
            angle, value = _closed(series[0].motions.angle, truth[:, CURVES.index(curve)])
            panel.plot(angle, value, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), marker='x',
                       markersize=5, zorder=5)
        _draw_extras(panel, [one for one in extras if one.curve == curve])
        scale(panel, ANGLES, numbers='xy' if panel in grid[-2:] else 'y')
    handles, labels = _legend(series, drawn, few)
    if truth is not None:
        handles.append(panel.lines[-1])
        labels.append('truth of the simulated machine')
    made.legend(handles, labels, loc='lower center', ncols=columns, frameon=False, fontsize=10)
    if heading:
        made.suptitle(label_of(heading), fontsize=12, color=INK, x=0.01, ha='left',
                      y=1 - 0.1 / made.get_figheight(), va='top')
    return made


def _legend(series, drawn, few):
    """Return handles and labels: each line above its band, or all bands as one where many are."""
    handles, labels = [], []
    for one, (line, band) in zip(series, drawn, strict=True):
        handles.append(line)
        labels.append(label_of(one.label))
        if few and band is not None:
            handles.append(band)
            labels.append(f'{label_of(one.label)}: U (k = {COVERAGE_FACTOR})')
    bands = [band for _, band in drawn if band is not None]
    if bands and not few:
        handles.append(bands[0])
        labels.append(f'bands: U (k = {COVERAGE_FACTOR})')
    return handles, labels


def empty_panels(heading, legend_rows):
    """Return a figure with six empty panels and room for a heading and rows of a legend."""
    foot = INCH['foot'] + INCH['legend'] * legend_rows
    top = INCH['head'] + (INCH['title'] if heading else 0)
    height = INCH['panels'] + foot + top
    made = figure(INCH['width'], height, None)
    made.subplots_adjust(left=0.07, right=0.99, bottom=foot / height, top=1 - top / height,
                         hspace=0.24, wspace=0.18)
    grid = panels(made, 3, 2)
    for panel, curve in zip(grid.flat, LAYOUT, strict=True):
        panel.axhline(0, color=INK, linewidth=0.8)
        panel.set_xlim(-8, 368)
        title(panel, f'{curve} ({ISO_NAMES[curve]}), {MEANING[curve]}')
        panel.set_ylabel('µm' if curve.startswith('ct') else 'µrad')
    for panel in grid[-1]:
        panel.set_xlabel('table angle in degrees')
    return made, grid.ravel()


def _draw(panel, one, curve, place):
    """Draw one curve with its band and return both; the first of all on top."""
    colour = COLOURS[place % len(COLOURS)]
    angle, value = _closed(one.motions.angle, one.motions[curve])
    band = None
    if one.banded:
        spread = COVERAGE_FACTOR * _closed(one.motions.angle, one.motions.uncertainty(curve))[1]
        band = panel.fill_between(angle, value - spread, value + spread, color=colour, alpha=0.2,
                                  linewidth=0)
    [line] = panel.plot(angle, value, color=colour, linewidth=1.6, markersize=4.5,
                        marker=MARKERS[place % len(MARKERS)], zorder=4 - 0.1 * place)
    return line, band


def _draw_extras(panel, extras):
    """Draw the lines that stand in one panel alone, with a legend of their own."""
    lines = []
    for one, (colour, marker) in zip(extras, EXTRA_LOOKS, strict=False):
        angle, value = _closed(one.angle, one.value)
        lines += panel.plot(angle, value, color=colour, linewidth=1.4, linestyle=(0, (4, 2)),
                            marker=marker, markersize=5, zorder=5)
    if lines:
        panel.legend(lines, [label_of(one.label) for one in extras], fontsize=8, loc='best',
                     framealpha=0.85, edgecolor=QUIET)


def _closed(angle, value):
    """Return angle in degrees and value in µm or µrad, the first point again a turn later."""
    degrees = np.rad2deg(angle)
    return np.append(degrees, degrees[0] + 360), 1e6 * np.append(value, value[0])


__all__ = ['Extra', 'Series', 'save', 'six_curves']

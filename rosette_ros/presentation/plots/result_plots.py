# SPDX-License-Identifier: Apache-2.0
"""The results of a run: six error motions, as in Figure 5 of Kniel et al. (2019); deviations of plate and CMM."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from rosette_ros.core.run.geometry import clamping, nominal_angles
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import AxisError, error_lines, once_per_turn
from rosette_ros.presentation.formatting import clamping_words, curve_scales, iso_name
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.words.effect_words import decimals, exact, fixed

ANGLES = {angle: str(angle) for angle in range(0, 361, 60)}
MEANING = {'ctx': 'radial in x', 'cty': 'radial in y', 'ctz': 'axial', 'crx': 'tilt about x',
           'cry': 'tilt about y', 'crz': 'angular positioning'}
TRUE_LOOK: dict[str, Any] = {
    'color': style.INK, 'linewidth': 1.3, 'linestyle': style.DASHED, 'marker': 'x', 'markersize': 5, 'zorder': 5}
EXTRA_LOOKS: tuple[dict[str, str], ...] = ({}, {'color': '#7f4a88', 'marker': '+'})
LONGEST = 0.33
"""Length of the longest arrow in radii of the circle of balls."""
NUMBERS = 0.54
"""Radius of the circle of numbers, likewise: no arrow reaches them."""
WIDE = 4.0
"""A band that is more than so many times as wide as the narrowest one of its panel is not drawn."""
MOST_NUMBERS = 20
LEAST_LIMIT = 1e-3
"""Of the colours of deviations, µm."""
POLAR = ('ctx', 'cty', 'crx', 'cry')
LARGEST = 0.55
"""The largest deviation in radii of the circle of no deviation."""
TURN = np.linspace(0, 2 * np.pi, 361)


@dataclass(frozen=True, eq=False)
class Series:
    """Six curves to draw, with their text in the legend; banded: with their uncertainty."""

    label: str
    motions: ErrorMotions
    banded: bool = True


@dataclass(frozen=True, eq=False)
class Extra:
    """A line in one panel alone, at the angles of the first series; value: m or rad; label: in the legend."""

    curve: str
    label: str
    value: Floats


def six_curves(series: Sequence[Series], heading: str = '', truth: Floats | None = None,
               extras: Sequence[Extra] = (), limits: Mapping[str, float] | None = None) -> Figure:
    """Return a figure of six panels, µm and the unit of angles over degrees, with bands of U (k = 2).

    series: the first on top; truth: (n, 6), m and rad, at the angles of the first; extras: lines of single panels;
    limits: tolerances of the ranges, m and rad, by curve: lines about the middle of the first one, but for tolerances
    that are WIDE times as wide as the panel.
    """
    labels = [style.label_of(one.label) for one in series] + ['truth of the simulated machine'] * (truth is not None)
    made, grid = _empty_panels(heading, series[0].motions.rotation)
    known: dict[str, Any] = {}
    are_all_drawn = True
    for panel, curve in zip(grid, CURVES, strict=True):
        drawn = _are_drawn(series, curve)
        are_all_drawn &= drawn == [one.banded for one in series]
        lines = [_draw(panel, one, curve, place, drawn[place]) for place, one in enumerate(series)]
        if truth is not None:
            lines += panel.plot(*closed(series[0].motions.angle, truth[:, CURVES.index(curve)], curve), **TRUE_LOOK)
        for one, look in zip([one for one in extras if one.curve == curve], EXTRA_LOOKS, strict=False):
            known[style.label_of(one.label)] = panel.plot(
                *closed(series[0].motions.angle, one.value, curve), **{**TRUE_LOOK, **look})[0]
        if limits and curve in limits:
            _draw_tolerance(panel, series[0].motions, curve, limits[curve])
    if panel.collections:
        words = '' if are_all_drawn else '; much wider ones are not drawn'
        known[f'bands: U (k = {COVERAGE_FACTOR}){words}'] = Patch(color=style.GREY, alpha=0.25, linewidth=0)
    style.legend(made, [*lines, *known.values()], [*labels, *known])
    return made


def _empty_panels(heading: str = '', rotation: Floats | None = None) -> tuple[Figure, Any]:
    made, grid = style.figure(2.7 + 0.3 * bool(heading), 2, 3)
    for panel, curve in zip(grid.flat, CURVES, strict=True):
        panel.axhline(0, color=style.INK, linewidth=0.8)
        panel.set_xlim(-8, 368)
        panel.set_title(f'{curve} ({iso_name(curve, rotation)}), {MEANING[curve]}')
        if panel in grid[:, 0]:
            panel.set_ylabel(curve_scales()[CURVES.index(curve)].unit, labelpad=2)
        style.scale(panel, ANGLES, numbers='xy' if panel in grid[-1] else 'y')
    for panel in grid[-1]:
        panel.set_xlabel('table angle in degrees')
    if heading:
        made.suptitle(style.label_of(heading), fontsize=style.HEAD, x=0.01, ha='left')
    return made, grid.ravel()


def _draw(panel: Axes, one: Series, curve: str, place: int, is_banded: bool) -> Any:
    look = style.look_of(place)
    angle, value = closed(one.motions.angle, one.motions[curve], curve)
    if is_banded:
        spread = COVERAGE_FACTOR * closed(one.motions.angle, one.motions.uncertainty(curve), curve)[1]
        panel.fill_between(angle, value - spread, value + spread, color=look['color'], alpha=0.2, linewidth=0)
    return panel.plot(angle, value, linewidth=1.3, markersize=3.5, zorder=4 - 0.1 * place, gid=f'{curve}-{place}',
                      **look)[0]


def values_of_points(series: Sequence[Series]) -> dict[str, list[str]]:
    """Return what the points of six_curves are, in words, by the name of the line: 'ctx at 30°: 0.52 µm, U 0.21 µm'."""
    found = {}
    for place, one in enumerate(series):
        for curve, scale in zip(CURVES, curve_scales(), strict=True):
            angle, value = closed(one.motions.angle, one.motions[curve], curve)
            spread = COVERAGE_FACTOR * closed(one.motions.angle, one.motions.uncertainty(curve), curve)[1]
            found[f'{curve}-{place}'] = [
                f'{one.label}: {curve} at {exact(degrees, 2)}°: {fixed(size, decimals(u))} {scale.unit}, '
                f'U {fixed(u, decimals(u))} {scale.unit}'
                for degrees, size, u in zip(angle.tolist(), value.tolist(), spread.tolist(), strict=True)]
    return found


def _draw_tolerance(panel: Axes, motions: ErrorMotions, curve: str, limit: float) -> None:
    """Draw a tolerance as two lines about the middle of a curve, but for one that is far beyond the panel."""
    _, value = closed(motions.angle, motions[curve], curve)
    middle, wide = (value.max() + value.min()) / 2, curve_scales()[CURVES.index(curve)].factor * limit
    low, high = panel.get_ylim()
    for side in (-1, 1) if wide <= WIDE * (high - low) else ():
        panel.axhline(middle + side * wide / 2, color=style.INK, linewidth=1.1, linestyle=':')


def _are_drawn(series: Sequence[Series], curve: str) -> list[bool]:
    """Return whether each band is drawn: one that is WIDE times as wide as another one would cover the panel."""
    widths = [float(one.motions.uncertainty(curve).max()) if one.banded else np.inf for one in series]
    return [width <= WIDE * min(widths) and width < np.inf for width in widths]


def closed(angle: Floats, value: Floats, curve: str) -> tuple[Floats, Floats]:
    """Return angle in degrees and value in the unit of its curve, the first point again a turn later."""
    degrees = np.rad2deg(angle)
    return np.append(degrees, degrees[0] + 360), curve_scales()[CURVES.index(curve)].factor * np.append(value, value[0])


def differences(labels: Sequence[str], angle: Floats, values: Floats, spread: Floats,
                reference: Floats | None = None, rotation: Floats | None = None) -> Figure:
    """Return a figure of six panels: curves of several runs less their mean.

    angle: (n,) rad; values: (m, n, 6), m and rad, NaN where a run is left out; spread: (6,) standard deviation that
    noise explains, a band of two; reference: (6,), dashed; rotation: as of Run.
    """
    made, grid = _empty_panels(rotation=rotation)
    for panel, curve in zip(grid, CURVES, strict=True):
        which = CURVES.index(curve)
        factor = curve_scales()[which].factor
        panel.axhspan(-2 * factor * spread[which], 2 * factor * spread[which], color='#999999', alpha=0.18, linewidth=0)
        if reference is not None:
            for size in (-factor * reference[which], factor * reference[which]):
                panel.axhline(size, color='#444444', linewidth=1, linestyle=style.DASHED)
        lines = [panel.plot(*closed(angle, one[:, which], curve), linewidth=1.2, markersize=3.2,
                            **style.look_of(place))[0]
                 for place, one in enumerate(values)]
    style.legend(made, lines, [style.label_of(label) for label in labels])
    return made


def deviations(plate: Floats, cmm: Floats, radius: float) -> Figure:
    """Return a figure of the deviations of plate and CMM, (n, 3), m, each at a scale of its own.

    Those of the plate are freed of how it lies on the table, which is told in words."""
    made, panels = style.figure(4.1, 1, 2)
    shift, turn, freed = clamping(plate, radius)
    parts = (('Ball plate, freed of eccentricity, tilt and turn', 'ball', freed),
             ('CMM: deviation of each position', 'position', cmm))
    made.supxlabel(f'Removed from the plate: {clamping_words(shift, turn)}', x=0.01, ha='left', fontsize=style.SMALL,
                   color=style.GREY)
    for panel, (heading, what, values) in zip(panels[0], parts, strict=True):
        limit = max(1e6 * float(np.nanmax(np.abs(values[:, 2]))), LEAST_LIMIT)
        _panel(panel, 1e6 * values, 1e3 * radius, limit)
        panel.set_title(heading)
        style.colour_bar(made, panel, f'z of each {what}, µm (▲ positive, ▼ negative)', False)
    return made


def scale_arrow(longest: float) -> float:
    """Return a round length of about half the longest arrow, same unit: 1, 2 or 5 times 10^k."""
    if not longest > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(longest))
    steps = [step * factor * power for factor in (0.1, 1.0) for step in (1.0, 2.0, 5.0)]
    return float(f'{max(step for step in steps if step <= 0.6 * longest):.3g}')


def _panel(panel: Axes, values: Floats, radius: float, limit: float) -> None:
    """Draw one set of deviations (n, 3), µm, on a circle of `radius`, mm; limit: of the colours, µm."""
    n = len(values)
    beta, turn = nominal_angles(n), np.linspace(0, 2 * np.pi, 181)
    x, y = radius * np.cos(beta), radius * np.sin(beta)
    longest = float(np.nanmax(np.hypot(values[:, 0], values[:, 1])))
    per_um = LONGEST * radius / longest if longest > 0 else 1.0
    panel.plot(radius * np.cos(turn), radius * np.sin(turn), color=style.GRID, linewidth=1)
    panel.plot([-0.04 * radius, 0.04 * radius, np.nan, 0, 0], [0, 0, np.nan, -0.04 * radius, 0.04 * radius],
               color=style.GREY, linewidth=0.8)
    for marker, chosen in (('^', values[:, 2] >= 0), ('v', values[:, 2] < 0)):  # the sign is seen in grey, too
        panel.scatter(x[chosen], y[chosen], c=values[chosen, 2], cmap=style.DIVERGING, vmin=-limit, vmax=limit, s=70,
                      marker=marker, edgecolors=style.INK, linewidths=0.6, zorder=3)
    arrows: dict[str, Any] = {
        'angles': 'xy', 'scale_units': 'xy', 'scale': 1 / per_um, 'color': style.INK, 'width': 0.0055, 'zorder': 4}
    known = np.isfinite(values[:, 2])
    panel.quiver(x[known], y[known], values[known, 0], values[known, 1], **arrows)
    for number in range(0, n, -(-n // MOST_NUMBERS)):
        panel.text(NUMBERS * x[number], NUMBERS * y[number], str(number + 1), ha='center', va='center',
                   color=style.GREY, zorder=2)
    length = scale_arrow(longest)
    panel.quiver([-0.5 * length * per_um], [-1.46 * radius], [length], [0], **arrows)
    panel.text(0, -1.41 * radius, f'{length:g} µm', ha='center', va='bottom')
    _axes_cross(panel, radius)
    panel.set(xlim=(-1.5 * radius, 1.5 * radius), ylim=(-1.53 * radius, 1.4 * radius), aspect='equal')
    panel.axis('off')


def _axes_cross(panel: Axes, radius: float) -> None:
    x, y, length = -1.4 * radius, -1.4 * radius, 0.28 * radius
    panel.quiver([x, x], [y, y], [length, 0], [0, length], angles='xy', scale_units='xy', scale=1, color=style.GREY,
                 width=0.004)
    panel.text(x + 1.15 * length, y, 'x', ha='left', va='center', color=style.GREY)
    panel.text(x, y + 1.15 * length, 'y', ha='center', va='bottom', color=style.GREY)


def polar_motions(motions: ErrorMotions) -> Figure:
    """Return a figure of four polar plots.

    The reference circle is the least-squares one: its offset from the centre is the once-per-turn part of the error,
    the distance of the curve from it the rest."""
    made, [panels] = style.figure(2.7, 1, 4, subplot_kw={'projection': 'polar'})
    for panel, curve in zip(panels, POLAR, strict=True):
        [line] = [one for one in error_lines(motions) if one.curve == curve]
        _polar_panel(panel, motions, curve, line)
        panel.set_title(f'{curve} ({iso_name(curve, motions.rotation)}), {MEANING[curve]}', loc='center')
    style.legend_of(made, panels[:1])
    return made


def _polar_panel(panel: Axes, motions: ErrorMotions, curve: str, line: AxisError) -> None:
    """Draw one curve (n,) with its U: from the circle of no deviation outwards."""
    factor, unit = curve_scales()[CURVES.index(curve)]
    values, expanded, angle = (factor * motions[curve], COVERAGE_FACTOR * factor * motions.uncertainty(curve),
                               motions.angle)
    top = float(np.max(np.abs(values) + expanded)) or 1.0
    base = top / LARGEST
    theta = np.append(angle, angle[0] + 2 * np.pi)
    radius, spread = (np.append(one, one[0]) for one in (base + values, expanded))
    panel.plot(theta, radius, color=style.AFTER, linewidth=1.3, marker='o', markersize=3, label='measured')
    panel.fill_between(theta, radius - spread, radius + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                       label=f'U (k = {COVERAGE_FACTOR})')
    panel.plot(TURN, np.full(TURN.size, base), color=style.GREY, linewidth=0.9, label='no deviation')
    circle = (base + float(np.mean(values))) * np.exp(1j * TURN) + once_per_turn(values, angle)
    panel.plot(np.angle(circle), np.abs(circle), color=style.BEFORE, linewidth=1.1, linestyle=style.DASHED,
               label='reference circle (least squares)')
    length = scale_arrow(top)
    panel.set_xticks(np.deg2rad(np.arange(0, 360, 60)), [f'{degrees}°' for degrees in range(0, 360, 60)])
    panel.set_yticks([base + length], [])
    panel.set(rorigin=0, rmin=0, rmax=1.62 * base)
    panel.spines['polar'].set_visible(False)
    panel.tick_params(pad=2, labelcolor=style.GREY)
    panel.set_xlabel(f'outer ring: +{length:g} {unit}\nrange {fixed(factor * line.range, 2)} {unit}\n'
                     f'residual {fixed(factor * line.residual, 2)} {unit}', fontsize=style.SMALL)

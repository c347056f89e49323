# SPDX-License-Identifier: Apache-2.0
"""Residuals: maps by table position and ball, over time and angle, their distribution, noise, recovered shapes."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # which loads its parts where they are used
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from rosette_ros.core.diagnosis.recovered_shape import Shape, strongest
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import AXES, places
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.presentation.tables import LEAST_NOISE
from rosette_ros.words.effect_words import fixed

ANGLES = {angle: str(angle) for angle in range(0, 301, 60)}
LOOKS = ((style.BEFORE, 3.4, style.DASHED), (style.AFTER, 2.4, '-'))
"""Colour, size of the dots and line of their mean, before and after the identified effects are added."""
ROW = 2.04
"""Height of a row of residual maps, inch."""
SECTIONS, LEAST_MEAN = 12, 6
"""Most means of neighbours along a line, and how many readings one is made of at least."""
WIDE = 12
"""Histograms end so many sigma from zero; what lies beyond is counted in the last bar."""
LAGS = 12
SHOWN = ('ball', 'CMM position', 'time')
"""Groups of readings whose scatter is drawn; at a table position little is left that could scatter otherwise."""
MOST_CURVES, SHAPE_ROW = 3, 1.9
UNITS = {'s': ('min', 1 / 60), 'rad': ('°', 180 / np.pi), 'K': ('K', 1.0)}
"""Shown unit of a variable, and the factor to it."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals (N, 3), m, of a model on a run, with their text in the legend."""

    label: str
    run: Run
    values: Floats

    def grid(self) -> Floats:
        """Return the map (n, n, 3) in µm by table position and ball, NaN where not measured."""
        n = self.run.n
        out = np.full((n, n, 3), np.nan)
        out[self.run.table_position - 1, self.run.ball - 1] = 1e6 * self.values
        return out


def residual_maps(rows: Sequence[Residuals]) -> Figure:
    """Return n x n maps, µm, a row of x, y, z for each of some residuals; dashed lines join one CMM position.

    A bar in a cell is a minus sign."""
    grids = [row.grid() for row in rows]
    limit = max(max(float(np.nanmax(np.abs(grid))) for grid in grids), 1e-9)
    made, panels = style.figure(ROW * len(rows) + 0.05, len(rows), 3)
    for line, row, grid in zip(panels, rows, grids, strict=True):
        for axis, (panel, name) in enumerate(zip(line, AXES, strict=True)):
            _map(panel, grid[..., axis], limit, 'x' if axis else 'xy')
            panel.set_title(f'residual in {name}', loc='center')
            panel.set_xlabel('ball', labelpad=2, fontsize=style.SMALL)
        line[0].set_title(style.label_of(row.label), y=1.16, fontsize=style.HEAD, weight='bold')
        line[0].set_ylabel('table position', fontsize=style.SMALL)
    axes = style.colour_bar(made, panels, 'µm')
    places = np.linspace(-0.95, 0, 20) * limit
    style.mark_negative(axes, np.full(20, 0.5), places, places, limit, 0.6)
    return made


def _map(panel: Axes, values: Floats, limit: float, numbers: str) -> None:
    n = len(values)
    panel.imshow(values, cmap=style.DIVERGING, vmin=-limit, vmax=limit, aspect='auto', interpolation='none',
                 extent=(0.5, n + 0.5, n + 0.5, 0.5))
    panel.patch.set(facecolor='white', edgecolor=style.GREY, hatch='xxxx')  # seen where nothing was measured
    marked = sorted({1 + round(part * n / 4) for part in range(4)})
    y, x = np.indices(values.shape, dtype=float) + 1
    style.mark_negative(panel, x.ravel(), y.ravel(), values.ravel(), limit, 0.5)
    ends = [(max(1, total - n), min(n, total - 1), total)
            for number in marked for total in (number + 1, number + 1 + n)]
    lines = [[(total - first + 0.35, first - 0.35), (total - last - 0.35, last + 0.35)]
             for first, last, total in ends if last > first]
    panel.add_collection(LineCollection(lines, colors=style.GREY, linewidths=0.8, linestyles=(0, (3, 3))))
    panel.set(xlim=(0.5, n + 0.5), ylim=(n + 0.5, 0.5))
    shown = {number: str(number) for number in marked}  # on the left of the diagonal of the CMM position of this number
    style.scale(panel, shown, shown, '', numbers)


def against(series: Sequence[Residuals], noise: float | None = None) -> Figure:
    """Return a figure of residuals in µm: rows x, y, z, columns time, table angle, temperature where it changes.

    series: one or two of one run, before and after; noise: standard deviation, m; lines are means of neighbours.
    """
    places = _places(series[0].run)
    made, grid = style.figure(4.4, 3, len(places))
    limit = 1.08 * max(1e-9, *(float(np.abs(1e6 * one.values).max()) for one in series))
    for axis, name in enumerate(AXES):
        for column, (label, values, marks, sections) in enumerate(places):
            panel = grid[axis, column]
            _scatter(panel, series, axis, values, noise, limit, sections)
            style.scale(panel, marks, numbers='x' * (axis == 2) + 'y' * (column == 0))
            if axis == 2:
                panel.set_xlabel(label)
        grid[axis, 0].set_ylabel(f'{name}, µm')
    style.legend_of(made, grid[0, :1])
    return made


def _places(run: Run) -> list[tuple[str, Floats, dict[int, str] | None, int]]:
    """Return (label, values (N,), marks, sections) of all that the residuals are drawn over."""
    sections = max(1, min(SECTIONS, run.size // LEAST_MEAN))
    hours = (run.time - run.time[0]) / 3600
    label, time = (('readings since the first', 3600 * hours) if run.time_unit != 's' else
                   ('time in hours', hours) if hours.max() > 1.5 else ('time in minutes', 60 * hours))
    out = [(label, time, None, sections),
           ('table angle in degrees', np.rad2deg(run.table_angle + run.table_offset), ANGLES, run.n)]
    known = run.temperature[np.isfinite(run.temperature)]
    if known.size and np.ptp(known) > 0:
        out.append(('temperature in °C', run.temperature, None, sections))
    return out


def _scatter(panel: Axes, series: Sequence[Residuals], axis: int, values: Floats, noise: float | None, limit: float,
             sections: int) -> None:
    low = float(np.nanmin(values))
    reach = float(np.nanmax(values)) - low or 1.0
    edges = low - 0.03 * reach, low + 1.03 * reach
    panel.set(xlim=edges, ylim=(-limit, limit))
    if noise is not None:
        panel.axhspan(-2e6 * noise, 2e6 * noise, color='#999999', alpha=0.18, linewidth=0, label='±2 σ of the noise')
    panel.axhline(0, color=style.INK, linewidth=0.8)
    for one, (colour, size, line) in zip(series[-2:], LOOKS[-len(series):], strict=True):
        residual = 1e6 * one.values[:, axis]
        panel.add_artist(_dots(values, residual, 5e-4 * reach, colour, size))
        place, mean = section_means(values, residual, sections)
        panel.plot(place, mean, color=colour, linewidth=1.6, linestyle=line,
                   label=f'{style.label_of(one.label)}, and its mean')


def _dots(x: Floats, y: Floats, length: float, colour: str, size: float) -> PathPatch:
    """Return dots as one path with round ends in place of N markers."""
    known = np.isfinite(x)
    ends = np.stack([np.stack([x, y], axis=1)[known], np.stack([x + length, y], axis=1)[known]], axis=1)
    return style.segments(ends.reshape(-1, 2), edgecolor=colour, linewidth=size, alpha=0.5, capstyle='round',
                          snap=False)


def section_means(values: Floats, residual: Floats, sections: int = SECTIONS) -> tuple[Floats, Floats]:
    """Return mean place and mean residual of neighbours along `values`, in equally full sections."""
    order = np.argsort(values, kind='stable')
    order = order[np.isfinite(values[order])]
    edges = np.linspace(0, order.size, min(sections, order.size) + 1).astype(int)
    parts = [order[a:b] for a, b in pairwise(edges)]
    return np.array([values[part].mean() for part in parts]), np.array([residual[part].mean() for part in parts])


def histogram(series: Sequence[Residuals], noise: float | None, dof: Sequence[int]) -> Figure:
    """Return a figure: the distribution of the residuals, beside the density of noise.

    noise: standard deviation of a coordinate, m; dof: of each model; noise appears smaller by sqrt(dof / 3N).
    """
    made, [[panel]] = style.figure(2.4)
    flat = [1e6 * one.values.ravel() for one in series]
    spread = 1e6 * noise if noise is not None else max(float(np.std(flat[-1])), 1e-9)
    reach = min(max(max(float(np.abs(one).max()) for one in flat), 3.5 * spread), WIDE * spread)
    width = max(spread / 3, reach / 60)
    count = int(np.ceil(reach / width - 0.5))
    edges = width * (np.arange(-count, count + 2) - 0.5)
    for one, values, (colour, _, line) in zip(series, flat, LOOKS[-len(series):], strict=True):
        counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
        panel.stairs(counts, edges, color=colour, fill=True, alpha=0.25)
        panel.stairs(counts, edges, color=colour, linewidth=1.4, linestyle=line, label=style.label_of(one.label))
    if noise is not None:
        size = flat[-1].size
        shown = spread * np.sqrt(dof[-1] / size)
        where = np.linspace(edges[0], edges[-1], 241)
        density = np.exp(-0.5 * (where / shown)**2) / (shown * np.sqrt(2 * np.pi))
        panel.plot(where, size * width * density, color=style.INK, linewidth=1.4, linestyle=':',
                   label=f'expected of noise, σ = {fixed(spread, 3)} µm')
    panel.set(xlim=(edges[0], edges[-1]), xlabel='residual of a coordinate in µm',
              ylabel='number of coordinates')
    style.scale(panel, grid='y', steps=(8, 4))
    panel.legend(loc='upper right')
    return made


def noise(fit: Fit) -> Figure:
    """Return a figure of the residual of a fit in white coordinates, in units of its size: 1 where it is such noise."""
    left = fit.white_residual * np.sqrt(3 * fit.run.size / fit.dof) / max(fit.rms, LEAST_NOISE)
    made, panels = style.figure(4.2, 2, 3)
    _quantiles(panels[0, 0], left)
    _group_scatter(panels[0, 1], 'axis', AXES, [left[:, axis] for axis in range(3)])
    for panel, (name, index, keys) in zip(panels.flat[2:], (one for one in places(fit.run) if one[0] in SHOWN),
                                          strict=False):
        _group_scatter(panel, name, [key.partition('-')[0] for key in keys],
                 [left[index == group] for group in range(len(keys))])
    _correlation(panels[1, 2], left)
    style.legend_of(made, panels[0, :2])
    return made


def _quantiles(panel: Axes, left: Floats) -> None:
    """Draw sorted residuals of each axis against those of normal noise, which lie on the line."""
    wanted = scipy.special.ndtri((np.arange(len(left)) + 0.5) / len(left))
    for axis, name in enumerate(AXES):
        panel.plot(wanted, np.sort(left[:, axis]), linestyle='none', markersize=3, label=name, **style.look_of(axis))
    panel.plot(wanted[[0, -1]], wanted[[0, -1]], color=style.INK, linewidth=1, label='normal noise')
    style.scale(panel)
    panel.set(xlabel='quantile of normal noise, in σ', ylabel='residual in order, in σ')


def _group_scatter(panel: Axes, name: str, keys: Sequence[str], groups: Sequence[Floats]) -> None:
    """Draw the rms of groups of residuals with the range in which noise lies (two standard deviations)."""
    at = np.arange(len(groups))
    size = [float(np.sqrt(np.mean(one**2))) if one.size else np.nan for one in groups]
    spread = [np.sqrt(2 / max(one.size, 1)) for one in groups]
    panel.errorbar(at, np.ones(len(at)), spread, color=style.GREY, linestyle='none', elinewidth=6, alpha=0.35,
                   label='where noise lies (k = 2)')
    panel.plot(at, size, linestyle='none', marker='o', markersize=5, color=style.AFTER)
    step = -(-len(keys) // 8)
    style.scale(panel, {int(place): keys[place] for place in at[::step]}, None)
    panel.set(xlim=(-0.6, len(at) - 0.4), ylim=(0, max(2.0, 1.05 * float(np.nanmax(size)))),
              xlabel='section of the time, from minute' if name == 'time' else name, ylabel='rms of residuals, in σ')


def _correlation(panel: Axes, left: Floats) -> None:
    """Draw the correlation of readings some places apart, with the range in which that of noise lies."""
    lags = np.arange(1, min(LAGS, len(left) - 2) + 1)
    for axis, name in enumerate(AXES):
        one = left[:, axis]
        size = max(float(one @ one), 1e-300)
        values = [float(one[lag:] @ one[:-lag]) / size for lag in lags]
        panel.plot(lags, values, linewidth=1, markersize=4, label=name, **style.look_of(axis))
    bound = 2 / np.sqrt(len(left))
    panel.axhspan(-bound, bound, color=style.GREY, alpha=0.2, linewidth=0)
    style.scale(panel)
    panel.set(xlabel='distance in readings', ylabel='correlation')


def shapes(every: Sequence[Shape]) -> Figure:
    """Return a figure: a row for each shape, the curves that stand out most, µm, with the band of U (k = 2)."""
    made, panels = style.figure(SHAPE_ROW * len(every) + 0.25, len(every), MOST_CURVES)
    for row, shape in zip(panels, every, strict=True):
        unit, factor = UNITS.get(shape.unit, (shape.unit, 1.0))
        shown = strongest(shape, MOST_CURVES)
        for place, panel in enumerate(row):
            if place >= len(shown):
                panel.set_visible(False)
                continue
            curve = shown[place]
            x, y, spread = factor * shape.values, 1e6 * curve.value, 1e6 * COVERAGE_FACTOR * curve.u
            panel.fill_between(x, y - spread, y + spread, color=style.AFTER, alpha=0.2, linewidth=0,
                               label=f'U (k = {COVERAGE_FACTOR})')
            panel.plot(x, y, color=style.AFTER, linewidth=1.8, label='recovered', marker='o' if x.size < 40 else '',
                       markersize=3)
            if curve.claimed is not None:
                panel.plot(x, 1e6 * curve.claimed, color=style.BEFORE, linewidth=1.6, linestyle=style.DASHED,
                           label='claimed')
            style.scale(panel)
            panel.set(xlabel=f'{shape.variable} / {unit}', ylabel=f'{curve.axis} / µm')
            if curve.carrier:
                panel.annotate(style.label_of(f'× {curve.carrier}'), (1, 1.02), xycoords='axes fraction', ha='right',
                               va='bottom', fontsize=style.TEXT, color=style.GREY)
        row[0].set_title(style.label_of(shape.claim or f'no name: {shape.words}'), pad=16)
    style.legend_of(made, panels.flat)
    return made

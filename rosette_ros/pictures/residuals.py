# SPDX-License-Identifier: Apache-2.0
"""Residuals where they stand: maps of table position and ball, against time and angle, how many."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from rosette_ros.pictures.style import (
    AFTER,
    BEFORE,
    DIVERGING,
    INK,
    QUIET,
    band,
    colour_bar,
    figure,
    label_of,
    line,
    panels,
    scale,
)

ANGLES = {angle: str(angle) for angle in range(0, 301, 60)}
AXES = ('x', 'y', 'z')
LOOKS = ((BEFORE, 4.2), (AFTER, 3.0))
"""Colour and size of the dots before and after what is claimed was added."""
SECTIONS, LEAST_MEAN = 12, 6
"""Most means of neighbours along a line, and how many readings one is made of at least."""
MOST_TICKS = 8
WIDE = 12
"""Histograms end so many sigma from zero; what lies beyond is counted in the last bar."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals (N, 3), m, of a model on a run, with what stands in the legend."""

    label: str
    run: object
    values: np.ndarray

    def grid(self):
        """Return the map (n, n, 3) in µm by table position and ball, NaN where not measured."""
        n = self.run.n
        out = np.full((n, n, 3), np.nan)
        out[self.run.table_position - 1, self.run.ball - 1] = 1e6 * self.values
        return out


def residual_maps(rows):
    """Return a figure of n x n maps: a row of x, y, z for each of some Residuals, µm.

    All maps share one symmetric scale; dashed lines are diagonals of one CMM position.
    """
    grids = [row.grid() for row in rows]
    limit = max(max(float(np.nanmax(np.abs(grid))) for grid in grids), 1e-9)
    height = 3.75 * len(rows) + 0.25
    made = figure(10, height, None)
    wide, high = 0.28, 2.72 / height
    for place, (row, grid) in enumerate(zip(rows, grids, strict=True)):
        bottom = 1 - (3.75 * place + 0.62 + 2.72) / height
        made.text(0.005, 1 - (3.75 * place + 0.1) / height, label_of(row.label), fontsize=11,
                  weight='bold', color=INK, va='top')
        for axis, name in enumerate(AXES):
            panel = made.add_axes((0.06 + 0.293 * axis, bottom, wide, high), xticks=(), yticks=())
            _map(panel, grid[..., axis], limit, 'x' if axis else 'xy')
            panel.set_title(f'residual in {name}', y=1.0, pad=4, fontsize=10, color=INK)
            panel.set_xlabel('ball', fontsize=9, color=INK)
            if axis == 0:
                panel.set_ylabel('table position', fontsize=9, color=INK)
                panel.yaxis.labelpad = 20
    bar = made.add_axes((0.974, bottom, 0.012, 1 - 0.62 / height - bottom), xticks=(), yticks=())
    colour_bar(bar, limit, 'µm', True)
    return made


def _map(panel, values, limit, numbers):
    n = len(values)
    panel.imshow(values, cmap=DIVERGING, vmin=-limit, vmax=limit, aspect='auto', interpolation='none',
                 extent=(0.5, n + 0.5, n + 0.5, 0.5))
    panel.set_facecolor('#bbbbbb')
    shown = {number: str(number) for number in range(1, n + 1, -(-n // MOST_TICKS))}
    marked = sorted({1 + round(part * n / 4) for part in range(4)})
    lines = []
    for number in marked:
        for total in (number + 1, number + 1 + n):
            first, last = max(1, total - n), min(n, total - 1)
            if last > first:
                lines.append([(total - first + 0.35, first - 0.35), (total - last - 0.35, last + 0.35)])
    panel.add_collection(LineCollection(lines, colors=QUIET, linewidths=0.8, linestyles=(0, (3, 3))))
    panel.set(xlim=(0.5, n + 0.5), ylim=(n + 0.5, 0.5))
    # the number stands where its diagonal leaves the map on the left
    line(panel, [1] * len(marked), marked, linestyle='none', marker='o', markersize=11, color='white',
         markeredgecolor=QUIET, markeredgewidth=0.6)
    for number in marked:
        panel.text(1, number, f'{number}', fontsize=7.5, ha='center', va='center', color=INK)
    scale(panel, shown, shown, '', numbers)


def against(series, noise=None):
    """Return a figure of residuals in µm: rows x, y, z, columns time, table angle, temperature.

    series: one or two Residuals of one run, before and after; noise: standard deviation, m, shown as
    a band of two; the lines are means of neighbours. Temperature only where it is known and changes.
    """
    run = series[0].run
    places = _places(run)
    made = figure(10, 6.6, None)
    made.subplots_adjust(left=0.07, right=0.99, bottom=0.125, top=0.98, hspace=0.1, wspace=0.06)
    grid = panels(made, 3, len(places))
    limit = 1.08 * max(float(np.abs(1e6 * one.values).max()) for one in series)
    for axis, name in enumerate(AXES):
        for column, (label, values, marks, sections) in enumerate(places):
            panel = grid[axis, column]
            _scatter(panel, series, axis, values, noise, limit, sections)
            scale(panel, marks, numbers='x' * (axis == 2) + 'y' * (column == 0))
            if axis == 2:
                panel.set_xlabel(label)
        grid[axis, 0].set_ylabel(f'{name}, µm')
    handles, labels = grid[0, 0].get_legend_handles_labels()
    made.legend(handles, labels, loc='lower center', ncols=len(labels), frameon=False, fontsize=9.5)
    return made


def _places(run):
    """Return (label, values (N,), marks, sections) of all that the residuals are drawn against."""
    sections = max(1, min(SECTIONS, run.size // LEAST_MEAN))
    hours = (run.time - run.time[0]) / 3600
    unit, time = ('hours', hours) if hours.max() > 1.5 else ('minutes', 60 * hours)
    out = [(f'time in {unit}', time, None, sections),
           ('table angle in degrees', np.rad2deg(run.table_angle), ANGLES, run.n)]
    known = run.temperature[np.isfinite(run.temperature)]
    if known.size and np.ptp(known) > 0:
        out.append(('temperature in °C', run.temperature, None, sections))
    return out


def _scatter(panel, series, axis, values, noise, limit, sections):
    low = float(np.nanmin(values))
    reach = float(np.nanmax(values)) - low or 1.0
    edges = low - 0.03 * reach, low + 1.03 * reach
    panel.set(xlim=edges, ylim=(-limit, limit))
    if noise is not None:
        band(panel, -2e6 * noise, 2e6 * noise, '±2 σ of the noise')
    line(panel, edges, (0, 0), color=INK, linewidth=0.8)
    for one, (colour, size) in zip(series[-2:], LOOKS[-len(series):], strict=True):
        residual = 1e6 * one.values[:, axis]
        panel.add_artist(_dots(values, residual, 5e-4 * reach, color=colour, linewidth=size))
        place, mean = section_means(values, residual, sections)
        line(panel, place, mean, color=colour, linewidth=1.8, label=f'{label_of(one.label)}, and its mean')


def _dots(x, y, length, color, linewidth):
    """Return a row of dots as one path with round ends in place of N markers."""
    known = np.isfinite(x)
    ends = np.stack([np.stack([x, y], axis=1)[known], np.stack([x + length, y], axis=1)[known]], axis=1)
    path = Path(ends.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], len(ends)))
    path.should_simplify = False
    return PathPatch(path, fill=False, edgecolor=color, linewidth=linewidth, alpha=0.5,
                     capstyle='round', snap=False)


def section_means(values, residual, sections=SECTIONS):
    """Return mean place and mean residual of neighbours along `values`, in equally full sections."""
    order = np.argsort(values, kind='stable')
    order = order[np.isfinite(values[order])]
    edges = np.linspace(0, order.size, min(sections, order.size) + 1).astype(int)
    parts = [order[a:b] for a, b in pairwise(edges)]
    return (np.array([values[part].mean() for part in parts]),
            np.array([residual[part].mean() for part in parts]))


def histogram(series, noise, dof):
    """Return a figure: how many residuals are how large, beside the curve that noise would give.

    series: one or two Residuals, before and after; noise: standard deviation of a coordinate, m, or
    None; dof: degrees of freedom left by each of the models: noise appears smaller by sqrt(dof / 3N).
    """
    made = figure(10, 3.3, None)
    made.subplots_adjust(left=0.065, right=0.99, bottom=0.15, top=0.98)
    panel = panels(made)[0, 0]
    flat = [1e6 * one.values.ravel() for one in series]
    spread = 1e6 * noise if noise is not None else float(np.std(flat[-1]))
    reach = min(max(max(float(np.abs(one).max()) for one in flat), 3.5 * spread), WIDE * spread)
    width = max(spread / 3, reach / 60)
    count = int(np.ceil(reach / width - 0.5))
    edges = width * (np.arange(-count, count + 2) - 0.5)
    for one, values, (colour, _) in zip(series, flat, LOOKS[-len(series):], strict=True):
        counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
        panel.stairs(counts, edges, color=colour, fill=True, alpha=0.25)
        panel.stairs(counts, edges, color=colour, linewidth=1.6, label=label_of(one.label))
    if noise is not None:
        size = flat[-1].size
        shown = spread * np.sqrt(dof[-1] / size)
        where = np.linspace(edges[0], edges[-1], 241)
        density = np.exp(-0.5 * (where / shown)**2) / (shown * np.sqrt(2 * np.pi))
        panel.plot(where, size * width * density, color=INK, linewidth=1.8, linestyle=(0, (4, 2)),
                   label=f'noise alone, σ = {spread:.3f} µm')
    panel.set(xlim=(edges[0], edges[-1]))
    scale(panel, grid='y', steps=(8, 4))
    panel.set_xlabel('residual of a coordinate in µm')
    panel.set_ylabel('coordinates')
    panel.legend(frameon=False, fontsize=10, loc='upper right')
    return made

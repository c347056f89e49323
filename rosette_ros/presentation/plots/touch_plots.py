# SPDX-License-Identifier: Apache-2.0
"""Touches: their residuals, the radii of the spheres, and the path of the tip around a ball."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from rosette_ros.core.run.geometry import Bools, Floats, Ints
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.words.effect_words import fixed

MOST_DOTS = 4000
"""Of more touches the largest residuals and an even choice of the others are drawn."""
_HIGHEST = 6.5  # of both views, inch
_LEFT, _BELOW, _ABOVE, _RIGHT, _LEGEND = 0.62, 0.45, 0.3, 0.08, 0.25  # beside each view and below them, inch


def touch_residuals(refit: SphereRefit) -> Figure:
    """Return a figure: residual of each touch by its number, azimuth and elevation; radius of each sphere."""
    made, [residuals, below] = style.figure(4.6, 2, 3)
    touched, residual = refit.touched, 1e6 * refit.residual
    number = np.arange(residual.size) - touched.first[touched.owner] + 1.0
    x, y, z = refit.approach.T
    azimuth = (np.degrees(np.arctan2(y, x)) + 2.5) % 360 - 2.5
    drawn = _drawn(residual)
    limit = 1.08 * max(float(np.abs(residual).max()), 1e-9)
    for place, (label, values, step, marks) in enumerate((
            ('number of the touch', number, 1, None),
            ('azimuth of the probe in °', azimuth, 5, {angle: str(angle) for angle in range(0, 361, 90)}),
            ('elevation of the probe in °', np.degrees(np.arcsin(np.clip(z, -1, 1))), 4, None))):
        panel = residuals[place]
        panel.axhspan(-2e6 * refit.sigma, 2e6 * refit.sigma, color='#999999', alpha=0.18, linewidth=0)
        panel.axhline(0, color=style.INK, linewidth=0.8)
        panel.plot(values[drawn], residual[drawn], '.', color=style.AFTER, markersize=2, alpha=0.35, rasterized=True)
        where, mean = _means(values, residual, step)
        panel.plot(where, mean, 'o-', color=style.BEFORE, linewidth=1.2, markersize=3)
        panel.set(ylim=(-limit, limit), xlabel=label, ylabel='' if place else 'residual in µm')
        style.scale(panel, marks, numbers='x' if place else 'xy')
    for panel in below:
        panel.remove()
    _radii(made.add_subplot(below[0].get_gridspec()[1, :]), refit)
    return made


def _drawn(residual: Floats) -> Ints:
    """Return the places of the touches that are drawn: all, or the largest and an even choice."""
    if residual.size <= MOST_DOTS:
        return np.arange(residual.size)
    even = np.arange(0, residual.size, -(-2 * residual.size // MOST_DOTS))
    return np.union1d(even, np.argpartition(-np.abs(residual), MOST_DOTS // 2)[:MOST_DOTS // 2])


def _means(values: Floats, residual: Floats, step: int) -> tuple[Floats, Floats]:
    """Return the places where touches are, gathered within a step, and the mean residual there."""
    row = np.unique(np.rint(values / step), return_inverse=True)[1]
    count = np.bincount(row)
    return np.bincount(row, values) / count, np.bincount(row, residual) / count


def _radii(panel: Axes, refit: SphereRefit) -> None:
    radius, number = 1e6 * (refit.radius - refit.radius.mean()), np.arange(1, refit.radius.size + 1)
    spread = 2e6 * refit.radius_u
    panel.axhspan(-spread, spread, color='#999999', alpha=0.18, linewidth=0)
    panel.plot(number, radius, '.', color=style.AFTER, markersize=4 if radius.size < 500 else 2)
    limit = 1.08 * max(float(np.abs(radius).max()), spread, 1e-9)
    panel.set(xlim=(0, radius.size + 1), ylim=(-limit, limit), xlabel='ball centre, in the order of measuring',
              ylabel='difference in µm')
    panel.set_title(f'radius of each sphere less the mean, {fixed(1e3 * float(refit.radius.mean()), 5)} mm')
    style.scale(panel, steps=(10, 5))


def probe_path(points: Floats, is_touch: Bools, radius: float, shaft: tuple[float, float],
               neighbours: Floats) -> Figure:
    """Return a figure of tip centres (N, 3), which begin and end in the clearance plane, to scale.

    Along the circle of balls from left to right, as seen from outside: there neighbours lie beside the ball in both
    views, never before or behind it. All lengths in mm, coordinates from the centre of the ball, x away from the table
    axis, z along it. is_touch: (N,); radius: of the ball; shaft: its radius and length; neighbours: (m, 3) centres of
    the other balls, of which the nearest on either side is shown."""
    balls = np.concatenate([np.zeros((1, 3)), *(_nearest(neighbours[neighbours[:, 1] * side > radius])
                                                for side in (-1, 1))])
    low = np.minimum(points.min(0), balls.min(0) - radius)
    high = np.maximum(points.max(0), balls.max(0) + radius)
    low[2] = -shaft[1]
    margin = 0.08 * (high - low).max()
    low, high = low - [margin, margin, 0.0], high + margin
    wide, tall = high[1] - low[1], np.array([high[0] - low[0], high[2] - low[2]])
    scale = min((style.WIDTH - _LEFT - _RIGHT) / wide, _HIGHEST / tall.sum())
    whole = scale * tall.sum() + 2 * (_BELOW + _ABOVE) + _LEGEND
    made = Figure(figsize=(style.WIDTH, whole))
    made.set_layout_engine('none')  # none keeps the scale
    foot = whole
    for up, size, words in zip((0, 2), scale * tall, ('seen against the axis', 'seen from outside, towards the axis')):
        foot -= _ABOVE + size
        panel = made.add_axes((_LEFT / style.WIDTH, foot / whole, scale * wide / style.WIDTH, size / whole))
        foot -= _BELOW
        for place, centre in enumerate(balls):
            at = centre[1], centre[up]
            look: dict[str, Any] = {'facecolor': 'white' if place else style.GRID, 'edgecolor': style.GREY,
                                    'linewidth': 0.6}
            if up == 2:
                panel.add_patch(Rectangle((at[0] - shaft[0], at[1] - shaft[1]), 2 * shaft[0], shaft[1], **look))
            panel.add_patch(Circle(at, radius, **look,
                                   label=('ball', 'neighbours')[place] if place < 2 else None))
            if place:
                off = -9 - 72 * scale * radius if up == 0 else 5 + 72 * scale * radius
                panel.annotate(f'{np.linalg.norm(centre):.0f} mm away', at, (0, off), textcoords='offset points',
                               ha='center', va='center')
        panel.plot(points[:, 1], points[:, up], color=style.AFTER, linewidth=0.8, label='way of the tip centre')
        panel.plot(*points[is_touch][:, [1, up]].T, linestyle='none', markersize=2.5, marker='o',
                   color=style.BEFORE, label='touches')
        panel.set_xlim(low[1], high[1])
        panel.set_ylim(*((high[0], low[0]) if up == 0 else (low[2], high[2])))  # x downwards: else it is mirrored
        panel.set_aspect('equal')
        style.scale(panel)
        panel.set_xlabel('y / mm, along the circle of balls')
        panel.set_ylabel('x / mm, away from the axis' if up == 0 else 'z / mm')
        panel.set_title(words)
    made.legend(*panel.get_legend_handles_labels(), loc='lower center', ncols=4)
    return made


def _nearest(balls: Floats) -> Floats:
    """Return the ball of (m, 3) that is nearest to the origin, (1, 3), or none, (0, 3)."""
    return balls[np.argsort(np.linalg.norm(balls, axis=1))[:1]]

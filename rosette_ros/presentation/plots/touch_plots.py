# SPDX-License-Identifier: Apache-2.0
"""Touches: their residuals, and the radii of the spheres."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rosette_ros.core.geometry import Floats, Ints
from rosette_ros.core.sphere_refit import SphereRefit
from rosette_ros.presentation.formatting import fixed
from rosette_ros.presentation.plots import plot_style as style

MOST_DOTS = 4000
"""Of more touches the largest residuals and an even choice of the others are drawn."""


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

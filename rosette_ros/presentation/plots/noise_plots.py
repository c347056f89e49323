# SPDX-License-Identifier: Apache-2.0
"""What the noise is like beside what it should be: quantiles, scatter by axis and place, correlation of neighbours."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import AXES, places
from rosette_ros.core.records import Floats
from rosette_ros.presentation.plots import plot_style as style
from rosette_ros.presentation.tables import LEAST_NOISE

LAGS = 12
SHOWN = ('ball', 'CMM position', 'time')
"""Groups of readings whose scatter is drawn; at a table position little is left that could scatter otherwise."""


def noise(fit: Fit) -> Figure:
    """Return a figure of the residual of a fit in white coordinates, in units of its size: 1 where it is such noise."""
    left = fit.white_residual * np.sqrt(3 * fit.run.size / fit.dof) / max(fit.rms, LEAST_NOISE)
    made, panels = style.figure(4.2, 2, 3)
    _quantiles(panels[0, 0], left)
    _scatter(panels[0, 1], 'axis', AXES, [left[:, axis] for axis in range(3)])
    for panel, (name, index, keys) in zip(panels.flat[2:], (one for one in places(fit.run) if one[0] in SHOWN),
                                          strict=False):
        _scatter(panel, name, [key.partition('-')[0] for key in keys],
                 [left[index == group] for group in range(len(keys))])
    _correlation(panels[1, 2], left)
    style.legend_of(made, panels[0, :2])
    return made


def _quantiles(panel: Axes, left: Floats) -> None:
    """Draw sorted residuals of each axis against those of normal noise, which lie on the line."""
    wanted = ndtri((np.arange(len(left)) + 0.5) / len(left))
    for axis, name in enumerate(AXES):
        panel.plot(wanted, np.sort(left[:, axis]), linestyle='none', markersize=3, label=name, **style.look_of(axis))
    panel.plot(wanted[[0, -1]], wanted[[0, -1]], color=style.INK, linewidth=1, label='normal noise')
    style.scale(panel)
    panel.set(xlabel='quantile of normal noise, in σ', ylabel='residual in order, in σ')


def _scatter(panel: Axes, name: str, keys: Sequence[str], groups: Sequence[Floats]) -> None:
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

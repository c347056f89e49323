# SPDX-License-Identifier: Apache-2.0
"""Spectra of displacements: where the base model lives, where residuals sit, where effects would be."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import ListedColormap, Normalize

from rosette_ros.core.spectrum import Spectrum
from rosette_ros.pictures.style import INK, QUIET, figure, label_of, scale

TAKEN = ListedColormap([(0.93, 0.93, 0.93)])
MOST_NUMBERS = 7


@dataclass(frozen=True, eq=False)
class SpectrumRow:
    """A Spectrum with what stands beside it; hide: whether the base model's lines are empty in it."""

    label: str
    spectrum: Spectrum
    hide: bool = False


def spectrum_maps(rows, noise=None):
    """Return a figure of two maps (z; x and y) for each of some SpectrumRows, µm.

    All maps share one linear scale from zero; grey is what the base model takes whole. noise: sigma of a
    coordinate, m; sizes of noise alone are then written below.
    """
    height = 3.3 * len(rows) + 0.35
    made = figure(10, height, None)
    limit = 1e6 * max(max(row.spectrum.left.max() for row in rows), 1e-15)
    norm = Normalize(0, limit)
    for place, row in enumerate(rows):
        top = 1 - (3.3 * place + 0.1) / height
        made.text(0.005, top, f'{label_of(row.label)}  ({100 * row.spectrum.seen:.0f} % off the lines of '
                  'the base model)' if not row.hide else label_of(row.label), fontsize=11, weight='bold',
                  color=INK, va='top')
        sizes = [1e6 * row.spectrum.axial, 1e6 * row.spectrum.plane]
        bottom = 1 - (3.3 * place + 2.85) / height
        for side, (name, size, base) in enumerate(zip(
                ('z', 'x and y'), sizes, (row.spectrum.axial_base, row.spectrum.plane_base))):
            panel = made.add_axes((0.075 + 0.405 * side, bottom, 0.36, 2.2 / height), xticks=(), yticks=())
            _map(panel, row.spectrum.waves, size, base, norm, row.hide)
            panel.set_title(f'waves of the {"residual" if row.hide else "effect"} in {name}', fontsize=10,
                            color=INK, y=1.0, pad=4)
            panel.set_xlabel('waves per turn of CMM positions', fontsize=9, color=INK)
            if side == 0:
                panel.set_ylabel('waves per turn of the table', fontsize=9, color=INK)
        bar = made.add_axes((0.89, bottom, 0.014, 2.2 / height), xticks=(), yticks=())
        bar.imshow(np.linspace(0, 1, 101)[:, None], cmap='cividis', aspect='auto', origin='lower', interpolation='none',
                   extent=(0, 1, 0, limit))
        scale(bar, {}, None, '', 'y', (0, 6))
        bar.set_title('µm', fontsize=9, color=INK, y=1.0, pad=4)
    if noise is not None:
        n = len(rows[0].spectrum.waves)
        made.text(0.995, 0.004, f'noise alone: about {1e6 * noise / n:.2g} µm in z, '
                  f'{1e6 * noise * np.sqrt(2) / n:.2g} µm in x and y; grey: taken by the base model',
                  fontsize=9, color=QUIET, ha='right', va='bottom')
    return made


def _map(panel, waves, size, base, norm, hide):
    edge = (waves[0] - 0.5, waves[-1] + 0.5, waves[0] - 0.5, waves[-1] + 0.5)
    whole = base >= 1
    shown = np.ma.masked_where(whole & hide, size)
    panel.imshow(shown, cmap='cividis', norm=norm, origin='lower', extent=edge, aspect='auto', interpolation='none')
    panel.imshow(np.ma.masked_where(~whole, base), cmap=TAKEN, origin='lower', extent=edge, aspect='auto',
                 interpolation='none', alpha=1.0 if hide else 0.55)
    numbers = waves[waves % max(1, len(waves) // MOST_NUMBERS) == 0]
    texts = {int(one): f'{one}'.replace('-', '−') for one in numbers}
    scale(panel, texts, texts, grid='')

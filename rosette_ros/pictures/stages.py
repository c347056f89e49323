# SPDX-License-Identifier: Apache-2.0
"""The ladder of models, the candidates, and what an order shows: bars that a person can compare."""

import numpy as np

from rosette_ros.pictures.style import (
    AFTER,
    BEFORE,
    BEHIND,
    COLOURS,
    INK,
    QUIET,
    figure,
    label_of,
    panels,
    scale,
)

BAR = 0.34
SHORTEST = 28
"""Longest name of a model that stands beside its bar; the rest is cut."""


def ladder(names, fitted, held_out, repeatability=None, spread=0.0):
    """Return a figure: the error of every model in the fit and in readings left out, µm.

    names: of the models, the simplest first; fitted, held_out: m; repeatability: m or None, and its
    standard uncertainty, m.
    """
    rows = np.arange(len(names))
    made, panel = _rows(len(names), 0.62, 1.05)
    for values, offset, colour, label in (
            (fitted, -BAR / 2, AFTER, 'in the fit'),
            (held_out, BAR / 2, COLOURS[4], 'in readings that were left out')):
        sizes = 1e6 * np.asarray(values, dtype=float)
        panel.barh(rows + offset, sizes, BAR, color=colour, label=label)
        for row, size in zip(rows, sizes, strict=True):
            panel.annotate(f'{size:.3f}', (size, row + offset), (4, 0), textcoords='offset points',
                           va='center', fontsize=9, color=INK, bbox=BEHIND)
    if repeatability is not None:
        known = 1e6 * repeatability
        panel.axvspan(known - 2e6 * spread, known + 2e6 * spread, color=INK, alpha=0.13, linewidth=0)
        panel.axvline(known, color=INK, linewidth=1.6, linestyle=(0, (4, 2)),
                      label=f'repeatability, {known:.3f} µm')
    panel.set_xlim(0, 1.13e6 * max(max(fitted), max(held_out), repeatability or 0))
    _finish(made, panel, names, 'error of a coordinate in µm (rms)')
    return made


def candidates(names, before, after, claimed, noise=None):
    """Return a figure: how far each candidate brings the error in left-out readings down, µm.

    names: of the candidates, best first; before, after: held-out errors, m; claimed: which of them
    are claimed; noise: standard deviation, m, or None.
    """
    rows = np.arange(len(names))
    before, after = 1e6 * np.asarray(before), 1e6 * np.asarray(after)
    made, panel = _rows(len(names), 0.34, 1.05)
    panel.hlines(rows, np.minimum(before, after), np.maximum(before, after), color='#bbbbbb',
                 linewidth=3)
    panel.plot(before, rows, linestyle='none', marker='o', markersize=7, color=BEFORE,
               markerfacecolor='white', markeredgewidth=1.6, label='without it')
    for chosen, marker, label in ((True, 'o', 'with it: claimed'), (False, 'd', 'with it: not claimed')):
        mask = np.asarray(claimed, dtype=bool) == chosen
        if mask.any():
            panel.plot(after[mask], rows[mask], linestyle='none', marker=marker, markersize=7,
                       color=AFTER if chosen else QUIET, label=label)
    if noise is not None:
        panel.axvline(1e6 * noise, color=INK, linewidth=1.4, linestyle=(0, (4, 2)),
                      label='repeatability')
    _finish(made, panel, names, 'error in left-out readings in µm (rms)')
    return made


def visibility(names, present, best=None, labels=('this order', 'recommended order'), hidden=0.05):
    """Return a figure: the share of every effect that an order shows, beside the recommended one.

    names: of the effects; present, best: typical visible shares, 0 to 1 (NaN: not judged), best None
    where nothing is recommended; labels: of the two orders; hidden: share below which it is hidden.
    """
    rows = np.arange(len(names))
    present = np.asarray(present, dtype=float)
    made, panel = _rows(len(names), 0.27, 0.95)
    shown = np.nan_to_num(present)
    colours = [BEFORE if share < hidden else AFTER for share in shown]
    panel.barh(rows, shown, 0.62, color=colours)
    panel.barh([0], [0], color=AFTER, label=label_of(labels[0]))
    if (shown < hidden).any():
        panel.barh([0], [0], color=BEFORE, label=f'hidden (below {100 * hidden:.0f} %)')
    for row, share in zip(rows, present, strict=True):
        text = ' not judged' if np.isnan(share) else ' hidden' if share < hidden else ''
        panel.text(np.nan_to_num(share), row, text, va='center', fontsize=8.5, color=BEFORE)
    if best is not None:
        panel.plot(best, rows, linestyle='none', marker='D', markersize=6, color=INK,
                   markerfacecolor='white', markeredgewidth=1.3, label=label_of(labels[1]))
    panel.set_xlim(0, 1.02)
    _finish(made, panel, names, 'share of the effect that the residual shows',
            {share / 100: f'{share} %' for share in range(0, 101, 20)})
    return made


def _rows(count, per_row, foot):
    height = per_row * count + foot
    made = figure(10, height, None)
    made.subplots_adjust(left=0.24, right=0.98, bottom=(foot - 0.1) / height, top=1 - 0.1 / height)
    return made, panels(made)[0, 0]


def _finish(made, panel, names, label, marks=None):
    cut = [f'{name[:SHORTEST - 1]}…' if len(name) > SHORTEST else name for name in names]
    panel.set_ylim(len(names) - 0.4, -0.6)
    scale(panel, marks, {row: label_of(name) for row, name in enumerate(cut)}, 'x', steps=(8, 8))
    panel.set_xlabel(label)
    handles, labels = panel.get_legend_handles_labels()
    made.legend(handles, labels, loc='lower center', ncols=len(labels), frameon=False, fontsize=9.5)

# SPDX-License-Identifier: Apache-2.0
"""What an order of measurement can show: visible share, bias on the curves, smallest amplitude.

For an effect with columns D the visible part is D_perp = D - Q Q' D; what is not visible is taken up
by plate and CMM, harmlessly, or by the table, as a bias on the six curves.
"""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.atoms import Projection, families
from rosette_ros.core.base import base_space
from rosette_ros.core.effects.contract import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.records import CURVES

HIDDEN_SHARE = 0.05
DETECTABLE = 6.0
"""Norm of the visible part, in sigma, that the search finds nearly always."""
SAME_SHAPE = 0.95


@dataclass(frozen=True, eq=False)
class Visibility:
    """What a run shows of one effect.

    share: of its best setting; typical_share: median over its settings; setting: the typical one;
    bias: largest change of each curve, m or rad in the order of CURVES, for an effect that moves the
    balls by `unit_size` metres rms; detectable: rms displacement of the balls that is found nearly
    always, m, inf where hidden; alike: effects whose visible part has the same shape; reason: why
    the effect cannot be judged at all, empty where it can.
    """

    name: str
    share: float
    typical_share: float
    setting: Setting
    bias: np.ndarray
    detectable: float
    alike: tuple[str, ...]
    reason: str

    @property
    def hidden(self):
        """Whether this order hides the effect."""
        return not self.reason and self.share < HIDDEN_SHARE


def visibility(run, sigma=1e-7, terms=None, lever=None, names=()):
    """Return the Visibility of every effect of the library on a run, a tuple.

    Only indices, angles, times, temperatures and senses of the run count, not the ball centres.
    sigma: standard deviation of a coordinate, m; terms: base terms; lever: m, nominal radius if
    None; names: of the effects to look at, all if none.
    """
    space = base_space(run, lever or run.radius, *([terms] if terms is not None else []))
    project = Projection(space, run.size)
    out, shapes = [], {}
    for name, effect in EFFECTS.items():
        if names and name not in names:
            continue
        reason = effect.unavailable(run) or (
            '' if effect.settings(run) else 'what it depends on does not change in this run')
        if reason:
            out.append(Visibility(name, 0.0, 0.0, Setting(), np.zeros(6), np.inf, (), reason))
            continue
        every = _shares(run, effect, project)
        setting, share = every[len(every) // 2]
        bias, detectable, rows = _consequences(run, effect, setting, space, sigma)
        shapes[name] = rows
        out.append(Visibility(name, max(share for _, share in every), share, setting, bias,
                              detectable, (), ''))
    return tuple(_with_alike(entry, shapes) for entry in out)


def _shares(run, effect, project):
    """Return (setting, visible share) of every setting, by rising share."""
    pairs = [(setting, float(share))
             for family in families(run, (effect,), project, keep_hidden=True)
             for setting, share in zip(family.settings, family.shares)]
    return sorted(pairs, key=lambda pair: pair[1])


def _consequences(run, effect, setting, space, sigma):
    """Return bias on the curves per metre rms, detectable rms size, and visible directions."""
    columns = np.moveaxis(effect.columns(run, setting), -1, 0)
    columns = columns - columns.mean(axis=1, keepdims=True)
    size = np.sqrt(np.mean(np.sum(columns**2, axis=2), axis=1))
    columns = columns[size > 0] / size[size > 0][:, None, None]
    if not len(columns):
        return np.zeros(6), np.inf, np.zeros((0, 3 * run.size))
    curves = space.parameters(columns).curves
    bias = np.abs(curves).max(axis=(0, 1))
    visible = space.residual(columns).reshape(len(columns), -1)
    singular, rows = np.linalg.svd(visible, full_matrices=False)[1:]
    weakest = np.linalg.norm(visible, axis=1).max()
    detectable = DETECTABLE * sigma / weakest if weakest > 1e-6 else np.inf
    return bias, float(detectable), rows[singular > 1e-3 * max(singular[0], 1e-12)]


def _with_alike(entry, shapes):
    own = shapes.get(entry.name)
    if own is None or not len(own) or entry.hidden:
        return entry
    alike = []
    for name, rows in shapes.items():
        if name == entry.name or not len(rows):
            continue
        # the largest principal cosine: some displacement that both effects can make
        if np.linalg.norm(own @ rows.T, 2) > SAME_SHAPE:
            alike.append(name)
    values = {field: getattr(entry, field) for field in entry.__dataclass_fields__}
    return Visibility(**{**values, 'alike': tuple(alike)})


__all__ = ['CURVES', 'Visibility', 'visibility']

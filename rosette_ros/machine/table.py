# SPDX-License-Identifier: Apache-2.0
"""The rotary table: six smooth periodic error curves and its correction tables."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.geometry import TWO_PI
from rosette_ros.machine.streams import part_generator

_DENSE = 2048
"""Angles on which the peak of a curve is found."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Six periodic functions of the table angle: Fourier sums without a constant.

    orders: (h,) harmonics; cosine, sine: (h, 6) amplitudes, m and rad in the order of
    core.records.CURVES.
    """

    orders: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray

    def __call__(self, angle):
        """Return the six curves at angles (...), as (..., 6)."""
        turned = np.asarray(angle, dtype=float)[..., None] * self.orders
        return np.cos(turned) @ self.cosine + np.sin(turned) @ self.sine


@dataclass(frozen=True, eq=False)
class RotaryTable:
    """A table with what its corrections leave (`residual`) and what they take out (`maker`)."""

    residual: Curves
    maker: Curves
    switched_off: np.ndarray

    def error(self, angle):
        """Return (ctx, cty, ctz, crx, cry, crz) of the table as it is set, (..., 6)."""
        if not self.switched_off.any():
            return self.residual(angle)
        return self.residual(angle) + self.switched_off * self.maker(angle)


def build_table(settings, seed):
    """Return the RotaryTable of TableSettings."""
    rng = part_generator(seed, 'table')
    smooth = np.arange(1, settings.harmonics + 1)
    peaks = 1e-6 * np.array([settings.translation_um] * 3 + [settings.rotation_urad] * 3)
    maker_peaks = 1e-6 * np.array([0, 0, settings.axial_raw_um, 0, 0, settings.angular_raw_urad])
    residual, maker = _drawn(rng, smooth, peaks), _drawn(rng, smooth, maker_peaks)
    if settings.fine_orders:
        residual = _with_fine(residual, settings, peaks, seed)
    off = np.zeros(6)
    off[2], off[5] = not settings.axial_correction, not settings.angular_correction
    return RotaryTable(residual, maker, off)


def _drawn(rng, orders, peaks):
    """Return random curves whose amplitudes fall with the order and whose peaks are given."""
    raw = rng.standard_normal((2, orders.size, 6)) / orders[:, None]
    curves = Curves(orders, *raw)
    scale = peaks / np.abs(curves(TWO_PI * np.arange(_DENSE) / _DENSE)).max(axis=0)
    return Curves(orders, raw[0] * scale, raw[1] * scale)


def _with_fine(curves, settings, peaks, seed):
    orders = np.array(settings.fine_orders)
    phase = part_generator(seed, 'fine').uniform(0, TWO_PI, (orders.size, 6))
    size = settings.fine_share * peaks
    return Curves(np.concatenate([curves.orders, orders]),
                  np.concatenate([curves.cosine, size * np.cos(phase)]),
                  np.concatenate([curves.sine, size * np.sin(phase)]))

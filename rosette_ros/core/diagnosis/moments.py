# SPDX-License-Identifier: Apache-2.0
"""When an event happened: between which readings its instants lie."""

import numpy as np

from rosette_ros.core.diagnosis.cause import Interval
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.run_functions import around, beside, seconds
from rosette_ros.core.model.least_squares import Fit, JointSpace
from rosette_ros.core.sight.limits import LISTED

NEAR = 60
"""So many gaps between readings to either side are asked whether a moment lies there."""


def moments_of(fitted: Fit, place: int) -> dict[str, Interval]:
    """Return where each instant of an effect lies: in the fewest gaps between readings in a row that have 95 %.

        p(gap) ~ exp(f / (2 sigma^2)),    f: fall of the square sum by the effect with the instant in the gap

    place: of the effect in the fit, whose other effects and settings stay as they are."""
    run, effect, own = fitted.run, fitted.model.terms[place].effect, fitted.effects[place]
    widths = [one.effect.width(run, found.setting) for one, found in zip(fitted.model.terms, fitted.effects)]
    mine = slice(*np.cumsum([0, *widths])[place:place + 2])
    columns = fitted.joint.columns
    others = JointSpace(fitted.joint.space, np.delete(columns, mine, axis=0), columns[:0])
    left = others.residual((fitted.residual + own.displacement)[None]).reshape(-1)

    out = {}
    for name, times in effect.moments(run, own.setting).items():
        middle = beside(0.5 * (times[1:] + times[:-1]), own.setting.number(name), NEAR)
        every = [Setting({**own.setting, name: float(one)}) for one in middle]
        kept = [one for one in every if 't1' not in one or one.number('t0') < one.number('t1')]

        rows = np.asarray(effect.blocks(run, kept))
        rows = others.residual(rows.reshape(-1, run.size, 3)).reshape(*rows.shape[:2], -1)
        shown = rows @ left
        fall = np.einsum('bi,bij,bj->b', shown, np.linalg.pinv(rows @ rows.swapaxes(1, 2), hermitian=True), shown)
        p = np.exp((fall - fall.max()) / (2 * max(fitted.sigma, 1e-15)**2))
        p /= p.sum()

        low = high = int(p.argmax())
        while p[low:high + 1].sum() < 1 - LISTED:
            lower = high + 1 == p.size or (low > 0 and p[low - 1] >= p[high + 1])
            low, high = (low - 1, high) if lower else (low, high + 1)
        begin, _ = around(times, kept[low].number(name))
        _, end = around(times, kept[high].number(name))
        last, first = int(np.sum(seconds(run) <= begin)), int(np.sum(seconds(run) < end)) + 1
        out[name] = Interval(begin, end, last, first, float(p[low:high + 1].sum()))
    return out

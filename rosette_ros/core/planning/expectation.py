# SPDX-License-Identifier: Apache-2.0
"""What a planned run determines before anything is measured: rank, uncertainty of the curves, time, what stays open."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.model.base_entries import refuse_undetermined
from rosette_ros.core.model.base_space import GAUGE, BaseSpace
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.run.reduced_sets import relative_uncertainty
from rosette_ros.core.run.scheme import Scheme
from rosette_ros.core.run.touches import USUAL_PACE, Pace, sigma_of_touches


@dataclass(frozen=True, eq=False)
class Expectation:
    """What a run of N readings will determine.

    rank: of the base model, of full_rank for a complete run; u: (n, 6) standard uncertainties of the curves where the
    standard deviation of a coordinate from USUAL touches is 1, - and 1/m; penalty: u relative to that of a complete run
    of USUAL touches, rms over the curves; ideal: sqrt(n^2 / N), the penalty if no information were lost; spread: the
    standard deviation of a coordinate from the touches of the plan, relative to USUAL, rms over the axes; duration: s;
    unobservable: what stays unknown, in words.
    """

    rank: int
    full_rank: int
    u: Floats
    penalty: float
    ideal: float
    spread: float
    duration: float
    unobservable: tuple[str, ...]


def expect(scheme: Scheme, radius: float, pace: Pace = USUAL_PACE) -> Expectation:
    """Return the Expectation of a scheme; radius: m; pace: of the cell.

    Raises InvalidPlan where it does not determine the curves.
    """
    refuse_undetermined(scheme)
    run = planned_run(scheme, radius, pace)
    space, n = BaseSpace(run, radius), scheme.n
    number = np.unique(scheme.touches, return_counts=True)
    every = np.array([sigma_of_touches(int(touches), 1.0) if touches else np.ones(3) for touches in number[0]])
    x, _, z = np.sqrt(number[1] @ every**2 / run.size)
    variance = space.curve_cofactor() * np.array([x, x, z, z, z, x])**2
    return Expectation(space.rank, 12 * n - 13, np.sqrt(variance), relative_uncertainty(variance, radius),
                       float(n / np.sqrt(run.size)), float(np.sqrt((2 * x**2 + z**2) / 3)), float(run.time[-1]),
                       _unobservable(run))


def _unobservable(run: Run) -> tuple[str, ...]:
    """Return in words what a run leaves open that determines the curves."""
    every, words = np.arange(1, run.n + 1), list(GAUGE)
    for what, used in (('ball places', run.ball), ('the CMM at positions', run.cmm_position)):
        if (unused := np.setdiff1d(every, used)).size:
            words.append(f'deviations of {what} {", ".join(map(str, unused))}: not measured')
    return tuple(words)

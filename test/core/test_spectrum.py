# SPDX-License-Identifier: Apache-2.0
"""The spectrum of a displacement: known waves at known places, and what the base model takes."""

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.comparison import spectrum
from rosette_ros.core.errors import NotDeterminable
from rosette_ros.core.model.base_entries import line_shares
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.records import Run

RUN =  synthetic_run(9, 'random', 1)[0]


def wave(p, q, axis):
    """Return 1 um cos(p phi + q alpha) along an axis."""
    out = np.zeros((RUN.size, 3))
    out[:, axis] = 1e-6 * np.cos(p * RUN.phi + q * RUN.alpha)
    return out


def test_a_wave_stands_at_its_own_place():
    """A cosine in z of 2 waves of the table and 3 of the CMM: half of it at (2, 3), half at (-2, -3)."""
    found = spectrum(RUN, wave(2, 3, 2))
    where = {(int(found.waves[i]), int(found.waves[j])) for i, j in np.argwhere(found.axial > 1e-9)}
    assert where == {(2, 3), (-2, -3)}
    assert found.axial.max() == pytest.approx(0.5e-6, rel=1e-12)
    assert found.plane.max() < 1e-18
    assert found.seen == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(('p', 'q', 'axis'), [(0, 3, 2), (4, 0, 2), (3, 1, 2), (-2, 2, 2), (0, 4, 0)])
def test_what_the_base_model_takes_is_not_seen(p, q, axis):
    """CMM, axial motion, tilt and plate along z, CMM in the plane."""
    assert spectrum(RUN, wave(p, q, axis)).seen == pytest.approx(0, abs=1e-12)


def test_the_lines_count_the_rank():
    """The points that the base model takes are its rank: one for each of z, two for each of w."""
    axial, plane = line_shares(9)
    assert axial.sum() + 2 * plane.sum() == BaseSpace(RUN, RUN.radius).rank == 12 * 9 - 13


def test_a_residual_has_nothing_on_whole_lines():
    """What a fit leaves of random readings is off the lines."""
    left = BaseSpace(RUN, RUN.radius).residual(np.random.default_rng(3).standard_normal((1, 81, 3)))
    found = spectrum(RUN, left[0])
    assert found.axial[found.axial_base == 1].max() < 1e-15
    assert found.plane[found.plane_base == 1].max() < 1e-15
    assert found.seen > 0.97


def test_an_incomplete_run_has_no_spectrum():
    """It is said what to use instead."""
    part = Run(9, RUN.radius, RUN.table_position[1:], RUN.ball[1:], RUN.centre[1:])
    with pytest.raises(NotDeterminable, match='every ball once in every table position, got 80'):
        spectrum(part, np.zeros((80, 3)))

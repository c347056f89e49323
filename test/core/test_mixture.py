# SPDX-License-Identifier: Apache-2.0
"""Mixtures of normal distributions: moments, probabilities and coverage factors by hand."""

import numpy as np
import pytest
from scipy import special

from rosette_ros.core.uncertainty.error_summary import SURE, AxisError, Conformity
from rosette_ros.core.uncertainty.mixture import Mixture, total


def test_law_of_total_variance():
    """Two explanations, 3 to 1, of 1 +- 1 and 5 +- 2: mean 2; within 0.75 + 1, between 0.75 + 2.25."""
    mean, u = total(np.array([0.75, 0.25]), np.array([[1.0], [5.0]]), np.array([[1.0], [2.0]]))
    assert mean[0] == 2 and u[0]**2 == pytest.approx(1.75 + 3)
    both = Mixture.together([3, 1], [Mixture.of_parts(1, 1, []), Mixture.of_parts(5, 4, [])])
    assert both.moments == pytest.approx((2, 4.75))


def test_a_normal_one_has_its_factor():
    """k = 2 for 95.45 %, whatever number of parts is surely there."""
    for parts in ([], [(1.0, 3.0)], [(1.0, 1.0), (1.0, 2.0)]):
        one = Mixture.of_parts(0.0, 4.0, parts)
        assert one.factor(2 * SURE - 1) == pytest.approx(2)
        assert one.below(2.0) == pytest.approx(special.ndtr(1))


def test_a_part_that_may_be_there():
    """There with 0.1 it has ten times its variance; else nothing: probabilities add up by hand."""
    one = Mixture.of_parts(0.0, 2.0, [(0.1, 1.0)])
    assert one.moments == pytest.approx((0, 2))
    assert one.below(3.0) == pytest.approx(0.9 * special.ndtr(3) + 0.1 * special.ndtr(3 / np.sqrt(11)))
    assert one.factor(2 * SURE - 1) == pytest.approx(1.9566, abs=1e-4)
    wide = Mixture.of_parts(0.0, 2.0, [(0.1, 1.9)])
    assert wide.factor(2 * SURE - 1) > 2


def test_many_parts_keep_their_variance():
    """Beyond the ten largest they are taken as normal."""
    one = Mixture.of_parts(0.0, 30.0, [(0.2, 1.0)] * 20)
    assert one.moments == pytest.approx((0, 30)) and len(one.p) == 2**10


def test_conformity_is_decided_by_the_distribution():
    """The same range and u, normal or not, against the same tolerance (JCGM 106)."""
    u = np.sqrt(2.0)
    normal = AxisError('ctz', 'EZC', 5.0, u, 1.0, 1.0, 1.0, tolerance=5 + 2.05 * u)
    heavy = AxisError('ctz', 'EZC', 5.0, u, 1.0, 1.0, 1.0, tolerance=5 + 2.05 * u,
                      spread=Mixture.of_parts(5.0, 2.0, [(0.1, 1.5)]))
    assert normal.conformity is Conformity.CONFORMS and normal.within > SURE and normal.factor == 2
    assert heavy.conformity is Conformity.UNDECIDED and heavy.within < SURE and heavy.factor > 2
    assert heavy.expanded == pytest.approx(heavy.factor * u)
    assert AxisError('ctz', 'EZC', 5.0, u, 1.0, 1.0, 1.0, tolerance=5 - 4 * u, spread=heavy.spread
                     ).conformity is Conformity.FAILS
    assert normal.within == pytest.approx(Mixture.of_parts(5.0, 2.0, []).below(normal.tolerance))

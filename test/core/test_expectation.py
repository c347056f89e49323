# SPDX-License-Identifier: Apache-2.0
"""What a plan determines before it is measured: by touches and places."""

import pytest

from rosette_ros.core.planning.expectation import expect
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.run.touches import sigma_of_touches


def test_sigma_of_touches():
    """20 touches give sigma; fewer less than by their number, as the positioning of the CMM stays."""
    assert sigma_of_touches(20, 1e-7) == pytest.approx(1e-7)
    assert 1e7 * sigma_of_touches(8, 1e-7)[[0, 2]] == pytest.approx([1.20, 1.08], abs=0.005)
    assert 1e7 * sigma_of_touches(6, 1e-7)[[0, 2]] == pytest.approx([1.285, 1.194], abs=0.005)


def test_expectation_of_a_complete_and_of_a_reduced_run():
    """A complete run is the unit; a reduced one has its penalty, not less than the ideal one."""
    complete, half = expect(plan(12), 0.1825), expect(plan(12, cmm_positions=(1, 2, 4, 6, 9, 10)), 0.1825)
    assert complete.penalty == pytest.approx(1) and complete.rank == complete.full_rank == 131
    assert half.penalty == pytest.approx(1.522, abs=1e-3) and half.ideal == pytest.approx(2**0.5) and half.rank == 113
    assert complete.u[0] == pytest.approx([0.264, 0.264, 0.276, 2.04, 2.04, 1.51], rel=5e-3)

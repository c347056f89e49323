# SPDX-License-Identifier: Apache-2.0
"""Plans are refused exactly where the curves of the run would not be determined."""

import numpy as np
import pytest

from rosette_ros.core.model.base_entries import refuse_undetermined
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.run.errors import InvalidPlan, NotDeterminable
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import Scheme, plan

N = 6


def is_refused(scheme):
    """Return whether the plan is refused."""
    try:
        refuse_undetermined(scheme)
    except InvalidPlan:
        return True
    return False


def is_refused_when_measured(scheme):
    """Return whether the dense least squares of the run refuses it."""
    run = Run(N, 0.1, scheme.table_position, scheme.ball, np.zeros((scheme.ball.size, 3)))
    try:
        BaseSpace(run, 0.1)
    except NotDeterminable:
        return True
    return False


@pytest.mark.parametrize('size', [22, 24, 26, 30])
def test_plans_are_refused_where_their_runs_would_be(size):
    """Drawn pairs of table position and ball: some determine the curves, some do not."""
    rng, whole, found = np.random.default_rng(size), plan(N), []
    for _ in range(40):
        part = rng.choice(N * N, size, replace=False)
        scheme = Scheme(N, 'own', 0, whole.table_position[part], whole.ball[part], np.ones(size, dtype=int))
        found.append((is_refused(scheme), is_refused_when_measured(scheme)))
    assert all(before == after for before, after in found)
    if size in (24, 26):
        assert {before for before, _ in found} == {True, False}

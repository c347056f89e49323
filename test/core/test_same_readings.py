# SPDX-License-Identifier: Apache-2.0
"""One rule of what is the same run, for several runs as one, for those of a cell and for a second run."""

import numpy as np

from rosette_ros.core.run.same_readings import in_common, is_once_more
from rosette_ros.core.run.scheme import plan

CENTRES = np.random.default_rng(1).uniform(-0.2, 0.2, (36, 3))


def test_a_run_and_a_part_of_it_are_one_run():
    """To 1 nm, whichever is given first; a tenth may differ, as where a few were measured anew."""
    assert in_common(CENTRES, CENTRES + 1e-10) == 36
    assert in_common(CENTRES[:20], CENTRES) == in_common(CENTRES, CENTRES[:20]) == 20
    assert is_once_more(CENTRES, CENTRES) and is_once_more(CENTRES[5:30], CENTRES)
    few = CENTRES.copy()
    few[:3] += 1e-7
    assert in_common(few, CENTRES) == 33 and is_once_more(few, CENTRES)


def test_another_run_is_not():
    """Its noise differs, or the order of what is equal."""
    noise = np.random.default_rng(2).normal(0, 1e-7, CENTRES.shape)
    assert in_common(CENTRES, CENTRES + noise) == 0 and not is_once_more(CENTRES, CENTRES + noise)
    assert not is_once_more(CENTRES, CENTRES[np.random.default_rng(3).permutation(36)])


def test_readings_without_noise_in_two_orders_are_two_runs():
    """Whichever is given first: of one in the order of the other most steps rise, but no long row of them does."""
    off = np.random.default_rng(4).uniform(-1e-6, 1e-6, (12, 12, 3))
    one, other = (made.centres(0.18) + off[made.table_position - 1, made.ball - 1]
                  for made in (plan(12, 'diagonal'), plan(12, 'column')))
    assert in_common(one, other) == in_common(other, one) < 72
    assert not is_once_more(one, other) and not is_once_more(other, one)

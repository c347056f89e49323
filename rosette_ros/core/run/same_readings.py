# SPDX-License-Identifier: Apache-2.0
"""Readings that two runs have in common: of the same run, given twice, the noise would count as that of two."""

from bisect import bisect_left

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.run.records import SAME_READING, SAME_SHARE, Floats


def in_common(one: Floats, other: Floats) -> int:
    """Return how many ball centres, (n, 3) and (m, 3), m, are in both, in the same order."""
    short, long = (one, other) if len(one) < len(other) else (other, one)
    apart, nearest = scipy.spatial.cKDTree(long).query(short, p=np.inf)
    rising = list[int]()  # the least last place of a row of each length: what is in the same order both ways
    for place in np.asarray(nearest)[apart < SAME_READING].tolist():
        at = bisect_left(rising, place)
        rising[at:at + 1] = [place]
    return len(rising)


def is_once_more(one: Floats, other: Floats) -> bool:
    """Return whether ball centres, (n, 3) and (m, 3), m, are those of one run, or of a part of it."""
    return in_common(one, other) >= SAME_SHARE * min(len(one), len(other))

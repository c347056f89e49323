# SPDX-License-Identifier: Apache-2.0
"""Shares of runs with their exact binomial interval."""

from scipy.stats import binomtest


def interval(count: int, runs: int) -> tuple[float, float]:
    """Return the exact (Clopper-Pearson) 95 % interval of a probability of which `count` of `runs` were seen."""
    found = binomtest(count, runs).proportion_ci(0.95, 'exact')
    return float(found.low), float(found.high)


def percent(count: int, runs: int) -> str:
    """Return a share in percent, in words of a table."""
    return f'{100 * count / runs:.0f} %'


def share(count: int, runs: int) -> str:
    """Return a count, its share and, in the next column, its interval."""
    low, high = interval(count, runs)
    return f'{count} ({percent(count, runs)}) | {100 * low:.1f}–{100 * high:.1f} %'

# SPDX-License-Identifier: Apache-2.0
"""The order `sensitive`: small steps of the table in which every effect of the library shows.

Each of n sweeps takes the table once round, one division after the other, forwards or backwards:

    sweep m, reading r:   i = s_m + d_m r,   j = v_m + w_i,   k = i + j   (modulo n, from 0)

Every pair is measured once because v runs through 0..n-1. The shifts w_i fall by two over one part
of the table and rise by one over the other, so that the CMM goes back one position a reading, or on
by two, and the balls alternate. What slow effects show depends on v, d, w and the gaps between the
sweeps alone. For the numbers of balls in sensitive_orders they were found by `design`, for very few
balls reading by reading; for all others a rule makes them.
"""

import string
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.sensitive_orders import READINGS, SWEEPS

DIGITS = string.digits + string.ascii_letters + '!#$%&()*+,'
"""Digits of a number below 72, in their order."""
WIDEST_GAP = 35
GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True, eq=False)
class Sweeps:
    """n sweeps of the table, each array (n,).

    ball: v, a permutation of 0..n-1; sense: d, +1 or -1; gap: table divisions, 0..35, from the last
    reading of the sweep before to the first of this one, in the sense of this one; shift: w, by
    table position.
    """

    ball: np.ndarray
    sense: np.ndarray
    gap: np.ndarray
    shift: np.ndarray

    def readings(self):
        """Return table positions and balls in measuring order, zero-based, two arrays (n*n,)."""
        n = self.ball.size
        step = np.concatenate([[0], (n - 1) * self.sense[:-1] + self.gap[1:] * self.sense[1:]])
        i = (np.cumsum(step)[:, None] + self.sense[:, None] * np.arange(n)) % n
        return i.ravel(), ((self.ball[:, None] + self.shift[i]) % n).ravel()

    def text(self):
        """Return v, the gaps (plus 36 where a sweep goes backwards) and w, as strings of digits."""
        turns = self.gap + (WIDEST_GAP + 1) * (self.sense < 0)
        return tuple(''.join(DIGITS[digit] for digit in row) for row in (self.ball, turns, self.shift))

    @staticmethod
    def from_text(ball, turns, shift):
        """Return the sweeps that `text` wrote."""
        ball, turns, shift = (np.array([DIGITS.index(letter) for letter in row])
                             for row in (ball, turns, shift))
        back, gap = np.divmod(turns, WIDEST_GAP + 1)
        return Sweeps(ball, 1 - 2 * back, gap, shift)

    @staticmethod
    def by_rule(n):
        """Return sweeps for any n: v in the order of m**2 times the golden section, modulo 1.

        Such a chirp has an even spectrum. The sense changes after 1, 2, 3, ... sweeps; the gaps,
        up to half a turn, follow no period either.
        """
        m = np.arange(n)
        ball = np.argsort(np.argsort(GOLDEN * m**2 % 1.0, kind='stable'), kind='stable')
        block = ((np.sqrt(8 * m + 1) - 1) / 2).astype(int)
        gap = (GOLDEN * m**3 % 1.0 * min(n // 2, WIDEST_GAP + 1)).astype(int)
        return Sweeps(ball, 1 - 2 * (block % 2), gap, two_way_shift(n))


def two_way_shift(n):
    """Return w (n,): one half of the table moves the CMM back by one, the other on by two."""
    return np.cumsum(np.where(np.arange(n) < n // 2, -2, 1)) % n


def reading_text(position, ball, approach):
    """Return readings, zero-based, n <= 10, as text: a letter and a digit each.

    The letter is the table position, a capital where the table last turned backwards; the digit
    is the ball.
    """
    return ''.join(string.ascii_letters[i + 26 * (sense < 0)] + str(j)
                   for i, j, sense in zip(position, ball, approach, strict=True))


def order_from_text(text):
    """Return position, ball and approach that `reading_text` wrote."""
    place = np.array([string.ascii_letters.index(letter) for letter in text[::2]])
    back, position = np.divmod(place, 26)
    return position, np.array([int(digit) for digit in text[1::2]]), 1 - 2 * back


def shortest_way(n, position):
    """Return the sense of the last table move, (N,), if the table goes the shortest way.

    position: (N,) zero-based. Half a turn goes backwards; before the first move the sense is +1.
    """
    step = (np.diff(position) + n // 2) % n - n // 2
    step = np.concatenate([[1], step])
    last = np.maximum.accumulate(np.where(step != 0, np.arange(step.size), 0))
    return np.where(step < 0, -1, 1)[last]


def sensitive(n, turning='', rng=None):  # noqa: ARG001, an order of measurement has three arguments
    """Return table positions and balls of the order, zero-based; always the same for one n."""
    if n in READINGS:
        position, ball, _ = order_from_text(READINGS[n])
        return position, ball
    return _sweeps(n).readings()


def sensitive_approach(n):
    """Return the sense of the last table move before each reading, (n*n,), +1 or -1."""
    if n in READINGS:
        return order_from_text(READINGS[n])[2]
    return shortest_way(n, _sweeps(n).readings()[0])


def _sweeps(n):
    return Sweeps.from_text(*SWEEPS[n]) if n in SWEEPS else Sweeps.by_rule(n)

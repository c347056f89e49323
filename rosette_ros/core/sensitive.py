# SPDX-License-Identifier: Apache-2.0
"""The order `sensitive`: small steps of the table, in which every effect of the library shows.

Sweep m takes the table once round, one division after the other, and the balls against it two at a
time, so that the CMM goes back one position with every reading:

    i = s_m + d_m r,   j = v_m - 2 i,   k = i + j = v_m - i,   r = 0..n-1   (all modulo n)

All n*n pairs are measured because v runs through 0..n-1. What an effect that changes slowly shows
depends on the sequences v (first ball), d (sense) and the gaps between sweeps alone; they were
found by `design` and are kept in sensitive_orders. Up to ten balls the whole order was.
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
    """n sweeps of the table: v (n,), a permutation of 0..n-1; sense (n,) +1 or -1; gap (n,).

    gap: table divisions, 0..35, from the last reading of the sweep before to the first of this one,
    in the sense of this one.
    """

    ball: np.ndarray
    sense: np.ndarray
    gap: np.ndarray
    turn: np.ndarray

    def readings(self):
        """Return table positions and balls in measuring order, zero-based, two arrays (n*n,)."""
        n = self.ball.size
        step = np.concatenate([[0], (n - 1) * self.sense[:-1] + self.gap[1:] * self.sense[1:]])
        i = (np.cumsum(step)[:, None] + self.sense[:, None] * np.arange(n)) % n
        return i.ravel(), ((self.ball[:, None] + self.turn[i]) % n).ravel()

    def text(self):
        """Return v and, for each sweep, its gap (plus 36 where it turns backwards), as digits."""
        turns = self.gap + (WIDEST_GAP + 1) * (self.sense < 0)
        return tuple(''.join(DIGITS[digit] for digit in row) for row in (self.ball, turns, self.turn))

    @staticmethod
    def from_text(ball, turns, turn):
        """Return the sweeps that `text` wrote."""
        ball, turns, turn = (np.array([DIGITS.index(letter) for letter in row])
                             for row in (ball, turns, turn))
        back, gap = np.divmod(turns, WIDEST_GAP + 1)
        return Sweeps(ball, 1 - 2 * back, gap, turn)

    @staticmethod
    def by_rule(n):
        """Return sweeps for any n: v in the order of m**2 times the golden section, modulo 1.

        Such a chirp has an even spectrum. The sense changes after 1, 2, 3, ... sweeps; the gaps,
        up to a quarter of a turn on average, follow no period either.
        """
        m = np.arange(n)
        ball = np.argsort(np.argsort(GOLDEN * m**2 % 1.0, kind='stable'), kind='stable')
        block = ((np.sqrt(8 * m + 1) - 1) / 2).astype(int)
        gap = (GOLDEN * m**3 % 1.0 * min(n // 2, WIDEST_GAP + 1)).astype(int)
        turn = np.cumsum(np.where(m < n // 2, -2, 1)) % n
        return Sweeps(ball, 1 - 2 * (block % 2), gap, turn)


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

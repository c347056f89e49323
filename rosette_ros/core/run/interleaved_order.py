# SPDX-License-Identifier: Apache-2.0
"""The order `interleaved`, once called `sensitive`: small steps of the table that show every effect of the library.

Each of n sweeps takes the table once round, one division after the other, forwards or backwards:

    sweep m, reading r:   i = s_m + d_m r,   j = v_m + w_i,   k = i + j   (modulo n, from 0)

Every pair is measured once because v runs through 0..n-1. The shifts w_i fall by two over one part of the table and
rise by one over the other, so that the CMM goes back one position a reading, or on by two, and the balls alternate.
What slow effects show depends on v, d, w and the gaps between the sweeps alone. For the numbers of balls in SWEEPS they
were found by benchmarks/design_orders.py, for those in READINGS reading by reading; for all others a rule makes them.
"""

import string
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.run.geometry import Ints

DIGITS = string.digits + string.ascii_letters + '!#$%&()*+,'
"""Digits of a number below 72, in their order."""
WIDEST_GAP = 35
_GOLDEN = (5**0.5 - 1) / 2

READINGS = {
    3: 'c1c2a0a2b0b1A1C0B2',
    4: 'b1b3d2d0a0C2C0C3C1B2A3A1A2D3D1B0',
    5: 'a3a0c2B4E2C0d4B2B0B3A2D3D1e4e1a1C3C1C4B1A4D0e3e0D2',
    6: 'c5B0F3b4c2A5d3B2F1c1e4A1E2E5D5C0C3d4A0F4d1E0E3b3A2F0a3b1b5A4E1f2D0F5C4d2',
    7: 'f0D3f4b3E5B0c5c2B6A1e6A4G0a5g6g3g1d5e2a3d2f1f6G5G2F2c1d0b1G4E1A0c4e3B2d6F5d4B5E4E0C3C6B4C0d1a6F3a2',
    8: (
        'a3b1c7d1e2f7g5h3a0b6c4d6e7f4g2h0h6a6b4c2d4e5f2g0g3F5E0D7C5B7A1H1E1D0C6B0A2H2G4F6B3c1d3e4f1g7h5a5H7G1F3E6D5C3B5'
        'A7H4G6F0E3D2C0B2A4'),
    9: (
        'a0I8H2G4F3E2D1C3B7I2H5G7F6E5D4C6B1A3A7b5c1d8e0f1g2h0i6c8d6e7f8g0h7i4a5b3c4d2e3f4g5h3i0a1b8H1G3F2E1D0C2B6A8I7E8'
        'D7C0B4A6I5H8G1F0h6i3a4b2c7d5e6f7g8h4i1a2b0c5d3e4f5g6'),
}
"""By number of balls: a letter (table position, capital: turned backwards) and a digit (ball) for each reading."""

SWEEPS = {
    11: ('072936458a1', '3CE301DEC0F', '97534567864'),
    12: ('52903a7b8641', 'C2C41A13C6GE', '6420a8645675'),
    13: ('058a372cb1964', '3DF411CFC10G3', '0b97562345642'),
    14: ('50b89c326174da', '3DD636D6DDA50A', 'ca86423456789a'),
    15: ('08a5d31724cb69e', '3D6C7506DBAB62B', '1eca86423456753'),
    16: ('5c08a31d9e7f642b', 'D4F3413HDE13F2II', 'db97531fdbcdef01'),
    24: ('b4jnea7mi01g8k56c3d9hfl2', '4D30DDLA21D30C080DDLAcC5', '0mkigeca8641nljhlmn01235'),
    36: (
        'avg2o0dx3q8ki1mrjt7wlpy9c5ezsh6nbf4u',
        '3CDeMB14bA7D0123ABA2A9A32DECh0A5DfE3',
        '97531zxvtvy0342ywusqomkigeca864uxyz0'),
    49: (
        'eDC3w5p8FmuhbL2g7tjGoKrMBfJlaH9z1cAkix4qyIsv0d6En',
        '0nDB0CKDPBA1lAhCiAC0120CCC0230B32B02B2ABAAdVA31Dc',
        'LM0123456789ab0LJHFDBzxvtrpnljhfdb97531MKIGECAyfq'),
    50: (
        '4iCwpHcG9j0IrMbuaf5tJ8gs2zBn17ovky3LADeNhFdq6ElmKx',
        'H2DBUC41120DGA20CAC2BgCC3m03HA9DD13IFZA8m0AoB0AB2B',
        'M0123456789abcdcdefge7531NLJHFECAyxvtrolijklmnopqy'),
    51: (
        'csmLE1KF7v4Dj3ewlxy9pkNonJCf2b5t8MqOBhHgGr0zi6AauId',
        'U033CC1SSC33L1mCC1S303cCCW227ABgCBAD15nC3GDfBBD31D0',
        'O01MNNO0123456789a86420NLJHFDBzxvtrpnljhfdb97531OMr'),
}
"""By number of balls: v, gaps (plus 36: backwards) and w of Sweeps, in digits."""


@dataclass(frozen=True, eq=False)
class Sweeps:
    """n sweeps of the table, each array (n,).

    ball: v, a permutation of 0..n-1; sense: d, +1 or -1; gap: table divisions, 0..35, from the last reading of the
    sweep before to the first of this one, in the sense of this one; shift: w, by table position.
    """

    ball: Ints
    sense: Ints
    gap: Ints
    shift: Ints

    def readings(self) -> tuple[Ints, Ints]:
        """Return table positions and balls in measuring order, zero-based, two arrays (n*n,)."""
        n = self.ball.size
        step = np.concatenate([[0], (n - 1) * self.sense[:-1] + self.gap[1:] * self.sense[1:]])
        i = (np.cumsum(step)[:, None] + self.sense[:, None] * np.arange(n)) % n
        return i.ravel(), ((self.ball[:, None] + self.shift[i]) % n).ravel()

    @staticmethod
    def from_text(*rows: str) -> 'Sweeps':
        """Return the sweeps of an entry of SWEEPS."""
        ball, turns, shift = (np.array([DIGITS.index(letter) for letter in row]) for row in rows)
        back, gap = np.divmod(turns, WIDEST_GAP + 1)
        return Sweeps(ball, 1 - 2 * back, gap, shift)

    @staticmethod
    def by_rule(n: int) -> 'Sweeps':
        """Return sweeps for any n: v in the order of m**2 times the golden section, modulo 1.

        Such a chirp has an even spectrum. The sense changes after 1, 2, 3, ... sweeps; the gaps, up to half a turn,
        follow no period either. One half of the table moves the CMM back by one, the other on by two.
        """
        m = np.arange(n)
        ball = np.argsort(np.argsort(_GOLDEN * m**2 % 1.0, kind='stable'), kind='stable')
        block = ((np.sqrt(8 * m + 1) - 1) / 2).astype(int)
        gap = (_GOLDEN * m**3 % 1.0 * min(n // 2, WIDEST_GAP + 1)).astype(int)
        shift = np.cumsum(np.where(m < n // 2, -2, 1)) % n
        return Sweeps(ball, 1 - 2 * (block % 2), gap, shift)


def order_from_text(text: str) -> tuple[Ints, Ints, Ints]:
    """Return position, ball and approach, zero-based, of an entry of READINGS."""
    place = np.array([string.ascii_letters.index(letter) for letter in text[::2]])
    back, position = np.divmod(place, 26)
    return position, np.array([int(digit) for digit in text[1::2]]), 1 - 2 * back


def shortest_way(n: int, position: Ints) -> Ints:
    """Return the sense of the last table move, (N,), if the table goes the shortest way.

    position: (N,) zero-based. Half a turn goes backwards; before the first move the sense is +1.
    """
    step = np.concatenate([[1], (np.diff(position) + n // 2) % n - n // 2])
    last = np.maximum.accumulate(np.where(step != 0, np.arange(step.size), 0))
    return np.where(step < 0, -1, 1)[last]


def sensitive(n: int) -> tuple[Ints, Ints, Ints]:
    """Return position, ball (zero-based) and sense of the last table move, (n*n,) each; always the same for one n."""
    if n in READINGS:
        return order_from_text(READINGS[n])
    sweeps = Sweeps.from_text(*SWEEPS[n]) if n in SWEEPS else Sweeps.by_rule(n)
    position, ball = sweeps.readings()
    return position, ball, shortest_way(n, position)

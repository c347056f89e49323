# SPDX-License-Identifier: Apache-2.0
"""The orders of measurement that design found; written by tools/design_orders.py."""

READINGS = {
    3: (
        'a2a0C1C2B1B0c0a1b2'
    ),
    6: (
        'c0e3a4b5A1A3d1d4F4a0c3F0e2e1a2a5b2b4c2E5f1f3f5B1D2B0c4F2D5D3e4d0E0C1B3C5'
    ),
}
"""By number of balls: a letter (table position, capital: turned backwards) and a digit (ball)
for each reading."""

SWEEPS = {
    12: (
        '2b574906a831',
        '460562442353',
    ),
}
"""By number of balls: first ball v of each sweep, and its gap, plus 4 where it turns backwards."""

# SPDX-License-Identifier: Apache-2.0
"""The orders of measurement that design found; written by tools/design_orders.py."""

READINGS = {
    4: (
        'b1b3d2d0a0C2C0C3C1B2A3A1A2D3D1B0'
    ),
    5: (
        'a3a0c2B4E2C0d4B2B0B3A2D3D1e4e1a1C3C1C4B1A4D0e3e0D2'
    ),
    6: (
        'c5B0F3b4c2A5d3B2F1c1e4A1E2E5D5C0C3d4A0F4d1E0E3b3A2F0a3b1b5A4E1f2D0F5C4d2'
    ),
    7: (
        'f0D3f4b3E5B0c5c2B6A1e6A4G0a5g6g3g1d5e2a3d2f1f6G5G2F2c1d0b1G4E1A0c4e3B2d6F5d4B5E4E0C3C6B4C0'
        'd1a6F3a2'
    ),
    8: (
        'a3b1c7d5e3f1g7h5D0e6f4g2h0a6b4c2A1H3G5F7E1D3C5B7H4G6F0E2D4C6B0A2d6e4f2g0h6a4b2c0B5A7H1G3F5'
        'E7D1C3G4h2a0b6c4d2e0f6C1B3A5H7G1F3E5D7'
    ),
}
"""By number of balls: a letter (table position, capital: turned backwards) and a digit (ball)
for each reading."""

SWEEPS = {
    12: (
        '52903a7b8641',
        'C2C41A13C6GE',
        '6420a8645675',
    ),
}
"""By number of balls: first ball v of each sweep, and its gap, plus 36 where it turns backwards; digits of sensitive.DIGITS."""

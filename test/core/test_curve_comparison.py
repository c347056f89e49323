# SPDX-License-Identifier: Apache-2.0
"""Curves of two sources: what a maker's table has of its own, an offset and a clamping, is no difference."""

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.curve_comparison import TableCurves, compare_curves

TURN = np.exp(1j * nominal_angles(12))
TABLE = np.column_stack([1e-6 * (TURN**2).real, 1e-6 * (TURN**2).imag, 2e-6 * (TURN**3).real,
                         3e-6 * (TURN**2).real, 3e-6 * (TURN**2).imag, 4e-6 * TURN.real])


def curves(values, u=1e-7, name='a', angle=None):
    """Return curves at twelve angles, all with one uncertainty."""
    return TableCurves(name, nominal_angles(len(values)) if angle is None else angle, values,
                       np.full_like(values, u))


def test_offset_and_clamping_are_no_difference():
    """Means of all curves, a plate off its centre by 5 µm + 2i µm and tilted: nothing is left of them."""
    other = TABLE + np.array([1e-5, -2e-5, 3e-5, 1e-5, 2e-5, 3e-5])
    for place, offset in ((0, 5e-6 + 2e-6j), (3, -7e-6 + 1e-6j)):
        other[:, place] += (offset * TURN).real
        other[:, place + 1] += (offset * TURN).imag
    made = compare_curves(curves(TABLE), curves(other, 2e-7, 'b'))
    assert np.abs(made.difference).max() < 1e-18
    assert made.u == pytest.approx(np.hypot(1e-7, 2e-7)) and made.within('crz') == 1.0
    assert (made.alone, made.interpolated) == ((), '')


def test_a_difference_of_the_tables_is_left():
    """Once-per-turn of crz belongs to the table, and a wave of ctx, too."""
    other = TABLE.copy()
    other[:, 5] += 1e-6 * TURN.imag
    other[:, 0] += 5e-7 * (TURN**4).real
    made = compare_curves(curves(TABLE), curves(other))
    assert -made.difference[:, 5] == pytest.approx(1e-6 * TURN.imag, abs=1e-18)
    assert -made.difference[:, 0] == pytest.approx(5e-7 * (TURN**4).real, abs=1e-18)
    assert made.within('ctz') == 1.0 and made.within('crz') < 0.5
    assert made.agreeing(False) == ('ctx', 'crz') and made.agreeing(None) == ()
    assert made.agreeing(True) == ('cty', 'ctz', 'crx', 'cry')
    assert compare_curves(curves(TABLE, np.nan), curves(other, np.nan)).agreeing(None) == CURVES


def test_a_finer_table_is_interpolated_where_the_coarser_one_has_its_angles():
    """Of a maker's table in steps of 1°, with two curves and no uncertainty."""
    fine = nominal_angles(360)
    maker = np.full((360, 6), np.nan)
    maker[:, 2], maker[:, 5] = 2e-6 * np.cos(3 * fine) + 1e-3, 4e-6 * np.cos(fine)
    made = compare_curves(curves(TABLE), TableCurves('maker', fine, maker, np.full((360, 6), np.nan)))
    assert made.compared == ('ctz', 'crz') and made.angle.size == 12 and made.interpolated == 'maker'
    assert np.abs(made.difference[:, [2, 5]]).max() < 1e-17
    assert made.u[:, 2] == pytest.approx(1e-7)


def test_one_of_a_pair_keeps_its_once_per_turn_part():
    """Without cty nothing tells how the body was clamped; it is said."""
    alone = np.where(np.arange(6) == 0, TABLE + TURN.real[:, None] * 1e-6, np.nan)
    made = compare_curves(curves(TABLE), curves(alone))
    assert made.alone == ('ctx',)
    assert -made.difference[:, 0] == pytest.approx(1e-6 * TURN.real, abs=1e-18)


def test_no_curve_in_common_is_refused():
    """Both are named with what they have."""
    with pytest.raises(InvalidData, match='expected curves that both have, found a with ctx, b with crz'):
        compare_curves(curves(np.where(np.arange(6) == 0, TABLE, np.nan)),
                       curves(np.where(np.arange(6) == 5, TABLE, np.nan), name='b'))

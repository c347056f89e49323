# SPDX-License-Identifier: Apache-2.0
"""Pictures of plans: every reading has its mark, plans stand where their uncertainty is."""

from dataclasses import replace

import numpy as np
import pytest
from figure_texts import faults

from rosette_ros.core.planning.plan_comparison import outlook, point_of
from rosette_ros.core.run.scheme import plan
from rosette_ros.presentation.plots.plan_plots import pairs_in_order, shares_of_plans, uncertainty_by_share


@pytest.fixture(scope='module')
def plans():
    """Return a complete plan and one there and back."""
    return [outlook(name, plan(6, name), 0.1825) for name in ('diagonal', 'there_and_back')]


def test_every_reading_has_its_mark(plans):
    """Numbered in the order of measuring, at its table position, by CMM position and by ball."""
    for one in plans:
        left, right = pairs_in_order(one.scheme, one.name).axes[:2]
        for panel, column in ((left, one.scheme.cmm_position), (right, one.scheme.ball)):
            marks = [marks for marks in panel.collections if marks.get_array() is not None]
            number = np.concatenate([marks.get_array() for marks in marks]).astype(int)
            place = np.concatenate([marks.get_offsets() for marks in marks])
            assert sorted(number) == list(range(1, one.scheme.ball.size + 1))
            assert np.abs(place[:, 0] - column[number - 1]).max() < 0.21
            assert np.array_equal(place[:, 1], one.scheme.table_position[number - 1])


def test_uncertainty_against_the_share_of_the_readings(plans):
    """A complete run has 1 at 1; the ideal is the root of n² / N; the best sets lie above it."""
    panel = uncertainty_by_share(plans[0].scheme.n, list(map(point_of, plans))).axes[0]
    sets, ideal, *points = panel.lines
    x, y = ideal.get_data()
    assert y == pytest.approx(x**-0.5)
    x, y = sets.get_data()
    assert np.all(y >= x**-0.5 - 1e-9) and (x[-1], y[-1]) == pytest.approx((1, 1))
    assert [point.get_data()[0][0] for point in points] == pytest.approx([1, 48 / 36])
    assert [point.get_data()[1][0] for point in points] == pytest.approx([one.expectation.penalty for one in plans])


def test_shares_of_effects_side_by_side(plans):
    """A column for each plan, a row for each effect, each with its number."""
    panel = shares_of_plans(plans).axes[0]
    assert [label.get_text() for label in panel.get_xticklabels()] == ['diagonal', 'there_and_back']
    texts = {(int(text.get_position()[1]), int(text.get_position()[0])): text.get_text() for text in panel.texts}
    assert len(texts) == 2 * len(plans[0].effects)
    row = [one.name for one in plans[0].effects].index('table_backlash')
    assert (texts[row, 0], texts[row, 1]) == ('0 %', f'{100 * plans[1].effects[row].typical_share:.0f} %')


@pytest.mark.parametrize(('count', 'name'), [(2, 'a plan with a long name that is cut'), (5, 'there_and_back'),
                                             (7, 'there_and_back'), (8, 'sensitive:50%')])
def test_names_of_plans_can_be_read(plans, count, name):
    """Side by side, or upright where they are long."""
    assert faults(shares_of_plans([replace(plans[0], name=name)] * count)) == []


def test_texts_of_places_and_pairs_can_be_read(plans):
    """Of the figures that show one order."""
    assert faults(uncertainty_by_share(plans[0].scheme.n, list(map(point_of, plans)))) == []
    assert faults(pairs_in_order(plans[0].scheme, 'diagonal')) == []

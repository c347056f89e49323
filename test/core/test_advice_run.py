# SPDX-License-Identifier: Apache-2.0
"""Advice from a run that was measured, and choices that a run does not offer."""

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.advice import VARIANTS, advise, advise_run, scheme_of
from rosette_ros.core.run.errors import InvalidModel, NotDeterminable
from rosette_ros.core.run.scheme import ORDERS
from rosette_ros.core.sight.visibility import visibility
from rosette_ros.words.advice_words import advice_words


@pytest.mark.parametrize('order', [name for name in ORDERS if name != 'random'])
def test_the_order_of_a_run_is_recognised(order):
    """By its sequence of table positions and balls."""
    assert scheme_of(synthetic_run(6, order)[0]).order == order


def test_an_unknown_order_is_taken_as_it_was_measured():
    """A shuffle has no name that could be found again."""
    run = synthetic_run(6, 'random', seed=5)[0]
    scheme = scheme_of(run)
    assert scheme.order == 'as measured'
    assert np.array_equal(scheme.ball, run.ball)


def test_the_run_itself_is_judged():
    """What its own times and senses show, not those of a plan."""
    run = synthetic_run(6, 'column', turning='alternate')[0]
    advice = advise_run(run)
    assert advice.present.label == 'column, turning alternate'
    seen = {entry.name: entry.share for entry in visibility(run)}
    assert {entry.name: entry.share for entry in advice.present.visibilities} == seen
    assert {order.order for order in advice.orders} == set(ORDERS) - {'row_there_and_back'}


def test_orders_are_compared_with_the_balls_of_the_run():
    """Of a plate with fewer balls than table positions no other balls can be measured; after a break they can."""
    run = synthetic_run(8, 'column')[0]
    few = run.take(np.isin(run.ball, [1, 2, 4, 7]))
    advice = advise_run(few, ('frame_drift',))
    assert advice.balls == (1, 2, 4, 7)
    assert {order.order: order.duration for order in advice.orders}['row'] < 0.55 * advise(
        8, wanted=('frame_drift',)).present.duration
    assert advise_run(run.take(np.arange(34)), ('frame_drift',)).balls == ()


def test_the_best_order_is_the_cheapest_of_the_good_ones():
    """Within a tenth of the best worst share, by travel."""
    advice = advise(6, wanted=('table_backlash', 'frame_drift'))
    assert len(advice.orders) == len(VARIANTS)
    top = max(order.worst for order in advice.orders)
    assert advice.best.worst >= 0.9 * top
    assert all(advice.best.travel_time <= order.travel_time for order in advice.orders if order.worst >= 0.9 * top)


def test_visibility_of_some_effects_is_that_of_all():
    """Names only choose."""
    run = synthetic_run(6, 'diagonal')[0]
    every = {entry.name: entry for entry in visibility(run)}
    some = visibility(run, names=('table_backlash', 'plate_warp'))
    assert [entry.name for entry in some] == ['table_backlash', 'plate_warp']
    assert all(np.array_equal(entry.bias, every[entry.name].bias) for entry in some)


@pytest.mark.parametrize(('name', 'fixed', 'words'), [
    ('frame_drift', {'axes': 'xx'}, "axes: expected one of x, xyz, y, z, found 'xx'"),
    ('outlier', {'reading': 99}, 'reading: expected one of 1, 2, 3, ..., 36, found 99'),
    ('plate_expansion', {'driver': 'temperature'}, 'driver: expected one of time, found'),
])
def test_a_choice_that_the_run_does_not_offer(name, fixed, words):
    """Is refused before it is fitted; what can be chosen is listed."""
    run = synthetic_run(6, 'random', seed=1)[0]
    with pytest.raises(InvalidModel, match=words):
        choose_settings(run, Model().with_effect(name, fixed))


def test_a_ball_that_was_not_measured_is_not_judged():
    """A model may name a ball that the run does not have, or not yet."""
    run = synthetic_run(8, 'column')[0]
    with pytest.raises(NotDeterminable, match='ball_slip cannot be judged: ball 3 was not measured'):
        choose_settings(run.take(run.ball != 3), Model().with_effect('ball_slip', {'ball': 3}))


@pytest.mark.parametrize(('name', 'fixed', 'words'), [
    ('frame_warmup', {'tau': 'long'}, r"tau: expected a positive number \(s\), found 'long'"),
    ('frame_warmup', {'tau': -1.0}, 'tau: expected a positive number'),
    ('frame_step', {'t0': float('nan')}, 't0: expected a number'),
    ('frame_step', {'t0': True}, 't0: expected a number'),
    ('ball_slip', {'ball': [1]}, 'ball: expected a number or a word'),
])
def test_a_value_that_can_never_be(name, fixed, words):
    """Is refused by the model itself."""
    with pytest.raises(InvalidModel, match=words):
        Model().with_effect(name, fixed)


def test_no_order_is_advised_that_is_no_better():
    """For 8 balls there and back nothing shows the weakest effect better; for a row many orders do."""
    best = advise(8, 'there_and_back')
    assert best.best is best.present
    assert ' shows ' not in advice_words(best)
    row = advise(8, 'row')
    assert row.best is not row.present
    assert f'Order {row.best.label} shows ' in advice_words(row)

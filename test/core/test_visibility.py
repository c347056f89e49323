# SPDX-License-Identifier: Apache-2.0
"""What each order shows: golden shares of an independent check, bias, advice."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import orth, subspace_angles
from synthetic import synthetic_run

from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.planning.advice import advise, planned_run
from rosette_ros.core.run.scheme import places_in_use, plan
from rosette_ros.core.sight.limits import DETECTABLE, are_alike
from rosette_ros.core.sight.visibility import visibility
from rosette_ros.words.advice_words import advice_words
from rosette_ros.words.motion_words import titles

# Shares for n = 12 from an independent check: row, diagonal, column, random. Those of a random order
# depend on its seed.
GOLDEN = {
    ('frame_drift', (('axes', 'xyz'),)): (0.00, 0.06, 0.75, 0.86),
    ('table_zero_drift', ()): (0.00, 0.00, 0.00, 0.43),
    ('plate_expansion', (('driver', 'time'),)): (0.50, 0.00, 0.04, 0.44),
    ('asynchronous_motion', (('motion', 'radial'), ('nu', 0.43))): (0.00, 0.68, 0.90, 0.84),
    ('table_backlash', ()): (0.00, 0.00, 0.00, 0.00),
    ('plate_creep', ()): (0.04, 0.46, 0.00, 0.45),
}


def share(run, name, setting):
    """Return the visible share over all columns, each axis freed of its mean."""
    columns = np.moveaxis(EFFECTS[name].columns(run, Setting(setting)), -1, 0)
    columns = columns - columns.mean(axis=1, keepdims=True)
    visible = BaseSpace(run, run.radius).residual(columns)
    return np.linalg.norm(visible) / max(np.linalg.norm(columns), 1e-300)


@pytest.mark.parametrize('key', GOLDEN, ids=lambda key: key[0])
@pytest.mark.parametrize('place, order', list(enumerate(['row', 'diagonal', 'column', 'random'])))
def test_golden_shares(key, place, order):
    """The shares are those of the independent check, to its two decimals."""
    run, *_ = synthetic_run(12, order, 1)
    tolerance = 0.06 if order == 'random' else 0.005
    assert abs(share(run, key[0], key[1]) - GOLDEN[key][place]) <= tolerance + 1e-9


def test_backlash_shows_when_the_table_turns_back():
    """Every second inner loop backwards shows a quarter of the backlash in the diagonal order."""
    run, *_ = synthetic_run(12, 'diagonal', turning='alternate')
    assert abs(share(run, 'table_backlash', ()) - 0.25) < 0.005


@pytest.mark.parametrize('name', ['table_zero_drift', 'frame_drift', 'frame_drift_curved'])
@pytest.mark.parametrize('order', ['row', 'diagonal', 'random'])
def test_bias_is_what_the_fit_shows(name, order):
    """The stated bias is the largest change of the curves, along whichever axis the effect is added to a run."""
    run, *_ = synthetic_run(6, order, 2)
    entry = next(v for v in visibility(run) if v.name == name)
    changes = []
    for setting in EFFECTS[name].settings(run):
        for column in np.moveaxis(EFFECTS[name].columns(run, setting), -1, 0):
            column = column - column.mean(axis=0)
            size = np.sqrt(np.mean(np.sum(column**2, axis=1)))
            moved = run.replace(centre=run.centre + 1e-6 * column / size)
            changes.append(np.abs(fit(moved).error_motions.values - fit(run).error_motions.values).max(axis=0))
    assert np.allclose(np.max(changes, axis=0), 1e-6 * entry.bias, rtol=1e-3, atol=1e-11)


def test_row_order_puts_drift_into_the_curves():
    """In row order 1 um of drift puts about 0.9 um into the curves; diagonally it does no harm."""
    worst = {}
    for order in ('row', 'diagonal'):
        run, *_ = synthetic_run(12, order)
        drift = (run.time / run.time[-1])[:, None] * np.array([0, 0, 1e-6])
        moved = run.replace(centre=run.centre + drift)
        change = fit(moved).error_motions.values - fit(run).error_motions.values
        worst[order] = np.ptp(change[:, 2])
    assert 0.85e-6 < worst['row'] < 0.95e-6
    assert worst['diagonal'] < 0.1e-6


def test_detectable_size_shrinks_with_sigma():
    """Half the noise shows half the effect; what is hidden can never be detected."""
    run, *_ = synthetic_run(8, 'random', 1)
    fine, coarse = visibility(run, 0.5e-7), visibility(run, 1e-7)
    for one, other in zip(fine, coarse):
        if other.hidden or other.reason:
            continue
        assert np.isclose(one.detectable * 2, other.detectable)
    backlash = next(v for v in coarse if v.name == 'table_backlash')
    assert backlash.hidden and backlash.detectable == np.inf


def test_balls_that_are_not_in_use_hide_no_effect():
    """The typical share is that of a ball that is measured: it falls slowly with the number of balls."""
    names = ('ball_slip', 'ball_creep', 'ball_rattle', 'ball_machine_offset', 'ball_form')
    full, part = (visibility(planned_run(plan(12, 'random', 1, balls=places_in_use(balls, 12)), 0.1825), names=names)
                  for balls in ('', '6'))
    assert [entry.name for entry in part] == list(names)
    assert all(0.75 * more.typical_share < less.typical_share < more.typical_share for more, less in zip(full, part))


def test_advice_recommends_an_order_that_shows_more():
    """From the diagonal order, advice goes to one that shows what is hidden there."""
    advice = advise(6, 'diagonal')
    assert 'table_backlash' in advice.weak and 'table_zero_drift' in advice.weak
    assert advice.best.worst > advice.present.worst + 0.1
    assert advice_words(advice).startswith('Order diagonal cannot show ')
    assert ' more effects in ' in advice_words(advice)


@pytest.mark.parametrize('order', ['row', 'diagonal', 'column'])
def test_one_meaning_of_not_observable(order):
    """What the advice says that an order does not show are the effects that no setting of theirs shows."""
    made = advise(8, order)
    hidden = [one for one in made.present.visibilities if one.hidden]
    bias = [-max(one.bias * np.repeat([1.0, made.present.run.radius], 3)) for one in hidden]
    ranked = titles(hidden[place].name for place in np.argsort(np.round(bias, 6), stable=True))
    assert f' cannot show {ranked}.' in advice_words(made)


def test_planned_run_takes_its_time():
    """A planned run has rising times and the travel of its scheme."""
    run = planned_run(plan(6, 'random', 1), 0.1825)
    assert np.all(np.diff(run.time) > 0) and run.time[0] == 0
    assert np.all(np.diff(run.table_travel) >= 0)


def test_an_advice_is_the_same_on_every_processor():
    """What is hidden leaves nothing but rounding, which differs: its order of words came from that."""
    code = ('from rosette_ros.core.planning.advice import advise\n'
            'from rosette_ros.words.advice_words import advice_words\n'
            "print([advice_words(advise(5, order)) for order in ('row', 'diagonal')])")
    said = {subprocess.run([sys.executable, '-c', code], env={**os.environ, 'OPENBLAS_CORETYPE': kernel}, check=True,
                           capture_output=True).stdout for kernel in ('Nehalem', 'Sandybridge')}
    assert len(said) == 1


def test_evidence_counts_as_that_of_effects_that_are_just_found():
    """6 sigma are worth 18; ln 20 of that, 2.996, is wanted, or the same part of more; of two effects, of 36."""
    assert are_alike(10, 7.1) and not are_alike(10, 6.9)
    assert are_alike(18, 15.1) and not are_alike(18, 14.9)
    assert are_alike(180, 150.1) and not are_alike(180, 149.9)
    assert are_alike(36, 33.1, effects=2) and not are_alike(36, 32.9, effects=2)


@pytest.mark.parametrize('order', ['diagonal', 'random'])
def test_what_cannot_be_told_apart_would_be_listed_beside(order):
    """The best direction of an effect, of the size that is found, against what another one leaves of it: the expected
    log Bayes factor is half its square sum over sigma^2, and ln 20 where the other one keeps 5 %."""
    run, *_ = synthetic_run(6, order, 2)
    space, shown = BaseSpace(run, run.radius), [one for one in visibility(run) if one.share and not one.hidden]
    columns = {one.name: np.moveaxis(EFFECTS[one.name].columns(run, one.setting), -1, 0) for one in shown}
    rows = {}
    for name, some in columns.items():
        some = some - some.mean(axis=1, keepdims=True)
        moving = some[np.linalg.norm(some, axis=(1, 2)) > 0]
        unit = moving / np.linalg.norm(moving, axis=(1, 2), keepdims=True)
        rows[name] = space.residual(unit).reshape(len(unit), -1).T
    for one in shown:
        own = orth(rows[one.name], 1e-3)
        expected = {name: DETECTABLE**2 * np.sin(subspace_angles(own, orth(other, 1e-3)).min())**2 / 2
                    for name, other in rows.items() if name != one.name}
        assert set(one.alike) == {name for name, log_bf in expected.items() if log_bf < np.log(20)}
    assert any(one.alike for one in shown) and not all(len(one.alike) == len(shown) - 1 for one in shown)

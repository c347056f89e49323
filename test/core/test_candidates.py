# SPDX-License-Identifier: Apache-2.0
"""What the search works with is what plain projection and decomposition give, effect by effect."""

import numpy as np
import pytest

from rosette_ros.core.axes import axis_rotation
from rosette_ros.core.diagnosis.candidates import RIDGE, families, gains, products_of, whiten
from rosette_ros.core.diagnosis.projection import FEW, Projection
from rosette_ros.core.diagnosis.scores import grouped
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free_forms import FREE_FORMS
from rosette_ros.core.effects.library import EFFECTS, OF_ANY_TABLE
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.least_squares import JointSpace
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.records import Run
from rosette_ros.core.scheme import plan

EVERY = (*EFFECTS.values(), *FREE_FORMS.values())
RUN = planned_run(plan(7, 'random', 3, 'alternate'), 0.18)
RUN = RUN.replace(table_angle=RUN.table_angle + 1e-4 * np.sin(RUN.time))
PART = planned_run(plan(6, 'random', 3), 0.18)


def spaces():
    """Return base spaces of a complete and an incomplete run, and one with an effect in it."""
    keep = np.arange(PART.size) % 17 != 3
    part = Run(
        6, 0.18, *(value[keep] for value in (PART.table_position, PART.ball, PART.centre)),
        time=PART.time[keep], temperature=PART.temperature[keep], approach=PART.approach[keep])
    whole = BaseSpace(RUN, 0.18)
    columns = np.moveaxis(EFFECTS['frame_drift'].columns(RUN, Setting(axes='xyz')), -1, 0)
    return {'complete': (RUN, whole), 'incomplete': (part, BaseSpace(part, 0.18)),
            'with an effect': (RUN, JointSpace(whole, columns, np.zeros((0, RUN.size, 3))))}


SPACES = spaces()


@pytest.mark.parametrize('name', SPACES)
def test_the_basis_spans_what_the_projection_takes_away(name):
    """Q is orthonormal, has the rank of the space, and 1 - Q'Q is the projection."""
    run, space = SPACES[name]
    rows = space.basis.rows
    assert len(rows) == space.rank + (space.space.rank if name == 'with an effect' else 0)
    assert np.abs(rows @ rows.T - np.eye(len(rows))).max() < 1e-12
    some = np.random.default_rng(0).standard_normal((5, run.size, 3))
    flat = some.reshape(5, -1)
    assert np.abs(flat - (flat @ rows.T) @ rows - space.residual(some).reshape(5, -1)).max() < 1e-12


@pytest.mark.parametrize('count', [3, FEW + 1])
def test_a_projection_is_that_of_its_space_however_many_rows(count):
    """Few rows in double, many in single precision."""
    project = Projection(SPACES['complete'][1], RUN.size)
    rows = np.random.default_rng(1).standard_normal((count, RUN.size, 3))
    wanted = SPACES['complete'][1].residual(rows)
    assert np.abs(project(rows) - wanted).max() < (1e-12 if count < FEW else 1e-5)


@pytest.mark.parametrize('name', SPACES)
@pytest.mark.parametrize('effect', EVERY, ids=lambda effect: effect.name)
def test_families_give_the_gains_of_whitened_columns(effect, name):
    """The fall of the square sum by each block, alone and beside members, to single precision."""
    run, space = SPACES[name]
    if effect.needs_tilt:
        run = run.replace(rotation=axis_rotation([1, 0, 0]))
    else:
        assert not effect.unavailable(RUN), 'the run above has all that an effect can depend on'
    if effect.unavailable(run):
        pytest.skip(effect.unavailable(run))
    project = Projection(space, run.size)
    rows = space.residual(np.random.default_rng(2).standard_normal((4, run.size, 3))).reshape(4, -1)
    members = np.linalg.qr(rows[1:].T)[0].T
    stacked = np.concatenate([rows[:1] - (rows[:1] @ members.T) @ members, members])
    made = families(run, (effect,), project, keep_hidden=True)
    assert sum(len(family.settings) for family in made) == len(effect.settings(run))
    for family, products in products_of(made, stacked, project):
        for block in {0, len(family.settings) // 2, len(family.settings) - 1}:
            columns = np.moveaxis(effect.columns(run, family.settings[block]), -1, 0)
            plain, rank, share = whiten(columns[None].astype(float), project)
            assert family.ranks[block] == rank[0]
            assert family.shares[block] == pytest.approx(share[0], abs=2e-3)
            y, x = plain[0] @ stacked[0], plain[0] @ members.T
            alone = gains(products[block:block + 1, :, :1])[0, 0]
            assert alone == pytest.approx(y @ y, rel=1e-2, abs=1e-3)
            beside = gains(products[block:block + 1, :, :1], products[block:block + 1, :, 1:])[0, 0]
            gram = np.eye(len(y)) * (1 + RIDGE) - x @ x.T
            assert beside == pytest.approx(y @ np.linalg.solve(gram, y), rel=2e-2, abs=2e-3)


def test_groups_give_the_best_block_of_each_family():
    """By the score written out for every block by itself, alone and of several residuals at once.

    It grows with a gain that is more than one of noise, k rss / dof."""
    run, space = SPACES['complete']
    effects = [effect for effect in EVERY if not effect.unavailable(run)]
    made = families(run, effects, Projection(space, run.size))
    groups, rng, dof = grouped(made), np.random.default_rng(4), 900
    assert sorted(id(one) for group in groups for one in group.families) == sorted(map(id, made))
    for group in groups:
        ranks = np.concatenate([one.ranks for one in group.families])[:, None]
        gain = 1.3 * ranks + rng.uniform(0, 300, (len(ranks), 2))
        rss, start, every = np.array([900.0, 1100.0]), 0, []
        score, blocks = group.best(gain[:, 0], 900.0, dof)
        for place, family in enumerate(group.families):
            scores = np.full((len(family.ranks), 2), -np.inf)
            for block in np.flatnonzero(family.ranks):
                k, fall = family.ranks[block], gain[start + block]
                energy = fall * dof / (rss - fall)
                spent = np.where(energy > k, k * (1 + np.log(energy / k)), energy)
                chances = 2 * np.log(family.chances * OF_ANY_TABLE) + 10 * (family.name in FREE_FORMS)
                scores[block] = dof * np.log(rss / (rss - fall)) - spent - chances
            assert score[place] == pytest.approx(scores[:, 0].max(), rel=1e-12)
            assert scores[blocks[place], 0] == pytest.approx(scores[:, 0].max(), rel=1e-12)
            every.append(scores.max(axis=0))
            start += len(family.ranks)
        assert group.best_of_all(gain, rss, dof) == pytest.approx(np.max(every, axis=0), rel=1e-12)


@pytest.mark.parametrize(('q', 'k'), [(1, 3), (3, 1), (5, 2), (2, 5)])
def test_gains_are_those_of_the_joint_decomposition(q, k):
    """Few members or few columns: the same number by either formula."""
    rng = np.random.default_rng(q)
    rows = np.linalg.qr(rng.standard_normal((20, q)))[0].T
    members = np.linalg.qr(rng.standard_normal((20, k)))[0].T
    residual = rng.standard_normal(20)
    residual -= (members @ residual) @ members
    y, x = rows @ residual, rows @ members.T
    both = np.linalg.qr(np.concatenate([members, rows]).T)[0].T
    wanted = np.sum((both @ residual)**2)
    assert gains(y[None, :, None], x[None])[0, 0] == pytest.approx(wanted, rel=0.05)

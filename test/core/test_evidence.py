# SPDX-License-Identifier: Apache-2.0
"""The log evidence of hypotheses: against dense normal densities, and what it says of runs whose truth is known."""

import functools
import pickle

import numpy as np
import pytest
import scipy  # which loads its parts where they are used

from rosette_ros.core.diagnosis.log_evidence import SIZES, Evidence, State, allowed, log_mean
from rosette_ros.core.diagnosis.noise_kinds import Beside, NoiseKinds
from rosette_ros.core.diagnosis.posterior import Posterior
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import FREE, OF, PARTS, motions, variables
from rosette_ros.core.model.base_space import BaseSpace
from rosette_ros.core.model.model import BASE_TERMS
from rosette_ros.core.model.noise import Whitening
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.sight.bank import Bank, CauseFamily, CoordinateSpace, columns_of, families_of
from rosette_ros.core.sight.priors import log_found, with_priors
from rosette_ros.core.sight.visibility import visible_share

RADIUS = 0.18
NOISES = {'white': (np.ones(3), 0.0, np.zeros(3)), 'unequal': (np.array([1.0, 1.0, 2.0]), 0.0, np.zeros(3)),
          'wandering': (np.ones(3), 0.8, np.array([0.5, 0.5, 1.0]))}


def run_of(n, order='sensitive', missing=0):
    """Return a planned run without some of its readings."""
    run = planned_run(plan(n, order), RADIUS)
    return run.take(np.arange(run.size)[missing:]) if missing else run


def space_of(run, noise='white'):
    """Return the base model of a run under a noise."""
    space = BaseSpace(run, RADIUS, whitening=Whitening(run.size, *NOISES[noise]))
    return CoordinateSpace(space, np.zeros((0, run.size, 3)))


def freed(space):
    """Return what a model leaves of each coordinate alone, (3 N, 3 N)."""
    size = space.whitening.size
    return space.free(np.eye(3 * size).reshape(-1, size, 3)).reshape(3 * size, -1)


@functools.cache
def evidence_of(run, seed=0, noise='white'):
    """Return the Evidence of a run of noise."""
    space = space_of(run, noise)
    white = np.random.default_rng(seed).standard_normal((1, run.size, 3))
    return Evidence(run, Bank(run, with_priors(families_of(run))), space, space.free(white)[0],
                    3 * run.size - space.space.rank)


@pytest.mark.parametrize(('noise', 'missing'), [('white', 0), ('unequal', 3), ('wandering', 0)])
def test_the_bank_is_what_dense_columns_are_freed_of_the_model(noise, missing):
    """Its products with readings are those of columns that are written out, at every setting of some families."""
    evidence = evidence_of(run_of(6, missing=missing), noise=noise)
    products = evidence.bank.products(evidence.y[None], evidence.space.whitening)
    names = ('frame_step', 'asynchronous_motion', 'ball_slip', 'outlier', 'ball_form', 'time | frame',
             'time × ball | frame')
    seen = set()
    for key, group in evidence.bank.groups.items():
        for block in range(0, len(group.family), 7):
            family = evidence.bank.families[group.family[block]]
            if family.name in names:
                seen.add(family.name)
                made = evidence.member(family, family.settings[group.setting[block]], 0.0)
                got, wanted = products[key][block, :, 0], made.rows @ evidence.y
                assert np.linalg.norm(got) == pytest.approx(np.linalg.norm(wanted), abs=2e-4), family.name
    assert len(seen) == len(names)


def test_columns_of_a_named_effect_are_orthonormal_in_the_readings():
    """Each axis freed of its mean; those of a course with prior variances, free ones too, have these sizes."""
    run = run_of(6)
    for family in families_of(run):
        columns = columns_of(family, run, family.settings[-1])
        assert len(columns), family.name
        flat = (columns - columns.mean(axis=1, keepdims=True)).reshape(len(columns), -1)
        square = np.sum(flat**2, axis=1)
        if family.is_free or np.ptp(family.effect.variances(run, family.settings[-1])):
            assert square.max() == pytest.approx(1, rel=1e-5)
        else:
            np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=2e-5)


def test_the_evidence_is_a_normal_density():
    """Of two members: the likelihood at their sizes is the density with sigma summed over, less that of nothing."""
    evidence = evidence_of(run_of(6))
    families = {family.name: family for family in evidence.bank.families}
    members = [evidence.member(families[name], families[name].settings[0], 0.0)
               for name in ('frame_drift', 'plate_warp')]
    state = State(evidence, members)
    basis = np.linalg.svd(freed(evidence.space))[0][:, :evidence.dof].T
    covariance = np.eye(evidence.dof) + sum(
        one.size**2 * (basis @ one.rows.T) @ (basis @ one.rows.T).T for one in state.members)

    def log_density(matrix):
        """Return the log density up to a constant where the variance is summed over with the density 1/sigma."""
        y = basis @ evidence.y
        return -0.5 * np.linalg.slogdet(matrix)[1] - evidence.dof / 2 * np.log(y @ np.linalg.solve(matrix, y))

    assert state.likelihood == pytest.approx(log_density(covariance) - log_density(np.eye(evidence.dof)), abs=1e-8)
    assert all(one.size in SIZES for one in state.members)


def test_an_offer_is_worth_what_the_member_is_that_it_makes():
    """The gain of adding a family on the grid is the log evidence of the member, summed over every other size."""
    evidence = evidence_of(run_of(6))
    offers, limited = evidence.empty.offers()[:30], 0
    for offer in offers:
        member = evidence.member(offer.family, offer.setting, offer.volume)
        line = allowed(evidence.empty.line(member.rows)[::2], member.most)
        worth = float(log_mean(line)) + offer.volume + offer.family.log_prior
        assert offer.gain == pytest.approx(worth, abs=0.02), member.name
        limited += member.most < SIZES[-1]
    assert 0 < limited < len(offers), 'sizes are limited by physics, and are not'


@pytest.mark.parametrize('noise', NOISES)
def test_the_likelihood_of_a_noise_is_that_of_its_covariance(noise):
    """REML by normal equations against a dense normal density of the contrasts, relative to white noise."""
    run = run_of(6)
    y = np.random.default_rng(1).standard_normal((run.size, 3))
    none = np.zeros((0, run.size, 3))
    beside = Beside(run, RADIUS, BASE_TERMS, y, none, none, np.zeros(0))
    found = {name: beside.under(Whitening(run.size, *NOISES[name])) for name in ('white', noise)}
    basis = np.linalg.svd(freed(space_of(run)))[0][:, :beside.dof].T
    values = []
    for name in ('white', noise):
        whitening = Whitening(run.size, *NOISES[name])
        half = whitening.inverse(np.eye(3 * run.size).reshape(-1, run.size, 3)).reshape(3 * run.size, -1)
        part = basis @ half.T @ half @ basis.T
        z = basis @ y.reshape(-1)
        scale = z @ np.linalg.solve(part, z) / beside.dof
        values.append(scipy.stats.multivariate_normal(np.zeros(beside.dof), scale * part).logpdf(z))
    assert found[noise].joined[0] - found['white'].joined[0] == pytest.approx(values[1] - values[0], abs=1e-6)


def test_the_kind_of_noise_is_found():
    """Scatter that differs by ball, heavy tails, a wander: the kind that was drawn is the best one."""
    run, rng = run_of(8), np.random.default_rng(3)
    white, none = rng.standard_normal((run.size, 3)), np.zeros((0, run.size, 3))
    walk = np.cumsum(rng.standard_normal((run.size, 3)), axis=0)
    drawn = {'ball': white * 4.0**((run.ball % 3) - 1)[:, None],
             'reading': white / np.sqrt(rng.chisquare(2, (run.size, 1)) / 2), 'wander': walk + white, '': white}
    for kind, y in drawn.items():
        beside = Beside(run, RADIUS, BASE_TERMS, y, none, none, np.zeros(0))
        assert kind in NoiseKinds(beside).found()[0].kinds or not kind, kind
    assert NoiseKinds(beside).found()[0].kinds == ()


def test_a_wander_beside_motions_has_the_prior_of_one():
    """Its log evidence falls by what a kind of noise has more; that of scatter stays."""
    run, rng = run_of(6), np.random.default_rng(3)
    y = np.cumsum(rng.standard_normal((run.size, 3)), axis=0) + rng.standard_normal((run.size, 3))
    beside = Beside(run, RADIUS, BASE_TERMS, y, np.zeros((0, run.size, 3)), np.zeros((0, run.size, 3)), np.zeros(0))
    alone, among = NoiseKinds(beside), NoiseKinds(beside, of_motion=-7.5)
    before, after = ({one.kinds: one.log_evidence for one in kinds.found()} for kinds in (alone, among))
    assert after['wander',] - before['wander',] == pytest.approx(-7.5 - alone._each)
    assert all(after[kinds] == before[kinds] for kinds in after if 'wander' not in kinds)


@pytest.mark.parametrize('noise', ['white', 'unequal'])
def test_square_sums_of_free_courses_are_those_that_are_left(noise):
    """Without the products of their columns: the diagonals."""
    evidence = evidence_of(run_of(6), noise=noise)
    left = evidence.bank.left(evidence.space, of_free=True)
    for key, square in evidence.bank.squares_left(evidence.space).items():
        assert square == pytest.approx(np.einsum('bqq->bq', left[key]), abs=1e-5)


def test_what_may_join_a_hypothesis_joins_it_as_it_is():
    """The best member of a family is a Member: in a State it has the same rows and its likeliest size there, and keeps
    its own outside; at another setting it is what the evidence makes of that."""
    evidence = evidence_of(run_of(6))
    offer = next(one for one in evidence.empty.offers(is_open=False) if len(one.family.settings) > 1)
    joined, = State(evidence, [offer]).members
    assert joined.rows is offer.rows and joined.place == offer.place and (joined.size, offer.size) == (
        SIZES[np.argmax(allowed(evidence.empty.line(offer.rows), offer.most))], 16.0)
    other = offer.at(next(one for one in offer.family.settings if one != offer.setting))
    assert (other.gain, other.volume) == (0.0, offer.volume)
    np.testing.assert_array_equal(other.rows, evidence.member(*other.place).rows)


def test_sensitivity_is_that_of_the_order():
    """Of a member, of its family at its best setting, and of an effect on a run, by whatever way it is asked."""
    run = run_of(6, 'row')
    evidence = evidence_of(run)
    for name in ('frame_drift', 'ball_slip', 'axis_tilt_drift', 'outlier'):
        family = next(one for one in evidence.bank.families if one.name == name)
        every = [evidence.member(family, setting).sensitivity for setting in family.settings]
        assert evidence.sensitivities[name] == pytest.approx(max(every), abs=1e-3)
        assert visible_share(run, name).share == pytest.approx(max(every), abs=1e-3), name


def test_probabilities_count_every_hypothesis():
    """They add up to one; two names in the same place cannot be told apart; the rest is as likely as its sum."""
    evidence = {((), ()): 0.0, (('frame_step',), ()): 5.0, (('frame_drift',), ()): 4.5, (('time',), ('wander',)): 2.0}
    posterior = Posterior({key: (value, ()) for key, value in evidence.items()})
    assert sum(posterior.p.values()) == pytest.approx(1)
    claim, = posterior.named.values()
    assert (claim.name, claim.look_alikes) == ('frame_step', ('frame_drift',))
    assert claim.together == pytest.approx(claim.is_there + posterior.of('frame_drift'))
    assert posterior.unnamed == pytest.approx(np.exp(2) / sum(np.exp(list(evidence.values()))))
    assert posterior.is_open  # a step or a drift
    clear = {((), ()): (0.0, ()), (('frame_step',), ()): (5.0, ())}
    assert not Posterior(clear).is_open


def test_free_courses_depend_on_what_changes():
    """Variables that stand still in an order are none; a setting has a column for each function and direction."""
    run = run_of(6, 'row')
    names = {one.name for one in variables(run)}
    families = [name for name, _ in FREE.families(run_of(6))]
    assert len(families) == len(set(families)), 'each set of variables is one family'
    assert 'table sense' not in names and {'time', 'ball', 'temperature'} <= names
    for _, settings in FREE.families(run):
        setting = settings[-1]
        count = len(FREE.course(run, setting)[1]) * len(motions(run)[setting['along']])
        assert FREE.columns(run, setting).shape == (run.size, 3, count) == (run.size, 3, FREE.width(run, setting))


def test_variables_of_the_same_values_are_one():
    """Where the table moves before every reading, the time since it did and the pause are the same."""
    run = run_of(6, 'column')
    run = run.replace(time=np.cumsum(np.random.default_rng(1).uniform(20, 60, run.size)))
    at = {one.name: one for one in variables(run)}
    np.testing.assert_array_equal(at['pause'].functions, at['time since move'].functions)
    driven = {name for _, settings in FREE.families(run) for one in settings for name in FREE.driven_by(one)}
    assert 'time since move' in driven and 'pause' not in driven


def test_each_part_of_the_cell_is_as_likely_to_move():
    """By any of its bodies, with each variable."""
    odds = dict.fromkeys(PARTS.values(), 0.0)
    for family in with_priors(families_of(run_of(6))):
        variable, _, body = family.name.partition(OF)
        if variable == 'time' and body:
            odds[PARTS[body]] += np.exp(family.log_prior)
    assert len(odds) == 4 and [*odds.values()] == pytest.approx([odds['frame']] * 4)


def test_a_setting_that_moves_nothing_is_worth_nothing():
    """A ball that comes back the moment that it went has no columns: its size is anybody's guess."""
    evidence = evidence_of(run_of(6))
    rattle, = (family for family in evidence.bank.families if family.name == 'ball_rattle')
    setting = Setting({**rattle.settings[0], 'motion': 'pulse', 't0': 100.0, 't1': 100.0})
    member = evidence.member(rattle, setting, 0.0)
    assert len(member.rows) == 0
    np.testing.assert_array_equal(evidence.empty.line(member.rows), 0)
    assert State(evidence, [member]).likelihood == 0


def test_what_an_order_hides_is_no_hypothesis():
    """In order row the drifts of the frame and of the zero are hidden: nothing is said of them, and nothing ends."""
    offered = {one.family.name for one in evidence_of(run_of(6, 'row')).empty.offers()}
    assert not offered & {'frame_drift', 'table_zero_drift', 'table_backlash'} and 'plate_warp' in offered


def test_a_motion_without_a_name_has_none_in_another_process():
    """It was one with a name there, with the prior of these."""
    family = CauseFamily(FREE, 'time | frame', ())
    there = pickle.loads(pickle.dumps(family))
    assert there.is_free and log_found(there) == log_found(family)


def test_the_largest_sensitivity_of_each_family_is_said_once():
    """Over all its settings; of what another residual leaves it is the same."""
    evidence = evidence_of(run_of(6))
    for one in (evidence, evidence.on(np.ones((36, 3)))):
        for name in ('frame_drift', 'ball_slip', 'table_backlash_angle'):
            expected = max(share for key, seen in one.shares.items() for number, share in zip(
                one.bank.groups[key].family, seen) if one.bank.families[number].name == name)
            assert one.sensitivities[name] == expected

# SPDX-License-Identifier: Apache-2.0
"""What an order cannot show, as a prior of the one least squares: effects of the library, of the size that is stated.

    y = B b + C a + sum over effects e of D_e a_e + noise,    b flat,    a ~ N(0, s^2), s of each column

B is the base model, C what a model claims, D_e the columns of an effect at a few settings. An effect is there with the
probability pi, by the rates that the diagnosis has (core/sight/priors.py) for any size, at any of its K settings k
alike, and then of the size s = size stated / sqrt(pi). The readings judge it by the same log Bayes factor as there, m
their degrees of freedom: with the columns E of D_k that base and claims leave, over the noise, as the residual r is,
and E E' v = l v,

    ln BF_k = -1/2 sum over v of ln(1 + s^2 l) - m/2 ln(1 - sum over v of s^2 (v' E r)^2 / (1 + s^2 l) / r'r)
    w_k = pi / (1 - pi) BF_k / K

and D_k enters with the variance s^2 w_k / (1 + sum of w). Where the order shows nothing BF is 1, and the variance from
run to run remains that is stated; where it shows that nothing is there it goes to 0. Experience of the cell gives pi of
what it knows, and the size: the variance from run to run is then rate x mean square. See docs/uncertainty.md.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from rosette_ros.core.effects.effect import PhysicalEffect, Setting, grid
from rosette_ros.core.effects.library import EFFECTS, effects_of
from rosette_ros.core.model.least_squares import HIDDEN, REFINED, Fit, observed
from rosette_ros.core.model.least_squares import fit as fit_of
from rosette_ros.core.run.geometry import rotate_z
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats, Run
from rosette_ros.core.run.scheme import nominal_places
from rosette_ros.core.sight.bank import CauseFamily
from rosette_ros.core.sight.linear_explanation import Solution
from rosette_ros.core.sight.priors import with_priors
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.mixture import Mixture
from rosette_ros.core.uncertainty.stated_environment import KINDS, LABORATORY, Environment, Unseen

MOST_SETTINGS = 120
"""Settings that stand for all of an effect."""
CAGE = (0.37, 0.39, 0.41, 0.43, 0.45, 0.47)
"""Orders per turn of the cages of bearings."""
LARGEST = 30.0
"""Standard deviation of a claim before it is known, as displacement of a ball in that of the noise; what is found of
it where that is more."""
NEGLIGIBLE = 1e-4
"""Share of the variance of each point below which a column is left out."""
MATTERS = 1.2
"""Ratio of U with an environment to U of the readings alone from which on the difference matters."""
MOST_BALLS = 72
"""Larger plates would take minutes."""
CLAIMED = 'effects in the model'


@dataclass(frozen=True, eq=False)
class Surrounded:
    """A Fit in an environment.

    error_motions: curves, their mean and u; there: the probability of each effect that may be there; owners: whose each
    column is, `CLAIMED` or the effect; moved: what a unit of each does to the curves, (k, n, 6), and carried: its
    covariance with them, so that u^2 less the part of the base model is the sum of moved x carried.
    """

    fit: Fit
    environment: Environment
    error_motions: ErrorMotions
    there: Mapping[str, float]
    owners: tuple[str, ...]
    moved: Floats
    carried: Floats

    @cached_property
    def parts(self) -> dict[str, Floats]:
        """The part in the variance of each point, (n, 6), of what is claimed and of each effect that may be there."""
        return self._by_owner(self.moved * self.carried)

    @cached_property
    def shares(self) -> dict[str, Floats]:
        """The share of each effect that may be there in the mean variance of each curve, (6,), the largest first."""
        whole = np.maximum(np.mean(self.error_motions.u**2, axis=0), 1e-300)
        out = {name: np.mean(self.parts[name], axis=0) / whole for name in self.there}
        return dict(sorted(out.items(), key=lambda pair: -float(pair[1].max())))

    @property
    def growth(self) -> Floats:
        """How many times U of each point is that of the readings alone, (n, 6)."""
        alone = self.fit.error_motions.u
        return np.divide(self.error_motions.u, alone, out=np.ones(alone.shape), where=alone > 0)

    def difference_parts(self, high: Sequence[int], low: Sequence[int]) -> dict[str, Floats]:
        """Return those parts of the variance of one point less another of each curve, (6,); high, low: 0..n-1."""
        every = range(6)
        moved, carried = (one[:, high, every] - one[:, low, every] for one in (self.moved, self.carried))
        return self._by_owner(moved * carried)

    def ranges(self, high: Sequence[int], low: Sequence[int], others: Floats) -> tuple[Mixture, ...]:
        """Return the distribution of one point less another of each curve, 0..n-1; others: variance beside, (6,)."""
        parts, every = self.difference_parts(high, low), range(6)
        base = self.fit.weighted_sigma**2 * self.fit.joint.without_effects.difference_cofactor(high, low)
        square, values = base + others + sum(parts.values()), self.error_motions.values
        return tuple(Mixture.of_parts(float(step), float(square[place]), [
            (p, float(parts[name][place])) for name, p in self.there.items()])
            for place, step in enumerate(values[high, every] - values[low, every]))

    def _by_owner(self, products: Floats) -> dict[str, Floats]:
        """Return sums (...) of products (k, ...) by owner, none negative: effects take from each other what one shows.
        """
        owners = np.array(self.owners)
        parts = {name: np.maximum(products[owners == name].sum(axis=0), 0) for name in (CLAIMED, *self.there)}
        whole, added = products.sum(axis=0), sum(parts.values())
        return {name: part * np.divide(whole, added, out=np.zeros(whole.shape), where=added > 0)
                for name, part in parts.items()}


def kind_of(effect: PhysicalEffect) -> str:
    """Return to which of KINDS an effect belongs."""
    return effect.motion.stated


def at_ball(environment: Environment, run: Run) -> dict[str, float]:
    """Return how far each effect that a run can have moves a ball, m, as standard deviation from run to run.

    Effects of one number have equal parts of its variance; those of which experience knows the size have none."""
    able, out = {name: kind_of(EFFECTS[name]) for name in _settings(run)}, {}
    for name, kind in able.items():
        if known := environment.sized(name):
            out[name] = (known.rate * known.mean_square)**0.5 * _per_rms(run, name)
        elif name in environment.effects:
            out[name] = environment.effects[name].value
        elif kind in environment.sizes:
            several = sum(own == kind and other not in environment.effects and not environment.sized(other)
                          for other, own in able.items())
            lever = run.radius if KINDS[kind].si == 'rad' else 1.0
            out[name] = lever * environment.sizes[kind].value / several**0.5
    return {name: size for name, size in out.items() if size > 0}


def size_per_rms(run: Run) -> dict[str, float]:
    """Return of each effect that a run can have its size at a ball, per rms of its displacements over coordinates."""
    return {name: size for name in _settings(run) if (size := _per_rms(run, name))}


def _per_rms(run: Run, name: str) -> float:
    """Return the size at a ball of an effect per rms, 0 where it moves none."""
    square = np.concatenate([np.sum(one**2, axis=(1, 2, 3)) for one in _columns(run, EFFECTS[name])])
    middle = float(np.median(square))
    return float(np.sqrt(3 * run.size / middle)) if middle else 0.0


def source_of(environment: Environment, name: str) -> str:
    """Return whence the size of an effect in an environment is."""
    if known := environment.sized(name):
        return f'in {known.expected:.0f} of {known.judged} earlier runs of the cell'
    return (environment.effects.get(name) or environment.sizes[kind_of(EFFECTS[name])]).source


def unseen(fit: Fit, environment: Environment | None = None) -> Unseen | None:
    """Return what U contains of what the order of a run hides; None where no environment is stated and none matters."""
    if 'table_motions' not in fit.model.base or fit.run.n > MOST_BALLS:
        return None
    made = surrounded(fit, environment or LABORATORY)
    at, curve = np.unravel_index(made.growth.argmax(), made.growth.shape)
    if not environment and made.growth[at, curve] < MATTERS:
        return None
    shares = {name: float(one[curve]) for name, one in made.shares.items()}
    alone, whole = (COVERAGE_FACTOR * float(one.u[at, curve]) for one in (fit.error_motions, made.error_motions))
    return Unseen(environment.name if environment else '', CURVES[curve], alone, whole,
                  max(shares, key=lambda name: shares[name], default=''), sum(shares.values()))


def expected_u(run: Run, sigma: float, environment: Environment) -> Floats:
    """Return the standard uncertainties of the curves, (n, 6), m and rad, of a run in the order of this one that shows
    nothing of what may be there; sigma: of a coordinate, m."""
    places = nominal_places(run.n, run.radius, run.table_position, run.ball)
    return surrounded(replace(fit_of(run.replace(centre=places)), rms=sigma, sigma=sigma), environment).error_motions.u


@lru_cache(maxsize=4)
def surrounded(fit: Fit, environment: Environment) -> Surrounded:
    """Return a Fit in an environment, which the effects of its model have left."""
    joint, run, sigma = fit.joint, fit.run, fit.weighted_sigma or 1.0
    space, size = joint.space, 6 * run.n
    places = (observed(run) - fit.beyond)[None]
    own = space.residual(joint.every).reshape(len(joint.every), 3 * run.size)
    blocks = list(_blocks(fit, environment, own))
    rows = np.concatenate([own, *(one.rows for one in blocks)]) / sigma
    bias = space.described(joint.every)[0].curves.reshape(-1, size) if len(own) else np.zeros((0, size))
    moved = np.concatenate([bias, *(one.curves for one in blocks)])
    found, left = space.described(places / sigma)
    spread, hidden = _claims(fit), np.concatenate([np.zeros(0), *(one.spread for one in blocks)])
    for _ in range(2):
        scale = np.concatenate([spread, hidden])
        told, carried = _posterior(scale[:, None] * rows, left.ravel(), scale[:, None] * moved)
        wider = np.maximum(spread, np.abs(scale * told)[:len(own)])
        if np.array_equal(wider, spread):
            break
        spread = wider
    carried = scale[:, None] * carried
    values = sigma * found.curves[0] - ((rows @ left.ravel()) @ carried).reshape(run.n, 6)
    variance = fit.weighted_sigma**2 * space.curve_cofactor() + np.maximum(
        np.sum(moved * carried, axis=0), 0).reshape(run.n, 6)
    return Surrounded(
        fit, environment, replace(fit.error_motions, values=values, u=np.sqrt(variance)),
        {one.name: one.there for one in blocks},
        (*[CLAIMED] * len(own), *(one.name for one in blocks for _ in one.spread)),
        moved.reshape(-1, run.n, 6), carried.reshape(-1, run.n, 6))


def _posterior(rows: Floats, left: Floats, moved: Floats) -> tuple[Floats, Floats]:
    """Return (1 + A A')^-1 times A r and X, of columns with prior variance 1: their mean (k,), and (k, c).

    rows A: (k, m) what they do to what is left of the readings, r: (m,), in units of the noise; moved X: (k, c), to the
    curves. The smaller one of A A' and A' A is solved."""
    is_tall, wanted = len(rows) > rows.shape[1], np.column_stack([rows @ left, moved])
    solution = Solution(rows.T @ rows if is_tall else rows @ rows.T)
    solved = wanted - rows @ solution.solved(rows.T @ wanted) if is_tall else solution.solved(wanted)
    return solved[:, 0], solved[:, 1:]


def _claims(fit: Fit) -> Floats:
    """Return standard deviations of all that a model claims, its amplitudes, then its nonlinear parameters."""
    out = [LARGEST * fit.weighted_sigma / _reach(fit.joint.columns)]
    for term, setting in zip(fit.model.terms, fit.settings):
        brackets = term.effect.brackets(fit.run, setting)
        out += [np.array([float(np.ptp(brackets[one.name])) / 2]) for one in term.effect.searched
                if one.kind in REFINED and one.name in setting and one.name not in term.fixed]
    return np.concatenate(out)


def _reach(columns: Floats) -> Floats:
    """Return how far each column (..., N, 3) moves a ball at most, m; 1 where it moves none."""
    most = np.sqrt(np.sum(columns**2, axis=-1)).max(axis=-1)
    return np.asarray(np.where(most > 0, most, 1.0))


class _EffectBlock(NamedTuple):
    """The columns of an effect that count: the probability that it is there, standard deviation of each amplitude (q,),
    what the base model leaves of them (q, 3 N), and what they do to the curves, (q, 6 n)."""

    name: str
    there: float
    spread: Floats
    rows: Floats
    curves: Floats


def _blocks(fit: Fit, environment: Environment, own: Floats) -> Iterator[_EffectBlock]:
    """Yield the _Blocks of an environment beside the claims of a fit, whose white rows are `own`, (q, 3 N)."""
    run, space, noise = fit.run, fit.joint.space, fit.rms or 1.0
    _, size, rows = np.linalg.svd(own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300),
                                  full_matrices=False)
    basis, left = rows[size > HIDDEN], fit.white_residual.reshape(-1) / noise
    left = left - (left @ basis.T) @ basis
    least = NEGLIGIBLE * np.maximum(fit.error_motions.u**2, 1e-300)
    for name, several in _effects(run, environment, {term.name for term in fit.model.terms}):
        columns = np.concatenate([one.reshape(-1, run.size, 3) for one in several.columns])
        found, rows = space.described(columns)
        rows = rows.reshape(len(columns), -1)
        rows[np.linalg.norm(rows, axis=1) < HIDDEN * np.linalg.norm(columns, axis=(1, 2))] = 0
        seen, begin, looked = (rows - (rows @ basis.T) @ basis) / noise, 0, []
        for one in several.columns:
            part = seen[begin:begin + one.shape[0] * one.shape[1]].reshape(*one.shape[:2], -1)
            looked.append((part @ np.swapaxes(part, 1, 2), part @ left))
            begin += one.shape[0] * one.shape[1]
        there, spread = several.judged(looked, fit.dof)
        keep = np.max((spread[:, None, None] * found.curves)**2 / least, axis=(1, 2)) > 1
        if np.any(keep):
            yield _EffectBlock(name, there, spread[keep], rows[keep], found.curves[keep].reshape(-1, 6 * run.n))


class _Several(NamedTuple):
    """An effect at all its settings: columns (b, q, N, 3) each, m; its size if it is there, m; odds of being there at
    any one of them."""

    columns: list[Floats]
    slab: float
    odds: float

    def judged(self, looked: Sequence[tuple[Floats, Floats]], dof: int) -> tuple[float, Floats]:
        """Return the probability that it is there, and the standard deviation of each amplitude.

        looked: of each array of columns E E' (b, q, q) and E r (b, q), over the rms of r; dof: of r."""
        log = np.log(self.odds) + np.concatenate([
            Solution(self.slab**2 * square).log_bayes_factor(self.slab * told, float(dof), dof)
            for square, told in looked])
        p = np.exp(log - np.logaddexp.reduce([0.0, *log]))
        return float(p.sum()), self.slab * np.sqrt(np.repeat(p, [one.shape[1] for one in self.columns for _ in one]))


def _effects(run: Run, environment: Environment, claimed: Collection[str] = ()) -> Iterator[tuple[str, _Several]]:
    """Yield what may be there in a run, by name; claimed: effects that have left the environment."""
    sizes = at_ball(environment, run)
    families = [CauseFamily(EFFECTS[name], name, _settings(run)[name]) for name in sizes]
    for family in with_priors(families, seen=1.0, experience=environment.experience):
        if family.name not in claimed:
            columns, odds = list(_columns(run, EFFECTS[family.name])), float(np.exp(family.log_prior))
            # a size that is stated is that of an effect which comes as often as in any cell
            usual = odds if environment.sized(family.name) else odds / float(np.exp(family.learnt))
            pi = usual / (1 + usual)
            yield family.name, _Several(columns, sizes[family.name] / pi**0.5, odds / len(family.settings))


def hidden_covariance(run: Run, environment: Environment, noise: float, dof: int,
                      look: Callable[[Floats], tuple[Floats, Floats]],
                      claimed: Collection[str] = ()) -> tuple[Floats, dict[str, Floats]]:
    """Return the covariance of what may be there in a run, (3 N, 3 N), m^2, and its factors by effect, (k, 3 N), m;
    both in the axes of table angle 0.

    look: returns E E' and E r, m^2, of columns (b, q, N, 3) in the evaluation of which the run is a part; noise, dof:
    rms of its residual, m, and degrees of freedom; claimed: effects that have left the environment."""
    factors = {}
    for name, several in _effects(run, environment, claimed):
        looked = [tuple(one / noise**2 for one in look(columns)) for columns in several.columns]
        spread = several.judged(looked, dof)[1]  # type: ignore[arg-type]
        factors[name] = spread[:, None] * np.concatenate([
            rotate_z(run.table_offset, one).reshape(-1, 3 * run.size) for one in several.columns])
    return np.asarray(sum((one.T @ one for one in factors.values()), np.zeros((3 * run.size, 3 * run.size)))), factors


def _columns(run: Run, effect: PhysicalEffect) -> Iterator[Floats]:
    """Yield columns of an effect at the settings that stand for all, those with as many amplitudes together.

    (b, q, N, 3), m. Amplitudes of each function along all its directions, a vector of length 1, move a ball by at most
    about one."""
    groups: dict[int, list[Setting]] = {}
    for setting in _settings(run)[effect.name]:
        groups.setdefault(effect.width(run, setting), []).append(setting)
    for some in groups.values():
        made = effect.blocks(run, some)
        directions = np.array([len(effect.motion.parts(run, setting)) for setting in some])
        yield made / (_reach(made) * directions[:, None]**0.5)[..., None, None]


@lru_cache(maxsize=2)
def _settings(run: Run) -> dict[str, tuple[Setting, ...]]:
    """Return the settings that stand for all of each effect that a run can have, by name.

    Of choices those that no other one contains, as all three axes of the frame contain each; of the orders of a
    bearing those of its cage. A table that comes from one side only has no backlash: its curves are those of this side.
    """
    out = {}
    for name in effects_of(run):
        one = EFFECTS[name]
        if one.unavailable(run) or ('approach' in one.depends_on and np.ptp(run.approach) == 0):
            continue
        if name == 'asynchronous_motion':
            out[name] = grid(motion=('radial', 'axial', 'tilt'), nu=CAGE)
            continue
        parts = {choice: frozenset(one.motion.parts(run, choice)) for choice in one.motion.settings(run)}
        widest = [choice for choice, own in parts.items() if not any(own < other for other in parts.values())]
        every = [Setting({**choice, **value}) for choice, value in product(widest, one.course.settings(run))]
        every = [setting for setting in every if one.motion.goes_with(setting)]
        if every:
            places = np.linspace(0, len(every) - 1, min(MOST_SETTINGS, len(every))).astype(int)
            out[name] = tuple(every[place] for place in places.tolist())
    return out


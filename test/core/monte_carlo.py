# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo after GUM Supplement 1: the uncertainties of curves and parameters, confirmed."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.diagnosis.search import Problem
from rosette_ros.core.model.least_squares import fit


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """What drawing the noise anew gives, beside what the fit stated.

    draws; u: (n, 6) standard deviations of the curves; low, high: (n, 6) coverage interval of 95 %
    about the fitted curves; parameters: (name of effect, name, u drawn, u stated) of each effect's
    parameters; ratio: rms over all curve points of drawn over stated uncertainty.
    """

    draws: int
    u: np.ndarray
    low: np.ndarray
    high: np.ndarray
    parameters: tuple[tuple[str, str, float, float], ...]
    ratio: float


def monte_carlo(fitted, draws=1000, seed=0):
    """Return the MonteCarlo of a fit: its model with new noise of its sigma, fitted again.

    Linear models are drawn all at once; where nonlinear parameters were searched, each draw refines them again.
    """
    rng = np.random.default_rng(seed)
    curves, parameters = [], []
    nonlinear = len(fitted.joint.every) > fitted.joint.q
    if nonlinear:
        for _ in range(draws):
            again = _refit(fitted, rng)
            curves.append(again.error_motions.values)
            parameters.append([p.value for effect in again.effects for p in effect.parameters])
        curves, parameters = np.array(curves), np.array(parameters)
    else:
        curves, parameters = _linear(fitted, draws, rng)
    u = curves.std(axis=0, ddof=1)
    low, high = np.quantile(curves, [0.025, 0.975], axis=0)
    stated = fitted.error_motions.u
    names = [(effect.name, p.name, p.u) for effect in fitted.effects for p in effect.parameters]
    spread = parameters.std(axis=0, ddof=1) if names else ()
    return MonteCarlo(draws, u, low, high,
                      tuple((effect, name, float(drawn), float(said))
                            for (effect, name, said), drawn in zip(names, spread)),
                      float(np.sqrt(np.mean((u / stated)**2))))


def _linear(fitted, draws, rng):
    """Return curves (draws, n, 6) and amplitudes (draws, q) of noise added to the fit."""
    run, joint = fitted.run, fitted.joint
    curves = np.empty((draws, *fitted.error_motions.values.shape))
    amplitudes = np.empty((draws, joint.q))
    stated = np.array([p.value for effect in fitted.effects for p in effect.parameters])
    for start in range(0, draws, 200):
        part = slice(start, min(start + 200, draws))
        noise = joint.whitening.inverse(fitted.sigma * rng.standard_normal((part.stop - start, run.size, 3)))
        perp = joint.space.residual(noise)
        shift = np.array([joint.amplitudes(row) for row in perp]).reshape(len(noise), joint.q)
        amplitudes[part] = shift + stated
        rest = noise - np.tensordot(shift, joint.columns, axes=1) if joint.q else noise
        curves[part] = joint.space.parameters(rest).curves + fitted.error_motions.values
    return curves, amplitudes


def _refit(fitted, rng):
    run = fitted.run
    noise = fitted.joint.whitening.inverse(fitted.sigma * rng.standard_normal((1, run.size, 3)))[0]
    drawn = run.replace(centre=run.centre - fitted.residual + noise)
    base = fit(drawn, type(fitted.model)(fitted.model.base), noise=fitted.noise)
    problems = [Problem(drawn, base.joint, base.white_residual, base.dof, (), (), fixed=term.fixed)
                for term in fitted.model.terms]
    members = [problem.member(term.effect, setting, 1.0)
               for problem, term, setting in zip(problems, fitted.model.terms, fitted.settings)]
    for _ in range(2 if len(members) > 1 else 1):
        for place, (problem, member) in enumerate(zip(problems, members)):
            members[place] = problem.refine(member, problem.select(members[:place] + members[place + 1:]))
    return fit(drawn, fitted.model, tuple(member.setting for member in members), fitted.noise)

# SPDX-License-Identifier: Apache-2.0
"""Blind tests of the diagnosis: the simulated machine hides effects, the envelopes are opened after.

    python -m benchmarks.blind [--seeds 20] [--balls 12] [--strength 12] [--orders diagonal random]
                               [--together N] [--clean] [--list]

The machine draws its effects from its own physics and shares no code with the library that must name
them. Each effect is scaled so that its observable part (which the base model does not absorb) has a norm
of `strength` times the repeatability; effects with an observable share below LEAST_SHARE are left out
and counted as not observable. The true parameters of what was hidden are those
with which the library's columns describe the machine's own displacement best; the table says how many
of those found lie within their expanded uncertainty (k = 2).
"""

import argparse
import itertools
import multiprocessing
import os
from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

SIGMA = 1e-7
LEAST_SHARE = 0.05


@dataclass(frozen=True)
class Trial:
    """One blind run: what was hidden, what was claimed and what was said of look-alikes.

    covered: of each parameter of a true claim, whether the truth is within the expanded uncertainty.
    """

    order: str
    seed: int
    hidden: tuple[str, ...]
    shares: tuple[float, ...]
    claimed: tuple[str, ...]
    alike: tuple[tuple[str, ...], ...]
    unexplained: str
    covered: tuple[bool, ...]
    rms: float
    cross_validation: float

    @property
    def named(self):
        """Whether the set of claims is the set of hidden effects, look-alikes allowed."""
        return len(self.claimed) == len(self.hidden) and any(
            all(name == true or true in alike
                for (name, alike), true in zip(zip(self.claimed, self.alike), order))
            for order in itertools.permutations(self.hidden))

    @property
    def first(self):
        """Whether the first claim is a hidden effect or names one as its look-alike."""
        return bool(self.claimed) and any(
            true == self.claimed[0] or true in self.alike[0] for true in self.hidden)


def blind_run(balls, order, kinds, seed, strength, known_sigma=True, turning='forward'):
    """Return a run that hides effects of the machine, their visible shares and their displacements.

    The run is None where the order hides one of them; displacements: (N, 3) each, m.
    """
    from rosette_ros.core.model.base_model import base_space
    from rosette_ros.core.model.least_squares import mean_radius
    from rosette_ros.core.scheme import plan
    from rosette_ros.simulation import Machine, MachineConfig
    from rosette_ros.simulation.hidden import KINDS, Draw, Situation

    scheme = plan(balls, order, seed, turning)
    config = MachineConfig().changed(seed=seed, plate={'balls': balls})
    machine = Machine(config)
    machine.align(repeats=10)
    clean = machine.run(scheme)
    start = machine.time / 3600 - np.ptp(clean.time) / 3600
    rng = np.random.default_rng([seed, balls, 77])
    situation = Situation(balls, clean.radius, start, np.ptp(clean.time) / 3600, SIGMA * 1e6)
    space = base_space(clean, mean_radius(clean))
    shifts, shares = [], []
    for kind in kinds:
        effect = KINDS[kind].draw(Draw(rng, 1.0, situation))
        hidden = Machine(config.changed(hidden=[effect.model_dump()]))
        hidden.align(repeats=10)
        shift = hidden.run(scheme).centre - clean.centre
        shift = shift - shift.mean(axis=0)
        visible = np.linalg.norm(space.residual(shift[None]))
        shares.append(visible / np.linalg.norm(shift))
        # the drawn size is 1 um: a norm of a few nm is rounding and second-order smallness
        if shares[-1] < LEAST_SHARE or visible < 0.1e-6:
            return None, shares, shifts
        shifts.append(shift * strength * SIGMA / visible)
    run = clean.replace(centre=clean.centre + sum(shifts, np.zeros_like(clean.centre)),
                        repeatability=SIGMA if known_sigma else None, repeatability_dof=None)
    return run, shares, shifts


def true_parameters(run, effect, setting, shift):
    """Return the parameters with which an effect describes a displacement (N, 3) best, by name.

    setting: as it was found; its continuous parameters are searched within their brackets. There is no
    noise; table, plate and CMM take up what they can (where the plate lay when the run began is theirs).
    """
    from rosette_ros.core.effects.effect import Setting
    from rosette_ros.core.model.base_model import base_space
    from rosette_ros.core.model.least_squares import mean_radius
    space = base_space(run, mean_radius(run))
    target = space.residual(shift[None]).reshape(-1)
    continuous = {name: bracket for name, bracket in effect.brackets(run, setting).items()
                  if isinstance(bracket, tuple)}

    def solve(values):
        tried = Setting({**setting, **dict(zip(continuous, values))})
        columns = np.moveaxis(effect.columns(run, tried), -1, 0)
        flat = space.residual(columns.astype(float)).reshape(len(columns), -1).T
        scale = np.linalg.norm(flat, axis=0)
        amplitude = np.linalg.lstsq(flat / scale, target, rcond=1e-9)[0] / scale
        return amplitude, np.linalg.norm(target - flat @ amplitude)

    values = []
    for low, high in continuous.values():
        best = minimize_scalar(lambda value: solve([value])[1], bounds=(low, high), method='bounded',
                               options={'xatol': 1e-6 * (high - low)})
        values.append(best.x)
    names = [quantity.name for quantity in effect.amplitudes(run, setting)]
    return {**dict(zip(names, solve(values)[0])), **dict(zip(continuous, values))}


def coverage(run, found, kinds, shifts):
    """Return whether each parameter of each true claim lies within its expanded uncertainty."""
    out = []
    for fitted, term in zip(found.final.effects, found.terms):
        if fitted.name not in kinds or found.missing.count(fitted.name) > 1:
            continue
        truth = true_parameters(run, term.effect, fitted.setting, shifts[kinds.index(fitted.name)])
        out += [abs(one.value - truth[one.name]) <= 2 * one.u
                for one in fitted.parameters if one.name in truth and np.isfinite(one.u)]
    return tuple(out)


def trial(task):
    """Return the Trial of one task, or None where the order hides the effect."""
    from rosette_ros.core.diagnosis.diagnosis import diagnose
    balls, order, kinds, seed, strength, known, turning = task
    run, shares, shifts = blind_run(balls, order, kinds, seed, strength, known, turning)
    if run is None:
        return order, kinds, None
    found = diagnose(run)
    claimed = [candidate for candidate in found.candidates if candidate.claimed]
    return order, kinds, Trial(
        order, seed, tuple(kinds), tuple(shares), tuple(c.effect for c in claimed),
        tuple(c.look_alikes for c in claimed), found.unexplained_text,
        coverage(run, found, kinds, shifts), found.final.rms,
        claimed[-1].cross_validation_after if claimed else np.nan)


def main(argv=None):
    """Run the blind tests and print the confusion table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('--balls', type=int, default=12)
    parser.add_argument('--strength', type=float, default=12.0)
    parser.add_argument('--orders', nargs='+', default=['row', 'diagonal', 'column', 'random'])
    parser.add_argument('--kinds', nargs='+')
    parser.add_argument('--together', type=int, default=1, help='effects hidden at once')
    parser.add_argument('--turning', default='forward')
    parser.add_argument('--unknown-sigma', action='store_true')
    parser.add_argument('--clean', action='store_true', help='hide nothing')
    parser.add_argument('--list', action='store_true', help='print every wrong answer')
    arguments = parser.parse_args(argv)
    tasks = _tasks(arguments)
    with multiprocessing.Pool(os.cpu_count()) as pool:
        results = pool.map(trial, tasks, chunksize=2)
    for line in table(results, arguments):
        print(line)


def _tasks(arguments):
    from rosette_ros.simulation.hidden import NAMED
    kinds = arguments.kinds or [kind for kind in NAMED if kind != 'touch_dust']
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    tasks = []
    for order in arguments.orders:
        for seed in seeds:
            if arguments.clean:
                sets = [()]
            elif arguments.together == 1:
                sets = [(kind,) for kind in kinds]
            else:
                rng = np.random.default_rng([seed, arguments.together])
                sets = [tuple(rng.choice(kinds, arguments.together, replace=False))]
            tasks += [(arguments.balls, order, chosen, seed, arguments.strength,
                       not arguments.unknown_sigma, arguments.turning) for chosen in sets]
    return tasks


def table(results, arguments):
    """Yield the lines of the confusion table."""
    groups = {}
    for order, kinds, result in results:
        name = ' + '.join(kinds) if arguments.together == 1 else f'{arguments.together} together'
        groups.setdefault((order, name or 'nothing'), []).append(result)
    yield '| order | hidden | runs | named | first | identified instead | unexplained | within U | rms/σ |'
    yield '|---|---|---|---|---|---|---|---|---|'
    total = Counter()
    for (order, name), trials in groups.items():
        seen = [t for t in trials if t is not None]
        if not seen:
            yield f'| {order} | {name} | not observable | | | | | | |'
            continue
        wrong = Counter(' + '.join(t.claimed) or 'nothing' for t in seen if not t.named)
        named, first = sum(t.named for t in seen), sum(t.first for t in seen)
        total.update(runs=len(seen), named=named, first=first)
        instead = ', '.join(f'{what} ({count})' for what, count in wrong.most_common(3))
        covered = [one for t in seen for one in t.covered]
        within = f'{sum(covered)} of {len(covered)}' if covered else ''
        total.update(parameters=len(covered), within=sum(covered))
        rms = np.median([t.rms for t in seen]) / SIGMA
        yield (f'| {order} | {name} | {len(seen)} | {named} | {first} | {instead} | '
               f'{sum(bool(t.unexplained) for t in seen)} | {within} | {rms:.2f} |')
        if arguments.list:
            for t in seen:
                if not t.named or t.unexplained:
                    yield (f'    seed {t.seed} hidden {t.hidden} share {np.round(t.shares, 2)} '
                           f'claimed {t.claimed} alike {t.alike} left: {t.unexplained}')
    yield ''
    yield (f'Runs: {total["runs"]}; set correct: {total["named"]}; first effect correct: {total["first"]}; '
           f'parameters within U: {total["within"]} of {total["parameters"]}')


if __name__ == '__main__':
    main()

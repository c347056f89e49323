# SPDX-License-Identifier: Apache-2.0
"""Blind tests of the diagnosis: the simulated machine hides effects, the envelopes are opened after.

    python -m benchmarks.blind [--seeds 20] [--balls 12] [--strength 12] [--orders diagonal random]
                               [--effects N] [--clean] [--out FILE]

The machine draws its effects from its own physics and shares no code with the library that must name
them. Each effect is scaled so that what the run can show of it (the part that the base model does
not take up) has a norm of `strength` times the repeatability; effects of which the order shows less
than a tenth are left out and counted as hidden.
"""

import argparse
import itertools
import multiprocessing
import os
from collections import Counter
from dataclasses import dataclass

import numpy as np

SIGMA = 1e-7
LEAST_SHARE = 0.1


@dataclass(frozen=True)
class Trial:
    """One blind run: what was hidden, what was claimed and what was said of look-alikes."""

    order: str
    seed: int
    hidden: tuple[str, ...]
    shares: tuple[float, ...]
    claimed: tuple[str, ...]
    alike: tuple[tuple[str, ...], ...]
    unexplained: str
    covered: tuple[bool, ...]
    rms: float
    held_out: float

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
    """Return a run that hides effects of the machine, and their visible shares, or None if hidden."""
    from rosette_ros.core.base import base_space
    from rosette_ros.core.fit import mean_radius
    from rosette_ros.core.scheme import plan
    from rosette_ros.machine import Machine, MachineConfig
    from rosette_ros.machine.hidden import KINDS
    from rosette_ros.machine.hidden.base import Situation

    scheme = plan(balls, order, seed, turning)
    config = MachineConfig().changed(seed=seed, plate={'balls': balls})
    machine = Machine(config)
    machine.align(repeats=10)
    clean = machine.run(scheme)
    start = machine.time / 3600 - np.ptp(clean.time) / 3600
    rng = np.random.default_rng([seed, balls, 77])
    situation = Situation(balls, clean.radius, start, np.ptp(clean.time) / 3600, SIGMA * 1e6)
    space = base_space(clean, mean_radius(clean))
    centre, shares = clean.centre.copy(), []
    for kind in kinds:
        effect = KINDS[kind].draw(rng, 1.0, situation)
        hidden = Machine(config.changed(hidden=[effect.model_dump()]))
        hidden.align(repeats=10)
        shift = hidden.run(scheme).centre - clean.centre
        shift = shift - shift.mean(axis=0)
        visible = np.linalg.norm(space.residual(shift[None]))
        shares.append(visible / np.linalg.norm(shift))
        # the drawn size is 1 um: a norm of a few nm is rounding and second-order smallness
        if shares[-1] < LEAST_SHARE or visible < 0.1e-6:
            return None, shares
        centre = centre + shift * strength * SIGMA / visible
    run = clean.replace(centre=centre, repeatability=SIGMA if known_sigma else None,
                        repeatability_dof=None)
    return run, shares


def trial(task):
    """Return the Trial of one task, or None where the order hides the effect."""
    from rosette_ros.core.diagnosis import diagnose
    balls, order, kinds, seed, strength, known, turning = task
    run, shares = blind_run(balls, order, kinds, seed, strength, known, turning)
    if run is None:
        return order, kinds, None
    found = diagnose(run)
    claimed = [candidate for candidate in found.candidates if candidate.claimed]
    return order, kinds, Trial(
        order, seed, tuple(kinds), tuple(shares), tuple(c.effect for c in claimed),
        tuple(c.look_alikes for c in claimed), found.unexplained_text, (), found.final.rms,
        claimed[-1].held_out_after if claimed else np.nan)


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
    from rosette_ros.machine.hidden import NAMED
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
    yield '| order | hidden | runs | named | first | claimed instead | unexplained | rms/sigma |'
    yield '|---|---|---|---|---|---|---|---|'
    for (order, name), trials in groups.items():
        seen = [t for t in trials if t is not None]
        if not seen:
            yield f'| {order} | {name} | hidden by the order | | | | | |'
            continue
        wrong = Counter(' + '.join(t.claimed) or 'nothing' for t in seen if not t.named)
        named, first = sum(t.named for t in seen), sum(t.first for t in seen)
        instead = ', '.join(f'{what} ({count})' for what, count in wrong.most_common(3))
        rms = np.median([t.rms for t in seen]) / SIGMA
        yield (f'| {order} | {name} | {len(seen)} | {named} | {first} | {instead} | '
               f'{sum(bool(t.unexplained) for t in seen)} | {rms:.2f} |')
        if arguments.list:
            for t in seen:
                if not t.named or t.unexplained:
                    yield (f'    seed {t.seed} hidden {t.hidden} share {np.round(t.shares, 2)} '
                           f'claimed {t.claimed} alike {t.alike} left: {t.unexplained}')


if __name__ == '__main__':
    main()

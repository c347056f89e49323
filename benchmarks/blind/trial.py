# SPDX-License-Identifier: Apache-2.0
"""Trials: each is one run of a known truth, drawn from its own name alone, and how an answer to it is judged."""

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import sqrt
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from benchmarks.blind.answers import (
    Record,
    answered,
    determined,
    judged,
    law_judged,
    level_judged,
    remaining,
    truths,
    within,
)
from benchmarks.blind.cause import Cause, Names
from benchmarks.blind.library import alike, statement
from benchmarks.blind.noise_kinds import KINDS
from benchmarks.blind.runs import CROSSED, FEWEST, ORDERS, Plan, noisy, scaled, situation, true_curves
from benchmarks.blind.truth import Truth
from rosette_ros.core.run.records import Run
from rosette_ros.simulation.hidden_effect import Draw
from rosette_ros.simulation.hidden_kinds import KINDS as HIDDEN
from rosette_ros.simulation.hidden_kinds import NAMED

CAUSES = str(Path(__file__).with_name('causes.py'))
"""The file of the causes that are held out for the final judgement."""
STRENGTHS = (6.0, 9.0, 12.0)
OPEN_STRENGTHS = (16.0, 40.0)


class NotShown(ValueError):
    """No order of a trial shows what it hides."""


@cache
def causes_of(file: str) -> dict[str, type[Cause]]:
    """Return the causes of a file, by name."""
    spec = importlib.util.spec_from_file_location(Path(file).stem, file)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(f'causes: expected a Python file with a dictionary CAUSES, found {file}')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    causes: dict[str, type[Cause]] = module.CAUSES
    return causes


@dataclass(frozen=True)
class Trial:
    """One run of a set, drawn from `name` and from nothing else.

    kinds: what it hides, names of hidden_kinds or of a cause; strength: visible norm of each, σ; noise: a kind of
    noise_kinds; orders: tried in turn, the first one that shows all that is hidden is measured; causes: their file;
    left_out: name that the library of the diagnosis is to lack.
    """

    set: str
    seed: int
    kinds: Names = ()
    strength: float = 0.0
    noise: str = 'white'
    stated: bool = True
    orders: Names = ()
    n: int = 12
    causes: str = ''
    left_out: str = ''

    @property
    def name(self) -> str:
        """Says which run this is."""
        what = (self.set, '+'.join(self.kinds) or self.noise, f'{self.strength:.3g}', *self.orders,
                'stated' if self.stated else 'unknown', f'n{self.n}', str(self.seed))
        return ' '.join((*what, self.noise) if self.kinds else what)

    def generator(self, what: str) -> np.random.Generator:
        """Return the generator of one part of the run: a change in one leaves the others."""
        return np.random.default_rng([crc32(self.name.encode()), crc32(what.encode())])

    def run(self) -> tuple[Run, Truth]:
        """Return the run and its truth; raises NotShown where no order shows what is hidden."""
        seed = int(self.generator('machine').integers(1, 2**31))
        shares: list[tuple[float, ...]] = []
        for order in self.orders or self.generator('order').permutation(ORDERS).tolist():
            clean, truth, shifts = self._hide(Plan(self.n, order, seed))
            if all(shift is not None for shift in shifts):
                break
            shares.append(truth.share)
        else:
            raise NotShown(f'{self.name}: expected an order that shows it, found visible shares {shares}')
        shift = sum(shifts, np.zeros((clean.size, 3)))
        hit = tuple(int(np.argmax(np.linalg.norm(one, axis=1))) + 1
                    for kind, one in zip(self.kinds, shifts) if kind == 'outlier')
        run, noise = noisy(clean, self.noise, self.generator('noise'), self.stated, shift)
        return run, replace(truth, readings=(*hit, *noise.outliers), stray=noise.outliers, shift=shift)

    def _hide(self, made: Plan) -> tuple[Run, Truth, list[Any]]:
        """Return the run without noise or effect, what is known of it, and the displacements, None for hidden ones."""
        kinds: list[Any] = [causes_of(self.causes)[kind] if self.causes else HIDDEN[kind] for kind in self.kinds]
        if self.causes:
            made = replace(made, turning=kinds[0].turning, groups=tuple(kinds[0].groups.items()))
        clean, machine = made.measure()
        by = Draw(self.generator('effect'), 1.0, situation(clean, machine))
        drawn = [kind.draw(by, clean) if self.causes else kind.draw(by) for kind in kinds]
        found = [scaled(clean, made.measure(one)[0].centre - clean.centre, self.strength, FEWEST if self.causes else 0)
                 for one in drawn]
        truth = Truth(made.order, () if self.causes else self.kinds, (), (), np.zeros((clean.size, 3)),
                      true_curves(clean), tuple(share for share, _ in found))
        if self.causes:
            cause = drawn[0]
            truth = replace(truth, right=cause.right, part=cause.part, family=cause.family, body=cause.body,
                            variables=cause.variables)
        if self.left_out:
            body, variables = statement(self.left_out)
            truth = replace(truth, hidden=(), right=alike(self.left_out), body=body, variables=variables)
        return clean, truth, [shift for _, shift in found]

    def judge(self, found: Any, truth: Truth) -> Record:
        """Return the record of the Diagnosis of this run."""
        answer = answered(found)
        left = remaining(found, truth.shift)
        true = truths(answer['claims'], truth, left)
        for claim, is_true in zip(answer['claims'], true):
            claim['true'] = is_true
        levels = answer['levels'] or ()
        said = level_judged(levels, truth, determined(found.final.run))
        for level, is_said, law in zip(levels, said, law_judged(levels, truth, left)):
            level.update(true=is_said != 'wrong', complete=is_said == 'complete', law_true=law)
        return {'trial': self.name, 'set': self.set, 'kinds': list(self.kinds), 'strength': self.strength,
                'noise': self.noise, 'stated': self.stated, 'order': truth.order, 'n': self.n, 'seed': self.seed,
                'share': list(truth.share), 'judged': judged(answer, truth, left), 'left': left,
                'covered': within(found.final.error_motions, truth.curves), **answer}


def _white(seeds: range, causes: str) -> Iterator[Trial]:
    for order in ORDERS:
        for stated in (True, False):
            for seed in seeds:
                yield Trial('white', seed, stated=stated, orders=(order,))


def _noise(seeds: range, causes: str) -> Iterator[Trial]:
    for kind in KINDS:
        if kind != 'white':
            for seed in seeds:
                yield Trial('noise', seed, noise=kind, stated=seed // len(ORDERS) % 2 == 0,
                            orders=(ORDERS[seed % len(ORDERS)],))


def _library(seeds: range, causes: str) -> Iterator[Trial]:
    for kind in NAMED:
        for strength in STRENGTHS:
            for seed in seeds:
                yield Trial('library', seed, (kind,), strength)


def _together(name: str, count: int, strength: float) -> Callable[[range, str], Iterator[Trial]]:
    def made(seeds: range, causes: str) -> Iterator[Trial]:
        for seed in seeds:
            rng = np.random.default_rng([crc32(name.encode()), seed])
            yield Trial(name, seed, tuple(rng.choice(NAMED, count, replace=False).tolist()), strength)
    return made


def _outliers(seeds: range, causes: str) -> Iterator[Trial]:
    for strength in STRENGTHS:
        for seed in seeds:
            yield Trial('outliers', seed, ('outlier',), strength)


def _open(seeds: range, causes: str) -> Iterator[Trial]:
    for kind in causes_of(causes):
        for strength in OPEN_STRENGTHS:
            for seed in seeds:
                yield Trial('open', seed, (kind,), strength, causes=causes)


def _crossed(seeds: range, causes: str) -> Iterator[Trial]:
    for one in _open(seeds, causes):
        for order in CROSSED:
            yield replace(one, set='crossed', orders=(order,))


def _left_out(seeds: range, causes: str) -> Iterator[Trial]:
    for kind in NAMED:
        if kind != 'outlier':  # one reading alone depends on nothing
            for strength in OPEN_STRENGTHS:
                for order in CROSSED:
                    for seed in seeds:
                        yield Trial('left_out', seed, (kind,), strength, orders=(order,), left_out=kind)


def _coverage(seeds: range, causes: str) -> Iterator[Trial]:
    for noise in KINDS:
        for seed in seeds:
            rng = np.random.default_rng([crc32(noise.encode()), seed])
            yield Trial('coverage', seed, (str(rng.choice(NAMED)),), STRENGTHS[-1], noise)


SETS: dict[str, tuple[int, Callable[[range, str], Iterator[Trial]]]] = {
    'white': (20, _white), 'noise': (10, _noise), 'library': (5, _library), 'pairs': (100, _together('pairs', 2, 12.0)),
    'three': (60, _together('three', 3, 12 / sqrt(3))), 'outliers': (25, _outliers), 'open': (8, _open),
    'crossed': (2, _crossed), 'left_out': (2, _left_out), 'coverage': (5, _coverage)}
"""The sets by name: seeds of each group, and what makes their trials."""


def trials(sets: Sequence[str] = tuple(SETS), seeds: int | None = None, first_seed: int = 1, causes: str = CAUSES,
           n: int = 12) -> list[Trial]:
    """Return the trials of some sets.

    seeds: of each group, None for the usual number of each set; causes: file of the causes of `open` and `crossed`;
    n: balls.
    Raises ValueError for a set that there is not.
    """
    if unknown := [name for name in sets if name not in SETS]:
        raise ValueError(f'sets: expected some of {", ".join(SETS)}, found {", ".join(unknown)}')
    return [replace(one, n=n) for name in sets for count, make in [SETS[name]]
            for one in make(range(first_seed, first_seed + (seeds or count)), causes)]

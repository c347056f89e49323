# SPDX-License-Identifier: Apache-2.0
"""Cross-validation: the error in readings that the fit did not use.

With M = 1 - H the projection on the residuals and f a block of readings, the error of their prediction from all others
is u_f = M_ff^-1 r_f, and r_f' u_f / (3 size) estimates sigma^2 as the residuals of a fit do: a term that only describes
noise raises it, one that is right brings it down to sigma. Nonlinear parameters are searched again without each block.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rosette_ros.core.diagnosis.bank import Bank, Reals
from rosette_ros.core.diagnosis.effect_settings import evidence_of, families_of_terms, grid_falls, is_searched, searched
from rosette_ros.core.diagnosis.log_evidence import Member, State
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.model.least_squares import Fit, JointSpace, fit
from rosette_ros.core.model.model import Model, Term
from rosette_ros.core.records import Floats, Ints, Run

FOLDS = 8
LARGEST = 100
"""Readings of a block, and coordinates of it that are freed of the model at a time: it bounds the matrices."""
SAFE = 1e-3
"""Smallest diagonal element of a Cholesky factor that is not taken as singular."""
IMPUTATIONS = 2
"""How often the settings of effects are searched without a block of readings, each time better."""


@dataclass(frozen=True, eq=False)
class _Block:
    """One block: its coordinates, M_ff, M_ff^-1 or None where it is singular."""

    index: Ints
    own: Floats
    inverse: Reals | None

    def solve(self, added: Floats, residual: Floats) -> tuple[Reals, int]:
        """Return M_ff^-1 r_f with rows (k, 3 N) added to the model, and how many could be predicted.

        Added rows A take A_f' A_f from M_ff: few of them go by (M - A'A)^-1 = M^-1 + M^-1 A' (1 - A M^-1 A')^-1 A M^-1.
        """
        part, vector = added[:, self.index], residual[self.index]
        if self.inverse is not None and 2 * len(part) <= len(vector):
            error = self.inverse @ vector
            if not len(part):
                return error, len(vector)
            mixed = self.inverse @ part.T
            small = np.eye(len(part)) - part @ mixed
            if _is_sound(small):
                return error + mixed @ np.linalg.solve(small, part @ error), len(vector)
        return _solve(self.own - part.T @ part, vector)


class CrossValidation:
    """Blocks of readings that are left out under a model.

    Every reading is in one of FOLDS random blocks (a sample of each in large runs). A fit is given as its residual
    (3 N,) and the orthonormal rows (k, 3 N) that it adds to the model.
    """

    def __init__(self, space: JointSpace, size: int, seed: int = 0) -> None:
        """Draw the blocks of a run of `size` readings and project them off the model."""
        order = np.random.default_rng(seed).permutation(size)
        self.folds, self._space = max(2, min(FOLDS, size // 4)), space
        self._blocks = []
        for fold in range(self.folds):
            readings = np.sort(order[fold::self.folds][:LARGEST])
            index = (3 * readings[:, None] + np.arange(3)).reshape(-1)
            own = np.concatenate([self._freed(np.eye(index.size)[start:start + LARGEST], index, size)[:, index]
                                  for start in range(0, index.size, LARGEST)])
            self._blocks.append(_Block(index, own, np.linalg.inv(own) if _is_sound(own) else None))

    def _freed(self, values: Reals, index: Ints, size: int) -> Floats:
        """Return rows (m, 3 N) that have values (m, f) in a block and 0 elsewhere, freed of the model."""
        rows = np.zeros((len(values), 3 * size))
        rows[:, index] = values
        return self._space.free(rows.reshape(len(rows), size, 3)).reshape(rows.shape)

    def alone(self, member: Member, run: Run) -> list[bool]:
        """Return of each block whether a member moves its readings only: the others say nothing of it."""
        moved = 3 * np.flatnonzero(np.any(member.family.effect.columns(run, member.setting) != 0, axis=(1, 2)))
        return [moved.size <= block.index.size and bool(np.isin(moved, block.index).all()) for block in self._blocks]

    def training_residuals(self, residual: Floats, rows: Floats) -> Floats:
        """Return residuals of fits without each block, zero in it, (folds, 3 N)."""
        out = []
        for block in self._blocks:
            error = block.solve(rows, residual)[0]
            freed = self._freed(error[None], block.index, residual.size // 3)[0]
            out.append(residual - freed + (rows[:, block.index] @ error) @ rows)
        return np.array(out)

    def imputed(self, residual: Floats, fits: Sequence[tuple[Floats, Floats]]) -> Floats:
        """Return residuals (3 N,) of the model with the prediction by fits in place of each block, (folds, 3 N).

        A search in them does without the block: a step of expectation and maximisation.
        """
        return np.array([residual - self._freed(block.solve(rows, left)[0][None], block.index, residual.size // 3)[0]
                         for block, (left, rows) in zip(self._blocks, fits, strict=True)])

    def rms(self, fits: Sequence[tuple[Floats, Floats]]) -> float:
        """Return the rms error of prediction by a fit for each block, NaN where none determines the model."""
        total, count = 0.0, 0
        for block, (residual, rows) in zip(self._blocks, fits, strict=True):
            error, kept = block.solve(rows, residual)
            total += float(residual[block.index] @ error)
            count += kept
        return float(np.sqrt(total / count)) if count else float('nan')

    def rms_of(self, residual: Floats, rows: Floats | None = None) -> float:
        """Return the same for one fit whose settings are not searched without each block."""
        return self.rms([(residual, np.zeros((0, residual.size)) if rows is None else rows)] * self.folds)


def cross_validation_rms(run: Run, fitted: Fit) -> float:
    """Return the error of the cross-validation of a fit, m; its searched settings are found again without each block.

    A reading that only an effect of its own describes cannot be predicted, and does not count.
    """
    if not is_searched(fitted.model):
        return CrossValidation(fitted.joint, run.size).rms_of(fitted.white_residual.reshape(-1))
    model = replace(fitted.model, terms=tuple(Term(term.effect, term.fixed) for term in fitted.model.terms))
    base = fit(run, Model(model.base), noise=fitted.noise, beyond=fitted.beyond)
    blocks = CrossValidation(base.joint, run.size)
    evidence = evidence_of(base, Bank(run, families_of_terms(run, model)))
    own = [evidence.member(family, setting, 0.0) for family, setting in zip(evidence.bank.families, fitted.settings)]
    alone = [blocks.alone(one, run) for one in own]
    fits = [(evidence.y, np.zeros((0, evidence.y.size)))] * blocks.folds
    # at first the effects count for nothing in a block, then for what they predict there
    for _ in range(IMPUTATIONS):
        imputed = blocks.imputed(evidence.y, fits) * evidence.scale
        fits = []
        for fold, one in enumerate(imputed):
            found = searched(evidence.on(one.reshape(-1, 3)), model)
            made = [mine if is_alone[fold] else evidence.member(mine.family, setting, 0.0)
                    for mine, setting, is_alone in zip(own, found, alone)]
            state = State(evidence, made)
            fits.append((state.residual, state.basis))
    return evidence.scale * blocks.rms(fits)


class WithoutBlocks:
    """A hypothesis fitted without each block of readings; rms: the error of its cross-validation, in sigma."""

    def __init__(self, blocks: CrossValidation, before: State) -> None:
        self.rms = blocks.rms_of(before.residual, before.basis)
        self._blocks, self.state = blocks, before
        self._left = blocks.training_residuals(before.residual, before.basis)

    def rms_with(self, member: Member) -> float:
        """Return the same with a member more, its setting searched without each block."""
        evidence, own = self.state.evidence, member.family.effect.searched
        found: dict[Setting, tuple[Floats, Floats]] = {}
        settings = [member.setting] * self._blocks.folds if not own else [
            member.setting if is_alone else setting for is_alone, setting in zip(
                self._blocks.alone(member, evidence.run), self._settings[member.family.name])]
        for setting in dict.fromkeys(settings):
            again = member if setting == member.setting else evidence.member(member.family, setting, 0.0)
            found[setting] = self.state.extended(again.rows)
        return self._blocks.rms([found[setting] for setting in settings])

    @cached_property
    def _settings(self) -> dict[str, list[Setting]]:
        """The best setting of each named family without each block, by least squares."""
        bank, fall = self.state.evidence.bank, grid_falls(self.state, self._left, is_open=False)
        return {family.name: [family.settings[int(place)] for place in fall[start:end].argmax(axis=0)]
                for family, start, end in zip(bank.families, bank.ends, bank.ends[1:]) if not family.is_free}


def _is_sound(matrix: Floats) -> bool:
    """Return whether a symmetric matrix is positive definite, and not nearly singular."""
    try:
        return bool(np.diag(np.linalg.cholesky(matrix)).min() > SAFE)
    except np.linalg.LinAlgError:
        return False


def _solve(matrix: Floats, vector: Floats) -> tuple[Reals, int]:
    """Return the minimum-norm solution and how many coordinates could be predicted at all."""
    if _is_sound(matrix):
        return np.linalg.solve(matrix, vector), len(vector)
    value, basis = np.linalg.eigh(matrix)
    keep = value > 1e-6
    return basis[:, keep] @ ((basis[:, keep].T @ vector) / value[keep]), int(keep.sum())

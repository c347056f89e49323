# SPDX-License-Identifier: Apache-2.0
"""The recovered shape: what a free course makes of the residual against its variable, alone or for a claim.

With D the columns of the course, of the sizes of its process and freed of the model and of all other members, and tau
its size over sigma, the amplitudes are (D D' + 1/tau^2)^-1 D y and their covariance sigma^2 (D D' + 1/tau^2)^-1. A
claim is drawn by what the same course makes of it: where the claim is right, the two differ by noise.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.diagnosis.log_evidence import SIZES, Member, State
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free import FREE, TIMES, motions, place_of, variables
from rosette_ros.core.run.records import Floats, in_time
from rosette_ros.core.sight.bank import CauseFamily, columns_of, scaled
from rosette_ros.core.sight.linear_explanation import Solution


@dataclass(frozen=True, eq=False)
class ShapeCurve:
    """One curve of a shape: its axis and what multiplies it; value, u and claimed: (M,), m, at the shape's values.

    u: standard uncertainty; claimed: what the course makes of the claim, None where the shape has no name.
    """

    axis: str
    carrier: str
    value: Floats
    u: Floats
    claimed: Floats | None


@dataclass(frozen=True, eq=False)
class Shape:
    """A recovered shape: the free course and its setting, what it depends on in words, the effect that is claimed.

    claim: '' where no effect has the shape; variable, unit, values: (M,), rising, at which its curves are given.
    """

    form: str
    setting: Setting
    words: str
    claim: str
    variable: str
    unit: str
    values: Floats
    curves: tuple[ShapeCurve, ...]


def recovered_shapes(state: State, claimed: Sequence[Member]) -> tuple[Shape, ...]:
    """Return the Shape of each claimed or unnamed member of a hypothesis that depends on one variable."""
    found = (_shape(state, place) for place, one in enumerate(state.members) if one.family.is_free or one in claimed)
    return tuple(shape for shape in found if shape is not None)


def _shape(state: State, place: int) -> Shape | None:
    member, rest = state.members[place], state.without(place)
    run = state.evidence.run
    setting = member.setting if member.family.is_free else _twin(rest, member)
    if setting is None:
        return None
    *at_one, name = setting.word('of').split(TIMES)
    if not all(place_of(one)[1] for one in at_one):
        return None  # of two variables: a surface

    family = CauseFamily(FREE, name, (setting,))
    mix, functions, count = _mixed(state, setting)
    rows = state.evidence.space.residual(columns_of(family, run, setting)).reshape(np.count_nonzero(mix), -1)
    rows = rows - (rows @ rest.basis.T) @ rest.basis
    size = SIZES[int(np.argmax(rest.line(rows)))]

    root = size * Solution(size**2 * (rows @ rows.T)).halved(np.eye(len(rows))).T
    amplitudes = [state.evidence.scale * root @ (root.T @ (rows @ left)) for left in (
        (rest.residual,) if member.family.is_free else (rest.residual, rest.residual - state.residual))]
    sigma = state.evidence.scale * np.sqrt(state.rss / max(state.evidence.dof - len(state.basis), 1))

    variable = next(one for one in variables(run) if one.name == name)
    where = np.flatnonzero(functions.any(axis=0)) if at_one else np.arange(run.size)
    at = where[np.unique(variable.values[where], return_index=True)[1]]

    centred = (functions - functions[:, where].mean(axis=1, keepdims=True))[:, at]
    curves = []
    for k, axis in enumerate(_axes(setting.word('along'), count)):
        basis = np.zeros((mix.size, at.size))
        basis[k::count] = mix[k::count, None] * centred
        basis = basis[mix > 0]
        both = [amplitude @ basis for amplitude in amplitudes]
        u = sigma * np.linalg.norm(root.T @ basis, axis=0)
        curves.append(ShapeCurve(axis, at_one[0] if at_one else '', both[0], u,
                                 None if member.family.is_free else both[1]))
    return Shape(FREE.name, setting, f'{setting.word("along")} with {setting.word("of")}',
                 '' if member.family.is_free else member.name, variable.name, in_time(variable.unit, run.time_unit),
                 variable.values[at], tuple(curves))


def _mixed(state: State, setting: Setting) -> tuple[Floats, Floats, int]:
    """Return the diagonal of T (q,), the functions (k, N) of a free course, and its number of directions."""
    run = state.evidence.run
    columns = np.moveaxis(FREE.columns(run, setting), -1, 0)
    columns = columns - columns.mean(axis=1, keepdims=True)
    mix = scaled(np.sum(columns**2, axis=(1, 2))[None], FREE.variances(run, setting)[None])[0]
    return mix, FREE.course(run, setting)[0], len(motions(run)[setting.word('along')])


def _twin(rest: State, member: Member) -> Setting | None:
    """Return the free course of one variable and the body of an effect that explains most in its place."""
    effect, run = member.family.effect, rest.evidence.run
    moved, best, most = effect.moved(member.setting), None, -np.inf
    for name, settings in FREE.families(run):
        for setting in settings:
            driven = FREE.driven_by(setting)
            if len(driven) == 1 and driven <= {*effect.variables} and not moved.isdisjoint(FREE.moved(setting)):
                made = rest.evidence.member(CauseFamily(FREE, name, settings), setting)
                if (worth := float(rest.line(made.rows).max())) > most:
                    best, most = setting, worth
    return best


def _axes(along: str, count: int) -> list[str]:
    """Return what to call the directions of a motion."""
    letters = re.findall(r'\b[xyz]\b', along)
    return letters if len(letters) == count else [along] if count == 1 else [f'{along} {k + 1}' for k in range(count)]


def strongest(shape: Shape, most: int) -> Sequence[ShapeCurve]:
    """Return those curves of a shape that stand out most from their uncertainty, in the order of the shape."""
    ranked = sorted(shape.curves, key=lambda one: -float(np.mean((one.value / np.maximum(one.u, 1e-300))**2)))[:most]
    return [one for one in shape.curves if one in ranked]

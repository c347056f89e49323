# SPDX-License-Identifier: Apache-2.0
"""The recovered shape: what a free form makes of the residual against its variable, alone or beside a claim.

With P the columns of the form freed of the model and of all other members, in white coordinates, the amplitudes are
P+ r and their covariance sigma^2 (P P')+; what the model can describe of the form is left out of both. A claim is drawn
by what the same form makes of it: where the claim is right, the two differ by noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rosette_ros.core.diagnosis.candidates import HIDDEN_SHARE
from rosette_ros.core.diagnosis.right_shape import forms_beside
from rosette_ros.core.diagnosis.search import Member, Problem, Selection, searched_count
from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.free_forms import FREE_FORMS, FreeForm, axes_words, directions
from rosette_ros.core.records import Floats

MOST_POINTS = 200
CONSTANT = 1e-9  # change of a function of the variable below which it is a constant


@dataclass(frozen=True, eq=False)
class ShapeCurve:
    """One curve of a shape: its axis and what multiplies it; value, u and claimed: (M,), m, at the shape's values.

    u: standard uncertainty; claimed: what the form makes of the claim, None where the shape has no name.
    """

    axis: str
    carrier: str
    value: Floats
    u: Floats
    claimed: Floats | None


@dataclass(frozen=True, eq=False)
class Shape:
    """A recovered shape: the free form and its setting, what it depends on in words, the effect that is claimed.

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


def recovered_shapes(problem: Problem, selection: Selection) -> tuple[Shape, ...]:
    """Return the Shape of each member of a selection that has one.

    Single wrong readings have none, nor has what is the same at all values but for a sense of motion."""
    found = (_shape(problem, selection, place) for place in range(len(selection.members)))
    return tuple(shape for shape in found if shape is not None)


def _shape(problem: Problem, selection: Selection, place: int) -> Shape | None:
    member, rest = selection.members[place], problem.select(selection.without(place))
    form = member if isinstance(member.effect, FreeForm) else _best_form(problem, rest, member)
    if form is None or not isinstance(form.effect, FreeForm):
        return None
    course = form.effect.course(problem.run, form.setting)
    raw = np.moveaxis(form.effect.columns(problem.run, form.setting), -1, 0).astype(float)
    size = np.linalg.norm(raw.reshape(len(raw), -1), axis=1)
    rows = np.asarray(problem.project(raw), dtype=float).reshape(len(raw), -1) / size[:, None]
    rows = rows - (rows @ rest.rows.T) @ rest.rows
    value, vector = np.linalg.eigh(rows @ rows.T)
    seen = value > HIDDEN_SHARE**2
    root = vector[:, seen] / np.sqrt(value[seen]) / size[:, None]  # root root' is the cofactor matrix
    whole = problem.select((*rest.members, form))
    left = max(problem.dof - len(whole.rows) - searched_count(whole.members), 1)
    sigma = problem.scale * np.sqrt(whole.rss / left)
    solve = root @ (vector[:, seen] / np.sqrt(value[seen])).T @ rows * problem.scale
    amplitudes = [solve @ rest.residual]
    if member.named:
        amplitudes.append(solve @ (rest.residual - selection.residual))
    where = np.flatnonzero(course.where)
    at = where[np.unique(course.values[where], return_index=True)[1]]
    at = at[np.unique(np.linspace(0, at.size - 1, MOST_POINTS).round().astype(int))]
    basis = np.array(course.basis)
    basis = (basis - basis[:, where].mean(axis=1, keepdims=True))[:, at]
    if not np.any(np.abs(basis) > CONSTANT):
        return None
    curves = []
    labels = [(axis, carrier) for axis in directions(form.setting.word('axes')) for carrier in course.carriers or ('',)]
    for k, (axis, carrier) in enumerate(labels):
        own = slice(k * len(basis), (k + 1) * len(basis))
        both = [amplitude[own] @ basis for amplitude in amplitudes]
        u = sigma * np.linalg.norm(root[own].T @ basis, axis=0)
        curves.append(ShapeCurve(axis, carrier, both[0], u, both[1] if member.named else None))
    return Shape(form.name, form.setting, form.effect.describe(form.setting, axes_words(problem.run)),
                 member.name if member.named else '', course.name, course.unit, course.values[at], tuple(curves))


def _best_form(problem: Problem, rest: Selection, member: Member) -> Member | None:
    """Return the free form of the variables of a claim that explains most for what it costs."""
    made = [problem.member(FREE_FORMS[name], setting, 1.0)
            for name, setting in forms_beside(problem.run, member.effect, member.setting)]
    if member.name == 'outlier':
        return None
    return max((one for one in made if one is not None),
               key=lambda one: problem.select((*rest.members, one)).score, default=None)


def strongest(shape: Shape, most: int) -> Sequence[ShapeCurve]:
    """Return those curves of a shape that stand out most from their uncertainty, in the order of the shape."""
    ranked = sorted(shape.curves, key=lambda one: -float(np.mean((one.value / np.maximum(one.u, 1e-300))**2)))[:most]
    return [one for one in shape.curves if one in ranked]

# SPDX-License-Identifier: Apache-2.0
"""What the runs of a cell say of it, in words."""

from collections.abc import Iterable, Sequence

from rosette_ros.core.effects.composed import LAWS
from rosette_ros.core.effects.effect import PhysicalEffect
from rosette_ros.core.joint.cell_diagnosis import CellCause, CellDiagnosis, CommonConstant, SizeChange
from rosette_ros.core.run.number_words import micrometres
from rosette_ros.core.sight.limits import LISTED
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.words.effect_words import capital, decimals, fixed, names, scale_of, title_of
from rosette_ros.words.motion_words import MOST, MOVES, VERBS, chance, member_words, titles, with_words

CONDITIONS = {'date': ('from day to day', 'day'), 'temperature': ('with the mean temperature of the run', 'K'),
              'load': ('with the load on the table', 'kg')}
"""By what sizes change, and per which unit."""


def cell_words(found: CellDiagnosis) -> tuple[str, ...]:
    """Return what is said of a cell, a sentence each."""
    count = len(found.runs)
    out = [f'{capital(cause_words(one))}, in {runs_words(one.expected)} of {one.judged} runs.'
           for one in found.properties]
    out = out or [f'Nothing that these {count} runs can show comes again.']
    out += [f'{capital(change_words(one, change))}.' for one in found.properties for change in one.changes]
    out += [f'Once only: {once_words(found, one)}.' for one in found.once]
    if found.doubtful:
        out.append('Possible: ' + names(
            f'{cause_words(one, short=True)} ({chance(one.again)})' for one in found.doubtful) + '.')
    if found.hidden:
        out.append(f'None of these runs could have shown {titles(found.hidden)}.')
    return tuple(out)


def cause_words(one: CellCause, short: bool = False) -> str:
    """Return what moves with what and, but for short, by which laws.

    'the probe moves with time (99 %), most likely linear probe drift (61 %)'"""
    what = moves_words(one)
    if short:
        return what
    laws = [(name, p) for name, p in one.laws if p >= LISTED][:MOST] or one.laws[:1]
    said = ', '.join(f'{law_words(name)} ({chance(p)})' for name, p in laws)
    constants = constants_words(one.constants)
    return f'{what} ({chance(one.again)}), most likely {said}{f" with {constants}" if constants else ""}'


def moves_words(one: CellCause) -> str:
    """Return what moves with what."""
    effect = LAWS.get(one.name)
    if isinstance(effect, PhysicalEffect):
        return f'{MOVES[type(effect.motion)]} {with_words(one.variables)}'
    body = next(iter(one.bodies), '')
    return f'{VERBS[body]} {with_words(one.variables)}' if body in VERBS else member_words(one.name)


def law_words(name: str) -> str:
    """Return a law by its title, or that it is not in the library."""
    return title_of(name) if name in LAWS else member_words(name)


def constants_words(every: Sequence[CommonConstant]) -> str:
    """Return the constants of a law, each with U: 'tau 14.2 ± 3.1 min'."""
    return names(_constant(one) for one in every) if every else ''


def _constant(one: CommonConstant) -> str:
    scale = scale_of(one.unit, one.name)
    if not one.u:
        return f'{one.name} {one.value:g}'
    spread = COVERAGE_FACTOR * scale.factor * one.u
    places = decimals(spread)
    return f'{one.name} {fixed(scale.factor * one.value, places)} ± {fixed(spread, places)} {scale.unit}'.rstrip()


def runs_words(expected: float) -> str:
    """Return an expected number of runs: 5, or 4.3 where that is no whole number."""
    return fixed(expected, 0) if abs(expected - round(expected)) < 0.05 else fixed(expected, 1)


def once_words(found: CellDiagnosis, one: CellCause) -> str:
    """Return what was there in some runs, and comes not again: 'slip of the plate in run 3 (98 %)'."""
    where = [f'{run} ({chance(each.p)})' for run, each in zip(found.runs, one.in_runs) if each.p > 0.5]
    return f'{law_words(one.name)} in {names(where)}'


def change_words(one: CellCause, change: SizeChange) -> str:
    """Return how the size of a cause changes with a condition."""
    how, unit = CONDITIONS.get(change.condition, (f'with the {change.condition}', 'unit'))
    return (f'{law_words(one.name)} changes {how}: by {micrometres(change.slope)} '
            f'(U = {micrometres(COVERAGE_FACTOR * change.u)}) rms per {unit}')


def order_words(hidden: Iterable[str], order: str) -> str:
    """Return which order of measurement would show what none of the runs could."""
    return f'Order {order} would show {titles(hidden)}.'

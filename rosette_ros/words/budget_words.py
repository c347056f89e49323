# SPDX-License-Identifier: Apache-2.0
"""What an uncertainty budget does not consider, in words."""

from collections.abc import Callable, Mapping, Sequence

from rosette_ros.core.uncertainty.budget_inputs import BOUNDS, SECTIONS
from rosette_ros.core.uncertainty.uncertainty_budget import Budget, BudgetGap


def not_considered(made: Budget) -> tuple[str, ...]:
    """Return what a budget does not consider, a sentence each."""
    return tuple(_SAYS[one.kind](**one.numbers) for one in made.open)


def _not_stated(sections: Sequence[str]) -> str:
    return f'No value is stated for: {", ".join(f"{SECTIONS[one][0]} ({one})" for one in sections)}.'


def _hidden(environment: str) -> str:
    beyond = f', beyond what the environment states ({environment})' if environment else ''
    return f'Effects that this order of measurement hides{beyond}.'


def _unbounded(effects: Sequence[str]) -> str:
    return (f'Effects that this order hides altogether and that would change the curves: {", ".join(effects)}; state a '
            f'largest size ({BOUNDS}).')


def _with_reasons(reasons: Mapping[str, str]) -> str:
    return '; '.join(f'{name} ({reason})' for name, reason in reasons.items())


_SAYS: Mapping[str, Callable[..., str]] = {
    BudgetGap.MODEL: lambda doubt: f'What the model lacks: {doubt}.',
    BudgetGap.NOT_STATED: _not_stated,
    BudgetGap.TOUCHES: lambda: (
        'The scatter of single touches (touches) is not recorded; it is part of the repeatability.'),
    BudgetGap.HIDDEN: _hidden,
    BudgetGap.UNBOUNDED: _unbounded,
    BudgetGap.STATED_IN_NO_LINE: lambda reasons: (
        'Effects of stated size that are in no line, as the run does not tell what they do to the curves: '
        f'{_with_reasons(reasons)}.'),
    BudgetGap.NOT_JUDGED: lambda reasons: f'Effects that cannot be judged: {_with_reasons(reasons)}.',
    BudgetGap.HARMONICS: lambda order: (
        f'Harmonics of the errors above {order}: the table positions do not sample them.')}

# SPDX-License-Identifier: Apache-2.0
"""All runs of an archive under two models, in words."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from rosette_ros.core.diagnosis.verdict import CERTAIN
from rosette_ros.core.run.errors import counted
from rosette_ros.invocation import command


def no_trends(least: int) -> tuple[str]:
    """Return that no table has enough runs; least: of a trend."""
    return (f'No table has {least} dated runs under both models: trends are not compared.',)


def trends(tables: int, both: int, first: int, second: int, altered: int, slopes: int) -> tuple[str, str]:
    """Return how trends alter.

    both, first, second: changes under both models, and under one alone; altered: of so many slopes, by more than U."""
    return (f'Of the trends of {counted(tables, "table")}: {counted(both, "change")} under both models, {first} '
            f'under the first alone, {second} under the second alone.',
            f'The slope of an error in time alters by more than U in {altered} of {slopes} curves.')


def not_evaluated(failed: int, folder: str | Path) -> tuple[str]:
    """Return how many runs could not be evaluated, and what lists them."""
    problems = command('archive', 'query', folder, '--problems')
    return (f'{counted(failed, "run")} could not be evaluated under both models: {problems}',)


def no_changes() -> tuple[str]:
    """Return that there is nothing to compare."""
    return ('No run was evaluated under both models.',)


def changes(runs: int, falls: int, most: str, moved: int) -> tuple[str, str]:
    """Return in how many runs the residual falls by more than 10 %, in which most, and curves move by more than U."""
    where = f', most in {most}' if most else ''
    return (f'The residual falls by more than 10 % in {falls} of {runs} runs{where}.',
            f'The curves move by more than U (k = 2), the larger one of both models, in {moved} of {runs} runs.')


def effect(name: str, is_searched: bool, had: int, runs: int, dates: Sequence[datetime]) -> str:
    """Return in how many runs an effect is there, and when; is_searched: whether its place was searched."""
    days = sorted({f'{one:%Y-%m-%d}' for one in dates})
    span = '' if not days else f', measured on {days[0]}' if len(days) == 1 else (
        f', measured from {days[0]} to {days[-1]}')
    if is_searched:
        return (f'{name} has a parameter of {CERTAIN} standard uncertainties in {had} of {runs} runs{span}; whether '
                'it is there is told by rosette diagnose, which counts that its place was searched.')
    return (f'{name} is there for certain (a parameter of {CERTAIN} standard uncertainties) in {had} of {runs} '
            f'runs{span}.')

# SPDX-License-Identifier: Apache-2.0
"""Causes that are not single shapes of the library: named, look-alike said, told as a free form, or named wrongly?"""

from argparse import Namespace
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.blind.answers import PLACE, Answer, Record, ask, told_axes, told_variables
from benchmarks.blind.cause import Cause
from benchmarks.blind.foreign_causes import BEYOND, CAUSES, EVERY
from benchmarks.blind.library_effects import remaining, scaled, situation, visible_part
from benchmarks.blind.noise_kinds import AXES, chosen
from benchmarks.blind.noise_table import NOT_WHITE
from benchmarks.blind.proportion import share
from benchmarks.blind.runs import SIGMA, Plan, machine_config, measure, noisy
from rosette_ros.core.geometry import rotate_z
from rosette_ros.core.records import Floats, Run
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.hidden import Draw, acting

NAME = 'causes'
KNOWN = (*EVERY, 'beyond')
CLASSES = ('named', 'group', 'free form', 'unexplained', 'as noise', 'nothing', 'wrong')
HEADING = (f'| cause | σ | runs | {" | ".join(CLASSES)} (95 %) | alike in this run | wrong names |\n'
           '|---|---|---|---|---|---|---|---|---|---|---|---|')
ALIKE = 4.0
"""A shape of which less than this norm is left of the cause, in σ, describes it: noise does not show the difference."""
AXIS_SEEN = 2.0
"""An axis of which less than this norm is visible, in σ, is not one of the cause."""

Axes = dict[str, dict[str, float]]


class MachineWithCause(Machine):
    """A machine with a cause that its configuration cannot express."""

    def __init__(self, config: MachineConfig, cause: Cause) -> None:
        """Build the machine of a configuration."""
        super().__init__(config)
        self._acting = acting([cause])


def tasks(arguments: Namespace) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the group and the arguments of `trial` of every run."""
    for kind in chosen(arguments.causes, CAUSES, BEYOND):
        for strength in arguments.strength or (16.0, 40.0):
            for order in arguments.orders:
                for seed in arguments.seeds:
                    yield f'{kind}, {strength:g}', (kind, strength, Plan(arguments.n, order, seed,
                                                    EVERY[kind].turning), arguments.beside, arguments.stated != 'no')


def displaced(kind: str, made: Plan, strength: float, sigma: Sequence[float] = (1, 1, 1)
              ) -> tuple[Cause, Run, float, Floats | None]:
    """Return a cause, the run without noise or cause, the visible share, and the displacement by the cause, (N, 3), m.

    sigma: standard deviation of each axis. The displacement is None where the order hides the cause.
    """
    config = machine_config(made.seed, made.n).changed(**EVERY[kind].groups)
    machine = Machine(config)
    clean = measure(machine, made)[0]
    cause = EVERY[kind].draw(Draw(made.generator('cause', kind), 1.0, situation(machine, clean)))
    shift = measure(MachineWithCause(config, cause), made)[0].centre - clean.centre
    return cause, clean, *scaled(clean, shift, strength, sigma)


def trial(kind: str, strength: float, made: Plan, beside: str, stated: bool) -> Record:
    """Return the record of one run that hides a cause."""
    cause, clean, seen, shift = displaced(kind, made, strength, AXES.get(beside, (1, 1, 1)))
    head = {'hidden': kind, 'strength': strength, 'share': seen, 'noise': beside, 'stated': stated, **asdict(made)}
    if shift is None:
        return {**head, 'judged': 'not observable'}
    run = cause.recorded(noisy(clean, made, beside, stated, shift, kind)[0])
    answer, found = ask(run)
    left = remaining(run, found, shift)
    axes = visible_axes(clean, shift)
    return {**head, 'judged': judged(cause, answer, left, axes), 'left': left, 'axes': axes, **asdict(answer)}


def visible_axes(clean: Run, shift: Floats) -> Axes:
    """Return the visible norm of a displacement along each axis of each frame, in σ."""
    seen = visible_part(clean, shift)
    frames = {'machine': seen, 'plate': rotate_z(-clean.phi, seen), 'polar': rotate_z(-clean.alpha, seen)}
    return {frame: dict(zip('xyz', (np.linalg.norm(part, axis=0) / SIGMA).tolist())) for frame, part in frames.items()}


def judged(cause: Cause, answer: Answer, left: float, axes: Axes) -> str:
    """Return the class of an answer, one of CLASSES.

    left: norm of what the claims cannot describe of the cause, in σ; axes: as visible_axes returns them.
    """
    if not answer.claims:
        if not answer.unexplained:
            return 'as noise' if NOT_WHITE in answer.sentence else 'nothing'
        return 'free form' if is_told(cause, answer.text, axes) else 'unexplained'
    allowed = {*cause.right, *cause.part, *(cause.family if left < ALIKE else ())}
    if all(claim.effect in allowed for claim in answer.claims):
        return 'named'
    if all(claim.effect in allowed or allowed & set(claim.alike) for claim in answer.claims):
        return 'group'
    return 'wrong'


def is_told(cause: Cause, text: str, axes: Axes) -> bool:
    """Return whether a text tells the variables of a cause and the axes along which most of it is seen."""
    told = told_variables(text)
    known = frozenset().union(*cause.variables, *(PLACE for one in cause.variables if len(one & PLACE) > 1))
    if not (told <= known and any(alternative <= told for alternative in cause.variables)):
        return False
    frame, along = told_axes(text)
    return any(_are_told(along, axes[name]) for name in ([frame] if frame else ['machine', cause.frame]))


def _are_told(along: set[str], seen: dict[str, float]) -> bool:
    """Return whether axes are those that matter, and none that is not seen."""
    most = {axis for axis, size in seen.items() if size > 0.5 * max(seen.values())}
    return most <= along <= {axis for axis, size in seen.items() if size > AXIS_SEEN}


def is_good(record: Record) -> bool:
    """Return whether nothing is named wrongly."""
    return record['judged'] not in ('wrong', 'failed')


def row(group: str, records: list[Record]) -> str:
    """Return the line of a group."""
    kind, strength = group.split(', ')
    seen = [record for record in records if record['judged'] != 'not observable']
    if not seen:
        return f'| {kind} | {strength} | not observable |' + ' |' * 9
    count = Counter(record['judged'] for record in seen)
    wrong = [record for record in seen if not is_good(record)]
    names = Counter(' + '.join(sorted({claim['effect'] for claim in record.get('claims', ())})) for record in wrong)
    said = ', '.join(f'{name} {many}' for name, many in names.most_common(3))
    alike = sum(record.get('left', np.inf) < ALIKE for record in wrong)
    return (f'| {kind} | {strength} | {len(seen)} | {" | ".join(str(count[one]) for one in CLASSES[:-1])} | '
            f'{share(len(wrong), len(seen)).replace(" | ", ", ")} | {alike} | {said} |')


def total(groups: dict[str, list[Record]]) -> str:
    """Return the line under the table."""
    out = []
    for strength in dict.fromkeys(group.split(', ')[1] for group in groups):
        seen = [record for group, records in groups.items() if group.endswith(f', {strength}') for record in records
                if record['judged'] != 'not observable']
        count = Counter(record['judged'] for record in seen)
        out.append(f'At {strength} σ, {len(seen)} runs: ' + ', '.join(f'{one} {count[one]}' for one in CLASSES)
                   + f'; wrong {share(len(seen) - sum(map(is_good, seen)), max(len(seen), 1)).split(" | ")[1]}; '
                   f'told without a name {count["free form"] + count["unexplained"]}, truly {count["free form"]}')
    return '\n'.join(out)

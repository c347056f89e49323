# SPDX-License-Identifier: Apache-2.0
"""A question to an archive that most ask, as a condition in SQL."""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.effects.composed import effect
from rosette_ros.core.run.errors import InvalidData, unknown_name

_MODEL = ("coalesce(nullif(array_to_string([e.effect for e in effects if e.in_model], ' + '), ''), 'base') || ' (' || "
          "left(model_hash, 12) || ')'")
SERIAL = {'table': 'table_serial', 'plate': 'plate_serial', 'cmm': 'cmm_serial', 'cell': 'cell', 'place': 'place',
          'level': 'level'}
"""What a ready question may ask for: word, and its column."""


@dataclass(frozen=True)
class Question:
    """A ready question. equal: values by the word, of SERIAL; since, until: days or times in ISO 8601, UTC; effect: in
    the model or named by the diagnosis, with its parameters; problems: logs without an evaluation; model: hash of the
    model, or its beginning."""

    equal: Mapping[str, str]
    since: str = ''
    until: str = ''
    effect: str = ''
    problems: bool = False
    model: str = ''

    def condition(self) -> tuple[str, list[Any]]:
        """Return the condition in SQL on `runs` and its values; raises InvalidData and InvalidModel (see `ask_for`)."""
        if (level := self.equal.get('level')) and level not in set(Level):
            raise InvalidData(unknown_name('level', level, tuple(map(str, Level))))
        parts, values = [f"problem {'<>' if self.problems else '='} ''"], list[Any]()
        for word, value in self.equal.items():
            parts, values = [*parts, f'{SERIAL[word]} = ?'], [*values, value]
        for value, sign in ((self.since, '>='), (self.until, '<')):
            if value:
                parts, values = [*parts, f'measured_at {sign} ?'], [*values, _time(value)]
        if self.model:
            parts, values = [*parts, 'starts_with(model_hash, ?)'], [*values, self.model]
        if self.effect:
            effect(self.effect)
            parts.append('(list_contains(missing, ?) OR list_contains([e.effect for e in effects], ?))')
            values += [self.effect] * 2
        return ' AND '.join(parts), values

    def sql(self) -> tuple[str, list[Any]]:
        """Return the question in SQL and its values."""
        condition, values = self.condition()
        if self.problems:
            return f'SELECT path, problem FROM runs WHERE {condition} ORDER BY path', values
        shown = ('measured_at, table_serial AS "table", cell, run_id AS run, n, 1e6 * rms_m AS rms_um, outcome, '
                 f"array_to_string(missing, ' + ') AS lacks, {_MODEL} AS model")
        if self.effect:
            shown += (", list_transform(flatten([e.parameters for e in effects if e.effect = ?]), lambda p: "
                      "format('{} = {:.4g}, U = {:.2g} {}', p.name, p.value, p.U, p.unit)) AS parameters")
            values = [self.effect, *values]
        return (f'SELECT {shown} FROM runs WHERE {condition} '
                'ORDER BY table_serial, measured_at, run_id', values)


def _time(text: str) -> datetime.datetime:
    try:
        found = datetime.datetime.fromisoformat(text)
    except ValueError as error:
        raise InvalidData(f'expected a day or a time such as 2026-04-12, found {text!r:.40}') from error
    return found if found.tzinfo else found.replace(tzinfo=datetime.UTC)

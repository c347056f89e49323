# SPDX-License-Identifier: Apache-2.0
"""What no reading of a run tells, from files and a form: identity, tolerances, inputs of the uncertainty budget."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.uncertainty.budget_inputs import ENVIRONMENT, SECTIONS, BudgetInputs
from rosette_ros.io.budget_file import SCHEMA as INPUTS
from rosette_ros.io.budget_file import budget_inputs, format_inputs
from rosette_ros.io.identity_file import MOST_BYTES, Identity, folder_of, format_identity, parse_identity
from rosette_ros.io.identity_file import SCHEMA as IDENTITY
from rosette_ros.io.safe_yaml import parse_yaml
from rosette_ros.io.text_file import path_of, read_limited

OF_FILE = 'numbers of the cell'
"""The choice of an environment that a file states by numbers, which the form leaves as they are."""


@dataclass(frozen=True, eq=False)
class Stated:
    """What is stated of a run. budget: as in a file of inputs, {} for nothing; folder: of the pictures that the
    identity names."""

    identity: Identity = field(default_factory=Identity)
    budget: Mapping[str, Any] = field(default_factory=dict)
    folder: str = ''

    @cached_property
    def inputs(self) -> BudgetInputs | None:
        """The inputs of the uncertainty budget, None where nothing is stated."""
        return budget_inputs(self.budget, 'inputs') if self.budget else None

    @property
    def environment(self) -> str:
        """The class of environment, OF_FILE where it has numbers of its own, '' where none is stated."""
        given = self.budget.get(ENVIRONMENT) or {}
        return given.get('class', '') if not set(given) - {'class'} else OF_FILE

    @property
    def identity_text(self) -> str:
        """The identity as a file, '' where nothing is stated."""
        return format_identity(self.identity)

    @property
    def inputs_text(self) -> str:
        """The inputs as a file, '' where nothing is stated."""
        return format_inputs(self.budget) if self.budget else ''

    def with_file(self, data: bytes, name: str, folder: str = '') -> 'Stated':
        """Return this with what a file states, which its schema tells apart; raises InvalidData where it is neither."""
        given = parse_yaml(data, name, InvalidData)
        schema = given.get('schema') if isinstance(given, dict) else None
        if schema == IDENTITY:
            return replace(self, identity=parse_identity(data, name), folder=folder)
        if schema != INPUTS:
            raise InvalidData(f'{name}: expected "schema: {IDENTITY}" or "schema: {INPUTS}", found '
                              f'{schema or "neither"!s:.60}')
        budget_inputs(given, name)
        return replace(self, budget=given)

    def with_path(self, path: str) -> 'Stated':
        """Return this with what the file at a path states."""
        data = read_limited(path, 'a file of an identity or of inputs', MOST_BYTES)
        return self.with_file(data, path, str(folder_of(path_of(path))))

    def with_identity(self, entries: Mapping[str, str], tolerances: Mapping[str, str]) -> 'Stated':
        """Return this with another identity; entries: by section and name; raises InvalidData as a file does."""
        made = Identity(_filled(entries), _filled(tolerances), 'form')
        text = format_identity(made)
        return replace(self, identity=parse_identity(text.encode(), 'form') if text else Identity())

    def with_inputs(self, sections: Mapping[str, Mapping[str, float | str | None]], environment: str) -> 'Stated':
        """Return this with other inputs; sections: of SECTIONS, what is None or '' is not stated; environment: a class,
        OF_FILE for what is stated, '' for none. Raises InvalidData as a file does."""
        budget: dict[str, Any] = {'schema': INPUTS}
        for name in SECTIONS:
            if given := {key: one for key, one in sections.get(name, {}).items() if one not in (None, '')}:
                budget[name] = given
        budget |= {key: one for key, one in self.budget.items() if key not in (*SECTIONS, 'schema', ENVIRONMENT)}
        if environment:
            budget[ENVIRONMENT] = self.budget[ENVIRONMENT] if environment == OF_FILE else {'class': environment}
        budget_inputs(budget, 'form')
        return replace(self, budget=budget if len(budget) > 1 else {})


def _filled(entries: Mapping[str, str]) -> dict[str, str]:
    return {key: text.strip() for key, text in entries.items() if text and text.strip()}

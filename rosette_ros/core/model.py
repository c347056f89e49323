# SPDX-License-Identifier: Apache-2.0
"""A model: which base terms and which effects describe a run."""

import hashlib
import json
from dataclasses import dataclass, field

from rosette_ros.core.base import BASE_TERMS
from rosette_ros.core.effects.contract import Effect, Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.effects.library import effect as library_effect
from rosette_ros.core.effects.own import OwnTerm, own_term
from rosette_ros.core.errors import InvalidModel

SCHEMA = 'rosette-model/1'


@dataclass(frozen=True)
class Term:
    """An effect in a model with the searched parameters that the user has fixed."""

    effect: Effect
    fixed: Setting = field(default_factory=Setting)

    @property
    def name(self):
        """The name of the effect."""
        return self.effect.name

    def to_entry(self):
        """Return the term as it stands in a model file."""
        if isinstance(self.effect, OwnTerm):
            return self.effect.definition
        return {'name': self.name, **self.fixed} if self.fixed else self.name

    def __str__(self):
        """Return name and fixed parameters."""
        fixed = ', '.join(f'{key}={value:g}' if isinstance(value, float) else f'{key}={value}'
                          for key, value in sorted(self.fixed.items()))
        return f'{self.name}({fixed})' if fixed else self.name


@dataclass(frozen=True)
class Model:
    """Base terms (some of BASE_TERMS) and effects; prints itself as a sum.

    repeated allows an effect to stand more than once with the same fixed parameters.

    Raises InvalidModel for an unknown base term, an unknown setting, or an effect that stands
    twice with the same fixed parameters.
    """

    base: tuple[str, ...] = BASE_TERMS
    terms: tuple[Term, ...] = ()
    repeated: bool = False

    def __post_init__(self):
        """Put the base terms in order and refuse what makes no sense."""
        for term in self.base:
            if term not in BASE_TERMS:
                raise InvalidModel(
                    f'model: base: wanted some of {", ".join(BASE_TERMS)}, got {term!r}')
        object.__setattr__(self, 'base', tuple(t for t in BASE_TERMS if t in self.base))
        seen = set()
        for term in self.terms:
            term.effect.check_setting(term.fixed)
            if str(term) in seen and not self.repeated:
                raise InvalidModel(f'model: effect {term} stands twice; remove one')
            seen.add(str(term))

    @property
    def names(self):
        """Names of base terms and effects, a tuple of str."""
        return self.base + tuple(term.name for term in self.terms)

    def __str__(self):
        """Return the model as a sum of its terms."""
        return ' + '.join([*self.base, *map(str, self.terms)]) or 'nothing'

    @property
    def hash(self):
        """SHA-256 of the model, hex: equal for equal models."""
        text = json.dumps(self.to_mapping(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def with_effect(self, name, fixed=None):
        """Return the model with an effect (or base term) more."""
        if name in BASE_TERMS:
            if name in self.base:
                raise InvalidModel(f'model: {name} is in the model already')
            return Model((*self.base, name), self.terms)
        return Model(self.base, (*self.terms, Term(library_effect(name), Setting(fixed or {}))))

    def with_entry(self, entry):
        """Return the model with an entry as in a model file more: name, mapping or own term."""
        return Model(self.base, (*self.terms, _term(entry)))

    def without_effect(self, name):
        """Return the model without an effect (the last of that name) or base term."""
        if name in self.base:
            return Model(tuple(term for term in self.base if term != name), self.terms)
        places = [k for k, term in enumerate(self.terms) if name in (term.name, str(term))]
        if not places:
            raise InvalidModel(
                f'model: wanted one of {", ".join(self.names)} to remove, got {name!r}')
        return Model(self.base, self.terms[:places[-1]] + self.terms[places[-1] + 1:])

    def to_mapping(self):
        """Return the model as plain lists and dicts, schema rosette-model/1."""
        effects = [term.to_entry() for term in self.terms]
        return {'schema': SCHEMA, 'base': list(self.base), 'effects': effects}

    @staticmethod
    def from_mapping(mapping, source='model'):
        """Return the Model of plain lists and dicts; raise InvalidModel, naming `source`."""
        if not isinstance(mapping, dict):
            raise InvalidModel(f'{source}: wanted a mapping with base and effects, '
                               f'got {type(mapping).__name__}')
        unknown = set(mapping) - {'schema', 'base', 'effects'}
        if unknown:
            raise InvalidModel(f'{source}: wanted the keys schema, base, effects, '
                               f'got {sorted(map(str, unknown))[0]!r}')
        if mapping.get('schema', SCHEMA) != SCHEMA:
            raise InvalidModel(f'{source}: schema: wanted {SCHEMA}, got {mapping["schema"]!r}')
        base = mapping.get('base', list(BASE_TERMS))
        effects = mapping.get('effects') or []
        for key, value in (('base', base), ('effects', effects)):
            if not isinstance(value, list):
                raise InvalidModel(f'{source}: {key}: wanted a list, got {value!r}')
        try:
            return Model(tuple(base), tuple(_term(entry) for entry in effects))
        except InvalidModel as error:
            raise InvalidModel(f'{source}: {error}') from error


def _term(entry):
    if isinstance(entry, str):
        return Term(library_effect(entry))
    if isinstance(entry, dict) and 'own' in entry:
        effect = own_term(entry)
        if effect.name in EFFECTS or effect.name in BASE_TERMS:
            raise InvalidModel(f'own term: {effect.name} is the name of an effect of the library; '
                               'choose another')
        return Term(effect)
    if not isinstance(entry, dict) or not isinstance(entry.get('name'), str):
        raise InvalidModel(f'effects: wanted a name or a mapping with a name, got {entry!r}')
    fixed = {key: value for key, value in entry.items() if key != 'name'}
    return Term(library_effect(entry['name']), Setting(fixed))

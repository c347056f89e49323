# SPDX-License-Identifier: Apache-2.0
"""A model: which base terms and which effects describe a run."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rosette_ros.core.effects.composed import LAWS, effect
from rosette_ros.core.effects.custom import CustomTerm
from rosette_ros.core.effects.effect import Effect, Setting
from rosette_ros.core.model.experience import Experience
from rosette_ros.core.run.errors import InvalidModel, kind_of, unknown_name

SCHEMA = 'rosette-model/1'
BASE_TERMS = ('table_motions', 'plate_deviations', 'cmm_deviations')
KINDS_OF_NOISE = ('axes', 'tail', 'groups', 'wander')
"""In what the noise may be other than white and equal; what of it a run has is estimated."""
NOISE_TERMS = tuple(f'noise.{kind}' for kind in KINDS_OF_NOISE)
"""Their names in a model."""
Entry = str | dict[str, float | str]
"""A term as it stands in a model file: the name of an effect, or a mapping."""


@dataclass(frozen=True)
class Term:
    """An effect in a model with the searched parameters that are fixed.

    is_found: whether the search on the run fixed them, so that they are adjusted parameters of a fit all the same."""

    effect: Effect
    fixed: Setting = field(default_factory=Setting)
    is_found: bool = field(default=False, compare=False)

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.effect.name

    @property
    def is_open(self) -> bool:
        """Whether a number of its setting is left to the search, so that the same term again finds another place."""
        return any(one.unit and one.name not in self.fixed for one in self.effect.searched)

    def to_entry(self) -> Entry:
        """Return the term as it stands in a model file."""
        if isinstance(self.effect, CustomTerm):
            return {**self.effect.to_mapping()}
        return {'name': self.name, **self.fixed} if self.fixed else self.name

    @staticmethod
    def from_entry(entry: object) -> 'Term':
        """Return the term of an entry of a model file; raise InvalidModel."""
        if isinstance(entry, str):
            return Term(effect(entry))
        if isinstance(entry, Mapping) and 'own' in entry:
            custom = CustomTerm.from_mapping(entry)
            if custom.name in LAWS or custom.name in BASE_TERMS:
                raise InvalidModel(f'custom term: {custom.name} is the name of a library effect; choose another')
            return Term(custom)
        if not isinstance(entry, Mapping) or not isinstance(entry.get('name'), str):
            raise InvalidModel(f'effects: expected a name or a mapping with a name, found {entry!r}')
        fixed = {key: value for key, value in entry.items() if key != 'name'}
        return Term(effect(entry['name']), Setting(fixed))

    def __str__(self) -> str:
        fixed = ', '.join(f'{key}={value:g}' if isinstance(value, float) else f'{key}={value}'
                          for key, value in sorted(self.fixed.items()))
        return f'{self.name}({fixed})' if fixed else self.name


@dataclass(frozen=True)
class Model:
    """Base terms (some of BASE_TERMS), effects and what the noise may be; prints itself as a sum.

    noise: some of NOISE_TERMS, none for white noise; experience: what earlier runs of the cell have taught of what the
    model may lack, None where nothing is known, no part of model files and of the hash; repeated allows an effect of
    which nothing is searched to stand more than once with the same fixed parameters. Raises InvalidModel where it does
    without, and for an unknown base term or setting.
    """

    base: tuple[str, ...] = BASE_TERMS
    terms: tuple[Term, ...] = ()
    repeated: bool = False
    noise: tuple[str, ...] = NOISE_TERMS
    experience: Experience | None = None

    def __post_init__(self) -> None:
        for part, known in (('noise', NOISE_TERMS), ('base', BASE_TERMS)):
            names = getattr(self, part)
            for name in names:
                if name not in known:
                    raise InvalidModel(f'model: {part}: expected some of {", ".join(known)}, found {name!r}')
            object.__setattr__(self, part, tuple(name for name in known if name in names))
        seen = set()
        for term in self.terms:
            term.effect.check_setting(term.fixed)
            if str(term) in seen and not (self.repeated or term.is_open):
                raise InvalidModel(f'model: effect {term} is in it twice; remove one'
                                   f'{", or give one another setting" if term.effect.searched else ""}')
            seen.add(str(term))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of base terms and effects."""
        return self.base + tuple(term.name for term in self.terms)

    def __str__(self) -> str:
        noise = [] if self.noise == NOISE_TERMS else list(self.noise) or ['noise.white']
        return ' + '.join([*self.base, *map(str, self.terms), *noise]) or 'nothing'

    @property
    def hash(self) -> str:
        """SHA-256 of the model, hex: equal for equal models."""
        return hashlib.sha256(json.dumps(self.to_mapping(), sort_keys=True).encode()).hexdigest()

    def with_effect(self, name: str, fixed: Mapping[str, float | str] | None = None) -> 'Model':
        """Return the model with an effect, base term or kind of noise more; raise InvalidModel; fixed: of an effect."""
        if fixed and name in (*BASE_TERMS, *NOISE_TERMS):
            raise InvalidModel(f'model: {name} has no settings, found {", ".join(fixed)}; leave them out')
        if name in (*self.base, *self.noise):
            raise InvalidModel(f'model: {name} is in the model already')
        if name in BASE_TERMS:
            return replace(self, base=(*self.base, name))
        if name in NOISE_TERMS:
            return replace(self, noise=(*self.noise, name))
        return replace(self, terms=(*self.terms, Term(effect(name, (*BASE_TERMS, *NOISE_TERMS)), Setting(fixed or {}))))

    def with_entry(self, entry: object) -> 'Model':
        """Return the model with an entry of a model file more: name, mapping or custom term."""
        return replace(self, terms=(*self.terms, Term.from_entry(entry)))

    def without_effect(self, name: str) -> 'Model':
        """Return the model without an effect (the last of that name) or base term."""
        if name in self.base:
            return replace(self, base=tuple(term for term in self.base if term != name))
        if name in self.noise:
            return replace(self, noise=tuple(one for one in self.noise if one != name))
        places = [k for k, term in enumerate(self.terms) if name in (term.name, str(term))]
        if not places:
            raise InvalidModel(f'model: {unknown_name("effect", name, self.names)}')
        return replace(self, terms=self.terms[:places[-1]] + self.terms[places[-1] + 1:])

    def to_mapping(self) -> dict[str, str | list[str] | list[Entry]]:
        """Return the model as plain lists and dicts, schema rosette-model/1."""
        noise = {} if self.noise == NOISE_TERMS else {'noise': list(self.noise)}
        effects = [term.to_entry() for term in self.terms]
        return {'schema': SCHEMA, 'base': list(self.base), 'effects': effects, **noise}

    @staticmethod
    def from_mapping(mapping: object, source: str = 'model') -> 'Model':
        """Return the Model of plain lists and dicts; raise InvalidModel, naming `source`."""
        if not isinstance(mapping, dict):
            raise InvalidModel(f'{source}: expected a mapping with base and effects, found {kind_of(mapping)}')
        unknown = set(mapping) - {'schema', 'base', 'effects', 'noise'}
        if unknown:
            first = min(map(str, unknown))
            raise InvalidModel(f'{source}: expected the keys schema, base, effects, noise, found {first!r}')
        if mapping.get('schema', SCHEMA) != SCHEMA:
            raise InvalidModel(f'{source}: schema: expected {SCHEMA}, found {mapping["schema"]!r}')
        base = mapping.get('base', list(BASE_TERMS))
        effects = [] if mapping.get('effects') is None else mapping['effects']  # a key without a value: none
        noise = mapping.get('noise', list(NOISE_TERMS))
        for key, value in (('base', base), ('effects', effects), ('noise', noise)):
            if not isinstance(value, list):
                raise InvalidModel(f'{source}: {key}: expected a list, found {value!r}')
        try:
            return Model(tuple(base), tuple(map(Term.from_entry, effects)), noise=tuple(noise))
        except InvalidModel as error:
            raise InvalidModel(f'{source}: {error}') from error

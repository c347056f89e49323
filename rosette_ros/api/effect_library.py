# SPDX-License-Identifier: Apache-2.0
"""The library of effects, own effects and readers, and models made of effects."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosette_ros.api.measurement import model_of
from rosette_ros.api.result import Result, html_of
from rosette_ros.core.diagnosis.diagnosis import known_of
from rosette_ros.core.effects import library
from rosette_ros.core.effects.composed import LAWS, effect
from rosette_ros.core.effects.effect import Effect, PhysicalEffect, Quantity, Setting
from rosette_ros.core.effects.library import BASE_EFFECTS, EFFECTS
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.own_readers import READERS, Reader
from rosette_ros.presentation.json_output import effects_json
from rosette_ros.presentation.table_format import Table, words
from rosette_ros.words.effect_words import MEANINGS


def amplitudes(one: Effect) -> tuple[Quantity, ...]:
    """Return what is fitted at one setting of an effect; nothing for the parts of the base model."""
    if one.name not in LAWS:
        return ()
    example = planned_run(plan(12, 'random', turning='alternate'), 0.1825)
    return tuple(one.amplitudes(example, (*one.settings(example), Setting())[0]))


class EffectList(Result):
    """Effects of the library, the base terms first; chosen: they."""

    def __init__(self, chosen: tuple[Effect, ...]) -> None:
        self.chosen = chosen

    @property
    def names(self) -> tuple[str, ...]:
        """Their names, as models and files have them."""
        return tuple(one.name for one in self.chosen)

    def to_mapping(self) -> dict[str, Any]:
        return effects_json(self.chosen, {one.name: amplitudes(one) for one in self.chosen})

    def sentences(self) -> tuple[str, ...]:
        return tuple(f'{one.name}: {one.meaning}' for one in self.chosen)

    def _repr_html_(self) -> str:
        return html_of(self.tables()[0])

    def tables(self) -> tuple[Table, ...]:
        return (Table('library', 'Effects that a model may have and a diagnosis may name', (
            words('name', 'name', [one.name for one in self.chosen]),
            words('meaning', 'meaning', [one.meaning for one in self.chosen]),
            words('look', 'where to look', [one.look for one in self.chosen]),
            words('formula', 'formula', [one.formula for one in self.chosen]))),)


def effects(name: str | None = None) -> EffectList:
    """Return the library of effects, or one of them; raises InvalidModel, with the nearest name, where it is none."""
    return EffectList((*BASE_EFFECTS, *EFFECTS.values()) if name is None else (
        MEANINGS.get(name) or effect(name, tuple(MEANINGS)),))


def model(*names: str | PhysicalEffect, base: 'Model | str | Path | None' = None,
          settings: Mapping[str, Mapping[str, Any]] | None = None) -> Model:
    """Return the model of effects beside the base model, or beside another one.

    names: of the library, or effects added by `add_effect`; base: a model or its file; settings: fixed ones by name of
    the effect, in SI units. Raises InvalidModel."""
    made = model_of(base)
    for one in names:
        name = one if isinstance(one, str) else one.name
        made = made.with_effect(name, (settings or {}).get(name))
    return made


def add_effect(own: PhysicalEffect) -> None:
    """Add an effect of your own: models may name it, and diagnoses search for it from now on, in this process.

    An installed package adds it for every process by the entry point `rosette.effects`. Raises InvalidModel."""
    library.add_effect(own)
    known_of.cache_clear()


def add_reader(ending: str, reader: Reader) -> None:
    """Add a reader of your own for files with an ending such as 'xlsx', in this process.

    It returns a DataFrame, or (DataFrame, columns) as `read` takes them. An installed package adds it for every process
    by an entry point of `rosette.readers` whose name is the ending."""
    READERS[ending.lower().removeprefix('.')] = reader

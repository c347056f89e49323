# SPDX-License-Identifier: Apache-2.0
"""What may move in the cell of a run, as its user states it: a few numbers, each with its source; named classes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rosette_ros.core.model.experience import Experience, KnownCause


class Kind(NamedTuple):
    """A number of an environment: what moves, in words, and the unit in which it is stated, um or urad."""

    words: str
    unit: str = 'um'

    @property
    def si(self) -> str:
        """Its SI unit, m or rad."""
        return self.unit[1:]


KINDS = {
    'machine': Kind('machine against table'), 'table_zero': Kind('zero of the table angle', 'urad'),
    'table_tilt': Kind('tilt of the table axis', 'urad'), 'plate': Kind('plate and balls on the table'),
    'bearing': Kind('bearing of the table')}
"""The numbers of an environment: how far each moves in a run, as standard deviations from run to run."""


class Size(NamedTuple):
    """A standard deviation from run to run, m or rad, and whence it is."""

    value: float
    source: str


@dataclass(frozen=True, eq=False)
class Environment:
    """What may move in a run.

    name: of its class, or `stated`; sizes: by KINDS; effects: how far single effects of the library move a ball, m,
    which then have no part of those numbers; experience: what earlier runs of the cell have taught, whose rates and
    sizes take the place of what is stated of the effects that it knows, None where nothing is known."""

    name: str = 'stated'
    sizes: Mapping[str, Size] = field(default_factory=dict)
    effects: Mapping[str, Size] = field(default_factory=dict)
    experience: Experience | None = None

    def sized(self, name: str) -> KnownCause | None:
        """Return what experience knows of an effect, None where it knows no size of it."""
        known = self.experience.by_name.get(name) if self.experience else None
        return known if known and math.isfinite(known.size) else None


@dataclass(frozen=True)
class Unseen:
    """What U contains of what an order of measurement hides.

    environment: the name of the one that is stated, '' where none is: U is that of the readings alone then. curve: the
    one of which it is the largest part; alone, whole: U of its points by the readings alone, and with the environment
    or, where none is stated, with the class LABORATORY, m or rad; largest: the effect that is most of the difference,
    '' where there is none; share: of all effects that may be there in the variance of that curve."""

    environment: str
    curve: str
    alone: float
    whole: float
    largest: str
    share: float


def _class(name: str, *sizes: tuple[float, str]) -> Environment:
    """Return a class from numbers, µm or µrad, each with its source, in the order of KINDS."""
    return Environment(name, {kind: Size(1e-6 * value, source) for kind, (value, source) in zip(KINDS, sizes,
                                                                                               strict=True)})


CLASSES = {one.name: one for one in (
    _class('laboratory',
           (0.3, '0.25 m of steel that no scale follows, 0.1 K in a run; test: ISO 230-3, drift'),
           (0.5, '0.05 K across the encoder mount of steel; test: ISO 230-3, drift'),
           (0.5, '0.05 K across the bed of steel; test: ISO 230-3, drift'),
           (0.05, 'experience with plates that are clamped and soaked; test: a run repeated at once'),
           (0.05, 'experience with bearings of measuring tables; test: ISO 230-7, asynchronous error motion')),
    _class('workshop',
           (3.0, '0.25 m of steel that no scale follows, 1 K in a run; test: ISO 230-3, drift'),
           (5.0, '0.5 K across the encoder mount of steel; test: ISO 230-3, drift'),
           (5.0, '0.5 K across the bed of steel; test: ISO 230-3, drift'),
           (0.5, 'experience with plates that are handled; test: a run repeated at once'),
           (0.5, 'experience with rolling bearings; test: ISO 230-7, asynchronous error motion')))}
"""Environments for cells that have not been tested, by name: orders of magnitude, each with what it is worked out from
and the test that gives a value of the cell."""
LABORATORY = CLASSES['laboratory']

# SPDX-License-Identifier: Apache-2.0
"""A user's own term: direction times a safe expression, per what."""

from dataclasses import dataclass

import numpy as np

from rosette_ros.core.effects.contract import Effect, Quantity, radial, seconds, tangential, unit
from rosette_ros.core.effects.expression import evaluate, names_in, parse
from rosette_ros.core.effects.plate import plate_axes
from rosette_ros.core.effects.table import axial_tilts
from rosette_ros.core.errors import InvalidModel

PER = ('all', 'ball', 'table_position', 'cmm_position')
DIRECTIONS = {
    'x': lambda run: unit(0, run.size), 'y': lambda run: unit(1, run.size),
    'z': lambda run: unit(2, run.size), 'axial': lambda run: unit(2, run.size),
    'plate_x': lambda run: plate_axes(run)[..., 0],
    'plate_y': lambda run: plate_axes(run)[..., 1],
    'radial': lambda run: radial(run.alpha), 'tangential': lambda run: tangential(run.alpha),
    'tilt_x': lambda run: axial_tilts(run)[..., 0],
    'tilt_y': lambda run: axial_tilts(run)[..., 1],
}
"""Direction of an own term by name: machine, plate, radial, tangential, axial, tilt."""
_NEEDS = {'t': 'time', 'T': 'temperature', 'psi': 'table_travel', 'approach': 'approach'}


@dataclass(frozen=True)
class OwnTerm(Effect):
    """amplitude x direction x expression, one amplitude for all readings or one per group.

    direction: a key of DIRECTIONS; expression: in t, T, phi, beta, alpha, psi, approach; per: one of
    PER. Raises InvalidModel for an unknown direction, grouping or expression.
    """

    direction: str = 'z'
    expression: str = 't'
    per: str = 'all'

    def __post_init__(self):
        """Check the words and read the expression."""
        if self.direction not in DIRECTIONS:
            raise InvalidModel(f'own term {self.name}: direction: wanted one of '
                               f'{", ".join(DIRECTIONS)}, got {self.direction!r}')
        if self.per not in PER:
            raise InvalidModel(
                f'own term {self.name}: per: wanted one of {", ".join(PER)}, got {self.per!r}')
        try:
            tree = parse(self.expression)
        except InvalidModel as error:
            raise InvalidModel(f'own term {self.name}: {error}') from None
        needs = tuple(_NEEDS[name] for name in sorted(names_in(tree)) if name in _NEEDS)
        object.__setattr__(self, 'depends_on', needs)
        object.__setattr__(self, 'formula', f'{self.expression} along {self.direction}')
        object.__setattr__(self, 'meaning', "A user's own term.")

    @property
    def definition(self):
        """The term as a mapping for model files."""
        return {'own': self.name, 'direction': self.direction, 'expression': self.expression,
                'per': self.per}

    def _groups(self, run):
        if self.per == 'all':
            return [('', np.ones(run.size))]
        index = getattr(run, self.per)
        return [(f'_{k}', (index == k).astype(float)) for k in range(1, run.n + 1)]

    def amplitudes(self, run, setting):
        """Return one amplitude for all readings, or one per group, in units of the expression."""
        unit_name = 'rad' if self.direction.startswith('tilt') else 'm'
        return tuple(Quantity(f'a{suffix}', unit_name, f'amplitude of {self.expression}')
                     for suffix, _ in self._groups(run))

    def columns(self, run, setting):
        """Return direction times expression per group, (N, 3, q).

        Raises InvalidModel where the expression is not finite at some reading.
        """
        values = {'t': seconds(run), 'T': run.temperature - run.temperature[0], 'phi': run.phi,
                  'beta': run.beta, 'alpha': run.alpha,
                  'psi': run.table_travel - run.table_travel[0],
                  'approach': run.approach.astype(float), 'pi': np.pi}
        with np.errstate(all='ignore'):
            scalar = evaluate(parse(self.expression), values) * np.ones(run.size)
        if not np.all(np.isfinite(scalar)):
            place = int(np.flatnonzero(~np.isfinite(scalar))[0]) + 1
            raise InvalidModel(f'own term {self.name}: {self.expression} is not a finite number at '
                               f'reading {place}; change the expression')
        direction = DIRECTIONS[self.direction](run)
        return np.stack([(scalar * group)[:, None] * direction
                         for _, group in self._groups(run)], axis=-1)


def own_term(mapping):
    """Return the OwnTerm of a mapping with own, direction, expression and per; raise InvalidModel."""
    unknown = set(mapping) - {'own', 'direction', 'expression', 'per'}
    if unknown:
        raise InvalidModel(f'own term: wanted the keys own, direction, expression, per, '
                           f'got {sorted(map(str, unknown))[0]!r}')
    name = mapping.get('own')
    if not isinstance(name, str) or not name.isidentifier() or len(name) > 60:
        raise InvalidModel(f'own term: own: wanted a name of letters, digits and _, got {name!r}')
    for key in ('direction', 'expression'):
        if key not in mapping:
            raise InvalidModel(f'own term {name}: wanted the key {key}; it is missing')
    return OwnTerm(name=name, direction=mapping['direction'], expression=mapping['expression'],
                   per=mapping.get('per', 'all'))

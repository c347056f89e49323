# SPDX-License-Identifier: Apache-2.0
"""A custom term: a direction times a safe expression of a reading's quantities.

The text of an expression is parsed to a tree of which only numbers, known names, + - * / **, the functions of FUNCTIONS
and parentheses are allowed; the tree is walked, never compiled or executed. Length, depth and exponents are bounded, so
that the cost is too.
"""

import ast
import operator
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rosette_ros.core.effects import run_functions as on
from rosette_ros.core.effects.courses import Along
from rosette_ros.core.effects.effect import Course, Motion, PhysicalEffect, Quantity, Setting
from rosette_ros.core.run.errors import InvalidModel
from rosette_ros.core.run.records import Floats, Ints, Run

LONGEST = 300
DEEPEST = 30
LARGEST_POWER = 12

NAMES = {
    't': ('s', 'time since the first reading'),
    'T': ('K', 'temperature minus the first temperature'),
    'phi': ('rad', 'table angle'),
    'beta': ('rad', 'azimuth of the ball on the plate'),
    'alpha': ('rad', 'azimuth of the CMM position'),
    'psi': ('rad', 'cumulative table travel'),
    'approach': ('', 'sense of the last table move, +1 or -1'),
    'pi': ('', 'the number pi'),
}
GREEK = {'φ': 'phi', 'β': 'beta', 'α': 'alpha', 'ψ': 'psi', 'Ψ': 'psi', 'π': 'pi', 'Psi': 'psi'}
Function = Callable[..., Floats]
FUNCTIONS: dict[str, Function] = {
    'sin': np.sin, 'cos': np.cos, 'exp': np.exp, 'log': np.log, 'sqrt': np.sqrt, 'abs': np.abs, 'sign': np.sign,
    'tanh': np.tanh, 'step': lambda x: (x > 0) * 1.0}
_BINARY: dict[type[ast.operator], Function] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow}
_UNARY: dict[type[ast.unaryop], Function] = {ast.UAdd: operator.pos, ast.USub: operator.neg}

AMPLITUDE = 'Amplitude of a custom term: what it adds where its expression is 1, with t in s, T in K and angles in rad.'
PER = ('all', 'ball', 'table_position', 'cmm_position')
DIRECTIONS: dict[str, Callable[[Run], Floats]] = {
    'x': lambda run: on.along_machine(run)[0], 'y': lambda run: on.along_machine(run)[1],
    'z': lambda run: on.along_machine(run)[2],
    'axial': lambda run: on.unit(2, run.size),
    'plate_x': lambda run: on.plate_axes(run)[..., 0], 'plate_y': lambda run: on.plate_axes(run)[..., 1],
    'radial': lambda run: on.radial(run.alpha), 'tangential': lambda run: on.tangential(run.alpha),
    'tilt_x': lambda run: on.axial_tilts(run)[..., 0], 'tilt_y': lambda run: on.axial_tilts(run)[..., 1]}
"""Direction of a custom term by name: machine, plate, radial, tangential, axial, tilt."""
_NEEDS = {'t': 'time', 'T': 'temperature', 'psi': 'table_travel', 'approach': 'approach'}
_VARIABLES = {'t': 'time', 'T': 'temperature', 'phi': 'table angle', 'beta': 'ball', 'alpha': 'CMM position',
              'psi': 'travel', 'approach': 'table sense', 'ball': 'ball', 'table_position': 'table angle',
              'cmm_position': 'CMM position'}
"""Of what a reading a name of an expression is, or one amplitude per group."""


def parse(text: object) -> ast.expr:
    """Return the tree of an expression; raise InvalidModel for anything but arithmetic on what is known."""
    if not isinstance(text, str) or not text.strip():
        raise InvalidModel(f'expression: expected a text such as t*cos(3*alpha), found {text!r}')
    if len(text) > LONGEST:
        raise InvalidModel(f'expression: expected at most {LONGEST} characters, found {len(text)}; shorten it')
    for letter, name in GREEK.items():
        text = text.replace(letter, name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', SyntaxWarning)  # what is odd is refused below or harmless
            tree = ast.parse(text.strip().replace('^', '**'), mode='eval').body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InvalidModel(f'expression: {text!r} cannot be read; expected arithmetic such as t*cos(alpha)') from None
    _check(tree, 0)
    return tree


def names_in(tree: ast.expr) -> set[str]:
    """Return the names of quantities in a tree."""
    functions = {node.func.id for node in ast.walk(tree)
                 if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - functions


def evaluate(tree: ast.expr, values: Mapping[str, Floats | float]) -> Floats | float:
    """Return the value of a tree of `parse` for quantities by name, each (N,) or a number."""
    match tree:
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)  # divides by zero without an exception
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=op, operand=operand):
            return _UNARY[type(op)](evaluate(operand, values))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return FUNCTIONS[name](evaluate(argument, values))
        case ast.BinOp(left=left, op=operation, right=right):
            return _BINARY[type(operation)](evaluate(left, values), evaluate(right, values))
    raise TypeError(f'expected a tree of parse, found {ast.dump(tree)}')


def _check(node: ast.expr, depth: int) -> None:
    if depth > DEEPEST:
        raise InvalidModel(f'expression: expected at most {DEEPEST} nested levels, found more')
    inner: list[ast.expr] = []
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if abs(number) > 1e12:
                raise InvalidModel('expression: expected numbers up to 1e12, found a larger one')
        case ast.Name(id=name):
            if name not in NAMES:
                raise InvalidModel(f'expression: expected names among {", ".join(NAMES)}, found {name!r}')
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            inner = [operand]
        case ast.Call(func=ast.Name(id=name), args=inner, keywords=keywords):
            if name not in FUNCTIONS or len(inner) != 1 or keywords:
                raise InvalidModel(f'expression: expected functions of one argument among {", ".join(FUNCTIONS)}, '
                                   'found '
                                   f'{name!r}')
        case ast.BinOp(left=base, op=ast.Pow(), right=ast.Constant(value=int() | float() as power)) if (
                not isinstance(power, bool) and abs(power) <= LARGEST_POWER):
            inner = [base]
        case ast.BinOp(op=ast.Pow()):
            raise InvalidModel(f'expression: expected a number up to {LARGEST_POWER} as exponent')
        case ast.BinOp(left=left, op=operation, right=right) if type(operation) in _BINARY:
            inner = [left, right]
        case _:
            raise InvalidModel(f'expression: expected arithmetic on {", ".join(NAMES)} and the functions '
                               f'{", ".join(FUNCTIONS)}, found {ast.unparse(node)!r:.80}')
    for one in inner:
        _check(one, depth + 1)


@dataclass(frozen=True)
class NamedDirection(Motion):
    """A direction of DIRECTIONS, by its name."""

    stated = 'machine'
    name: str

    @property
    def body(self) -> str:  # type: ignore[override]
        if self.name in ('x', 'y', 'z'):
            return 'frame'
        return 'plate' if self.name in ('plate_x', 'plate_y', 'radial') else 'table axis'

    def direction(self, run: Run, part: Any) -> Floats:
        return DIRECTIONS[self.name](run)

    def amplitudes(self, run: Run, setting: Setting, one: Quantity) -> tuple[Quantity, ...]:
        return (Quantity(one.name, 'rad' if self.name.startswith('tilt') else 'm', one.meaning),)


@dataclass(frozen=True)
class Expression(Course):
    """An expression in NAMES, with one amplitude for all readings or one per group; term: whose it is."""

    term: str
    text: str
    per: str
    carries = 'shape'

    @property
    def variables(self) -> tuple[str, ...]:  # type: ignore[override]
        names = (*sorted(names_in(parse(self.text))), self.per)
        return tuple(dict.fromkeys(_VARIABLES[one] for one in names if one in _VARIABLES))

    @property
    def depends_on(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(_NEEDS[one] for one in sorted(names_in(parse(self.text))) if one in _NEEDS)

    def amplitudes(self, run: Run, setting: Setting, given: tuple[Quantity, ...], along: Along) -> tuple[Quantity, ...]:
        groups = [''] if self.per == 'all' else [f'_{k}' for k in range(1, run.n + 1)]
        return super().amplitudes(run, setting, tuple(
            Quantity(f'a{group}', 'm', f'amplitude of {self.text}') for group in groups), along)

    def waves(self, run: Run, settings: Sequence[Setting]) -> Floats:
        """Return the expression per group, (v, m, N); raise InvalidModel where it is not finite."""
        values: dict[str, Floats | float] = {
            't': on.seconds(run), 'T': on.temperature_change(run), 'phi': run.phi, 'beta': run.beta, 'alpha': run.alpha,
            'psi': on.travel(run), 'approach': run.approach.astype(float), 'pi': np.pi}
        with np.errstate(all='ignore'):
            scalar = evaluate(parse(self.text), values) * np.ones(run.size)
        if not np.all(np.isfinite(scalar)):
            place = int(np.flatnonzero(~np.isfinite(scalar))[0]) + 1
            raise InvalidModel(f'custom term {self.term}: {self.text} is not a finite number at reading {place}; '
                               'change the expression')
        if self.per == 'all':
            return np.tile(scalar, (len(settings), 1, 1))
        index: Ints = getattr(run, self.per)
        return np.tile(scalar * (index == np.arange(1, run.n + 1)[:, None]), (len(settings), 1, 1))


class CustomTerm(PhysicalEffect):
    """amplitude x direction x expression, one amplitude for all readings or one per group.

    direction: a key of DIRECTIONS; expression: in NAMES; per: one of PER. Raises InvalidModel for others.
    """

    def __init__(self, name: str, direction: object, expression: object, per: object = 'all') -> None:
        for key, value, known in (('direction', direction, DIRECTIONS), ('per', per, PER)):
            if not isinstance(value, str) or value not in known:
                raise InvalidModel(f'custom term {name}: {key}: expected one of {", ".join(known)}, found {value!r}')
        try:
            parse(expression)
        except InvalidModel as error:
            raise InvalidModel(f'custom term {name}: {error}') from None
        self.direction, self.expression, self.per = str(direction), str(expression), str(per)
        super().__init__(name, NamedDirection(self.direction), Expression(name, self.expression, self.per),
                         meaning='A term defined by the user.', formula=f'{expression} along {direction}')

    @staticmethod
    def from_mapping(mapping: Mapping[str, object]) -> 'CustomTerm':
        """Return the term of a mapping with own, direction, expression and per; raise InvalidModel."""
        unknown = set(mapping) - {'own', 'direction', 'expression', 'per'}
        if unknown:
            raise InvalidModel('custom term: expected the keys own, direction, expression, per, '
                               f'found {sorted(map(str, unknown))[0]!r}')
        name = mapping.get('own')
        if not isinstance(name, str) or not name.isidentifier() or len(name) > 60:
            raise InvalidModel(f'custom term: own: expected a name of letters, digits and _, found {name!r}')
        for key in ('direction', 'expression'):
            if key not in mapping:
                raise InvalidModel(f'custom term {name}: expected the key {key}; it is missing')
        return CustomTerm(name, *(mapping.get(key, 'all') for key in ('direction', 'expression', 'per')))

    def to_mapping(self) -> dict[str, str]:
        """Return the term as a mapping for model files."""
        return {'own': self.name, 'direction': self.direction, 'expression': self.expression, 'per': self.per}

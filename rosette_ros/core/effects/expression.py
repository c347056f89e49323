# SPDX-License-Identifier: Apache-2.0
"""Safe expressions of a reading's quantities: arithmetic and a few functions, nothing else.

The text is parsed to a tree of which only numbers, known names, + - * / **, comparisons-free
functions and parentheses are allowed; the tree is walked, never compiled or executed. Length, depth
and exponents are bounded, so that the cost is too.
"""

import ast
import operator
import warnings

import numpy as np

from rosette_ros.core.errors import InvalidModel

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
FUNCTIONS = {'sin': np.sin, 'cos': np.cos, 'exp': np.exp, 'log': np.log, 'sqrt': np.sqrt,
             'abs': np.abs, 'sign': np.sign, 'tanh': np.tanh, 'step': lambda x: (x > 0) * 1.0}
_BINARY = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
           ast.Div: operator.truediv, ast.Pow: operator.pow}
_UNARY = {ast.UAdd: operator.pos, ast.USub: operator.neg}


def parse(text):
    """Return the checked tree of an expression.

    Raises InvalidModel for anything but arithmetic on the known names and functions.
    """
    if not isinstance(text, str) or not text.strip():
        raise InvalidModel(f'expression: wanted a text such as t*cos(3*alpha), got {text!r}')
    if len(text) > LONGEST:
        raise InvalidModel(
            f'expression: wanted at most {LONGEST} characters, got {len(text)}; shorten it')
    for letter, name in GREEK.items():
        text = text.replace(letter, name)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', SyntaxWarning)  # what is odd is refused below or harmless
            tree = ast.parse(text.strip().replace('^', '**'), mode='eval').body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidModel(f'expression: cannot be read: {text!r}: {error}') from None
    _check(tree, 0)
    return tree


def names_in(tree):
    """Return the names of quantities in a tree, a set."""
    functions = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - functions


def evaluate(tree, values):
    """Return a tree's value for quantities by name, each (N,) or a number."""
    if isinstance(tree, ast.Constant):
        return np.float64(tree.value)
    if isinstance(tree, ast.Name):
        return values[tree.id]
    if isinstance(tree, ast.UnaryOp):
        return _UNARY[type(tree.op)](evaluate(tree.operand, values))
    if isinstance(tree, ast.Call):
        return FUNCTIONS[tree.func.id](evaluate(tree.args[0], values))
    left, right = evaluate(tree.left, values), evaluate(tree.right, values)
    return _BINARY[type(tree.op)](left, right)


def _check(node, depth):
    if depth > DEEPEST:
        raise InvalidModel(f'expression: wanted at most {DEEPEST} nested levels, got more')
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        if abs(node.value) > 1e12:
            raise InvalidModel('expression: wanted numbers up to 1e12, got a larger one')
        return
    if isinstance(node, ast.Name):
        if node.id not in NAMES:
            raise InvalidModel(f'expression: wanted names among {", ".join(NAMES)}, got {node.id!r}')
        return
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        _check(node.operand, depth + 1)
        return
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id not in FUNCTIONS or len(node.args) != 1 or node.keywords:
            raise InvalidModel(f'expression: wanted functions of one argument among '
                               f'{", ".join(FUNCTIONS)}, got {node.func.id!r}')
        _check(node.args[0], depth + 1)
        return
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        if isinstance(node.op, ast.Pow) and not (
                isinstance(node.right, ast.Constant) and type(node.right.value) in (int, float)
                and abs(node.right.value) <= LARGEST_POWER):
            raise InvalidModel(f'expression: wanted a number up to {LARGEST_POWER} as exponent')
        _check(node.left, depth + 1)
        _check(node.right, depth + 1)
        return
    raise InvalidModel('expression: wanted arithmetic on '
                       f'{", ".join(NAMES)} and the functions {", ".join(FUNCTIONS)}, '
                       f'got {type(node).__name__}')

# SPDX-License-Identifier: Apache-2.0
"""A custom term: what it may say, what it may not, and that it works."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import synthetic_run

from rosette_ros.core.effects.custom import LONGEST, CustomTerm, evaluate, parse
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidModel

VALUES = {'t': np.arange(3.0), 'T': 0.0, 'phi': 0.1, 'beta': 0.2, 'alpha': 0.3, 'psi': 0.5,
          'approach': 1.0, 'pi': np.pi}


@pytest.mark.parametrize('text, value', [
    ('t*cos(3*alpha)', np.arange(3.0) * np.cos(0.9)), ('-t**2 + 1', 1 - np.arange(3.0)**2),
    ('2^3', 8.0), ('sin(φ) + cos(β) * Ψ', np.sin(0.1) + np.cos(0.2) * 0.5),
    ('step(t - 1.5)', np.array([0.0, 0.0, 1.0])), ('exp(-t/(2*pi))', np.exp(-np.arange(3) / 2 / np.pi))])
def test_arithmetic(text, value):
    """Expressions mean what they say."""
    assert np.allclose(evaluate(parse(text), VALUES), value)


@pytest.mark.parametrize('text, words', [
    ('__import__("os").system("ls")', 'expected arithmetic on|expected functions of one'),
    ('t.__class__', "found 't.__class__'"), ('t[0]', r"found 't\[0\]'"), ('lambda: 1', "found 'lambda: 1'"),
    ('[1 for x in t]', 'for x in t'), ('open(t)', "among sin, .*, found 'open'"),
    ('time', "names among t, T, .*, found 'time'"), ('t**t', 'a number up to 12 as exponent'),
    ('t**999999', 'a number up to 12 as exponent'), ('sin(t, t)', 'functions of one argument'),
    ('"a"*9', "found .*'a'"), ('True + t', "found 'True'"), ('1e300 + t', 'numbers up to 1e12'),
    ('t +', 'cannot be read'), ('', 'expected a text'), ('t ' * 200, 'at most 300 characters'),
    ('-' * 50 + 't', 'at most 30 nested levels'), ('t if t else t', "found 't if t else t'"),
    ('t; t', 'cannot be read'), ('t := 3', 'cannot be read'), ('not t', "found 'not t'")])
def test_what_is_refused(text, words):
    """Anything but arithmetic on a reading's quantities is refused with words."""
    with pytest.raises(InvalidModel, match=words):
        parse(text)


@given(st.text(max_size=LONGEST + 20))
def test_no_text_does_anything_else(text):
    """Whatever is typed, it is an expression or one clear error."""
    try:
        tree = parse(text)
    except InvalidModel as error:
        assert str(error).startswith('expression: ')
        return
    with np.errstate(all='ignore'):
        evaluate(tree, VALUES)


def test_custom_term_finds_its_amplitude():
    """z = 2 nm/s t cos 3 alpha, added by hand, is found by the term of that form."""
    run, *_ = synthetic_run(7, 'random', 1)
    shift = 2e-9 * run.time * np.cos(3 * run.alpha)
    moved = run.replace(centre=run.centre + shift[:, None] * np.array([0, 0, 1.0]))
    model = Model().with_entry({'own': 'bed_ripple', 'direction': 'z', 'expression': 't*cos(3*α)'})
    result = fit(moved, model, (model.terms[0].fixed,))
    assert abs(result.effects[0].parameters[0].value - 2e-9) < 1e-13
    assert Model.from_mapping(model.to_mapping()) == model
    per_ball = Model().with_entry({'own': 'mine', 'direction': 'plate_x', 'expression': 't',
                                   'per': 'ball'})
    assert len(per_ball.terms[0].effect.amplitudes(run, {})) == 7


@pytest.mark.parametrize('mapping, words', [
    ({'own': 'a', 'direction': 'up', 'expression': 't'}, "direction: expected one of x, .*found 'up'"),
    ({'own': 'a', 'direction': 'z'}, 'expected the key expression; it is missing'),
    ({'own': 'a b', 'direction': 'z', 'expression': 't'}, 'expected a name of letters'),
    ({'own': 'a', 'direction': 'z', 'expression': 't', 'per': 'day'}, "per: expected one of all"),
    ({'own': 'a', 'direction': 'z', 'expression': 't', 'colour': 1}, "found 'colour'"),
    ({'own': 'a', 'direction': 'z', 'expression': 'os'}, "custom term a: expression: expected names"),
])
def test_bad_terms(mapping, words):
    """A term that makes no sense is refused with what was wanted."""
    with pytest.raises(InvalidModel, match=words):
        CustomTerm.from_mapping(mapping)


def test_infinite_values_are_named():
    """An expression that is not finite at a reading says at which."""
    run, *_ = synthetic_run(6)
    term = CustomTerm.from_mapping({'own': 'a', 'direction': 'z', 'expression': '1/t'})
    with pytest.raises(InvalidModel, match='1/t is not a finite number at reading 1'):
        term.columns(run, {})


def test_own_names_must_be_new():
    """A term may not take the name of an effect of the library."""
    with pytest.raises(InvalidModel, match='frame_drift is the name of a library effect'):
        Model().with_entry({'own': 'frame_drift', 'direction': 'z', 'expression': 't'})

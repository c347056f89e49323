# SPDX-License-Identifier: Apache-2.0
"""SI values as a person reads them."""

import math

import numpy as np
import pytest

from rosette_ros.core.effects.effect import Setting
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.advice import planned_run
from rosette_ros.core.run.axes import axis_rotation, taught_frame
from rosette_ros.core.run.number_words import SCALES, micrometres, multiple, p_value, significant
from rosette_ros.core.run.scheme import plan
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.formatting import model_words
from rosette_ros.words.effect_words import exact, fixed, names, plain, scale_of, setting_words


@pytest.mark.parametrize(('value', 'unit', 'name', 'shown', 'in_unit'), [
    (1e-6 / 3600, 'm/s', 'd_x', 1.0, 'µm/h'), (2e-6, 'm', 'a', 2.0, 'µm'),
    (3e-6 / 3600, 'rad/s', 'omega', 3.0, 'µrad/h'), (600.0, 's', 'tau', 10.0, 'min'),
    (5e-6, '1/K', 'epsilon', 5.0, 'ppm/K'), (1e-6 / 3600, '1/s', 'epsilon', 1.0, 'ppm/h'),
    (4 * math.pi, 'rad', 'psi0', 2.0, 'turns'), (0.43, '1', 'nu', 0.43, 'per turn'),
    (7.0, 'V', 'x', 7.0, 'V'),
])
def test_scales(value, unit, name, shown, in_unit):
    """One value per unit, worked out by hand."""
    scale = scale_of(unit, name)
    assert value * scale.factor == pytest.approx(shown)
    assert scale.unit == in_unit


def test_every_unit_of_the_library_is_known():
    """An effect with a new unit has to say how it is shown."""
    run = planned_run(plan(6, 'random', turning='alternate'), 0.1825)
    units = {quantity.unit for effect in EFFECTS.values()
             for quantity in (*effect.amplitudes(run, (*effect.settings(run), Setting())[0]),
                              *effect.searched)}
    assert units - {''} <= set(SCALES)


@pytest.mark.parametrize(('p', 'shown'), [
    (0.5, '0.5'), (0.0123, '0.012'), (4.2e-5, '4.2e−5'), (1e-9, '<1e−6'), (0.9999, '>0.99'), (math.nan, '–')])
def test_probabilities(p, shown):
    """Two significant digits between the limits."""
    assert p_value(p) == shown


@pytest.mark.parametrize(('shown', 'wanted'), [
    (fixed(-1.234, 1), '−1.2'), (fixed(-0.04, 1), '0.0'), (text.signed(-0.04, 1), '+0.0'),
    (text.signed(2, 1), '+2.0'), (plain(-1.234, 1), '-1.2'), (exact(51.428571, 3), '51.429'),
    (exact(-60.0, 3), '−60'), (micrometres(9.5e-8), '0.0950 µm'), (text.millimetres(0.1825), '182.5 mm'),
    (text.before_after(5.41e-7, 1.03e-7), '0.541 → 0.103'), (text.before_after(math.nan, math.nan), '–'),
    (text.at_least(0.0126, 3), '0.013'), (text.at_least(4e-4, 3), '<0.001'), (text.at_least(0.0, 3), '0'),
    (text.percent(0.834), '83 %'), (text.sigmas(3.14), '3.1 σ'), (text.sigmas(0.00098), '0.00098 σ'),
    (micrometres(7.36e-4), '736 µm'), (micrometres(1e-3), '1000 µm'),
    (micrometres(4.09e-11), '0.0000409 µm'),
    (micrometres(0), '0 µm'), (micrometres(9.999e-7), '1.00 µm'), (micrometres(-1e-18), '−1.00e−12 µm'),
    (significant(99999, 3), '99999'), (significant(math.nan), '–'), (multiple(1.073), '1.07'),
    (multiple(0.00098), '0.00098'), (multiple(7361.2), '7361'), (multiple(3e9), 'more than a million'),
    (setting_words('frame_warmup', {'tau': 1.2e6}), 'tau 20000 min'), (text.duration(41), '41 s'),
    (text.duration(6720), '1 h 52 min'), (names(['a', 'b', 'c']), 'a, b and c'),
    (text.repeatability_words(1.079e-7, 27), '0.1079 µm per coordinate, 27 degrees of freedom'),
    (text.repeatability_words(1e-7, None, (9e-8, 1e-7, 2.1e-7)),
     '0.1000 µm per coordinate (x 0.090, y 0.100, z 0.210 µm)')])
def test_numbers_have_minus_signs_and_units(shown, wanted):
    """Never −0; files keep the hyphen."""
    assert shown == wanted


def test_settings_have_units_and_words():
    """Seconds as minutes, whole numbers too; what cmm_reversal searches is said in words."""
    assert setting_words('frame_warmup', {'tau': 600, 'axes': 'xyz'}) == 'tau 10 min, axes xyz'
    assert setting_words('outlier', {'reading': 12345}) == 'reading 12345'
    assert setting_words('cmm_reversal', {'first': '+-'}) == 'before they turn back, x moves + and y −'
    assert setting_words('an effect of mine', {'first': 3, 'last': 2.5}) == 'first 3, last 2.5'
    assert setting_words('cmm_reversal', {'first': 'unknown'}) == 'the first senses of x and y are not known'
    warming = Model().with_effect('frame_warmup', {'tau': 600.0})
    assert model_words(warming).endswith(' + warm-up of the machine (tau 10 min)')


@pytest.mark.parametrize(('axis', 'words'), [
    ((0, 0, 1), ''), (None, ''), ((0.01, 0, 1), ''),
    ((1, 0, 0), 'the table axis is along x of the machine, an A axis in the ISO names; x, y, z are those of the table '
                'frame'),
    ((0, 0, -1), 'the table axis is along −z of the machine, a C axis in the ISO names, a minus sign: counted against '
                 'the axis of the machine; x, y, z are those of the table frame'),
    ((1, 0, 1), 'the table axis is oblique to the machine: in the ISO names X, Y, Z are the axes of the table frame, C '
                'is the table axis')])
def test_the_meaning_of_iso_names_is_told_where_it_is_not_plain(axis, words):
    """Nothing for a vertical axis."""
    rotation = axis and axis_rotation(axis)
    assert text.axis_note(rotation) == words
    assert text.axis_words(rotation).endswith(words)


def test_letters_that_are_turned_with_ball_1_are_told():
    """Beyond what an operator would call along an axis."""
    note = text.axis_note(taught_frame([0, 0, 0], [0, 1, 0], np.deg2rad(-40.0)).rotation)
    assert 'a B axis in the ISO names; the letters across the axis are turned by −40.0° as ball 1 is; x, y' in note


def test_names_of_both_standards():
    """A true minus sign for people."""
    assert text.curve_names(axis_rotation((0, -1, 0))) == (
        'ctx (EZB)', 'cty (−EXB)', 'ctz (−EYB)', 'crx (ECB)', 'cry (−EAB)', 'crz (−EBB)')
    assert text.iso_range(None) == 'EXC … ECC'
    assert text.axis_words(axis_rotation((1, 0, 0))).startswith(
        '(1.0000, 0.0000, 0.0000) in the machine, ball 1 at (0.0000, 1.0000, 0.0000); ')

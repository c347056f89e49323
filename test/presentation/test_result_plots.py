# SPDX-License-Identifier: Apache-2.0
"""The picture of the six curves: what is drawn where, in which unit."""

from dataclasses import replace

import numpy as np
import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import TWO_PI, clamping, nominal_angles
from rosette_ros.core.run.records import CURVES, ErrorMotions
from rosette_ros.presentation.formatting import clamping_words
from rosette_ros.presentation.plots.plot_style import save
from rosette_ros.presentation.plots.result_plots import Series, deviations, polar_motions, six_curves

N = 8
ISO = {'ctx': 'EXC', 'cty': 'EYC', 'ctz': 'EZC', 'crx': 'EAC', 'cry': 'EBC', 'crz': 'ECC'}


@pytest.fixture
def motions():
    """Curves in which every number differs from every other."""
    values = 1e-6 * np.arange(6 * N, dtype=float).reshape(N, 6)
    return ErrorMotions(nominal_angles(N), values, np.full((N, 6), 0.05e-6))


@pytest.mark.parametrize('low', [-2.0, -0.7, 0.3])
def test_an_axis_has_three_numbers_at_least(motions, low):
    """Whatever the curves span: two numbers do not show the scale between them."""
    panel = six_curves([Series('', motions)]).axes[0]
    for span in np.geomspace(0.01, 30, 60):
        panel.set_ylim(low, low + span)
        numbers = [one for one in panel.get_yticks() if low <= one <= low + span]
        assert 3 <= len(numbers) <= 7, (low, span, numbers)


def panels(made):
    """Return the axes by the name of the curve in their title."""
    return {axes.get_title(loc='left').split()[0]: axes for axes in made.axes}


def test_every_curve_has_its_panel_with_both_names_and_the_unit(motions):
    """Translations in µm above, rotations in µrad below; the unit stands at the first panel of a row."""
    found = panels(six_curves([Series('measured', motions)]))
    assert list(found) == list(CURVES)
    for curve, axes in found.items():
        assert axes.get_title(loc='left').startswith(f'{curve} ({ISO[curve]})')
    assert [axes.get_ylabel() for axes in found.values()] == ['µm', '', '', 'µrad', '', '']


def test_numbers_are_drawn_in_micro_units_against_degrees(motions):
    """The first point stands again a full turn later; the band is twice the standard u."""
    for curve, axes in panels(six_curves([Series('measured', motions)])).items():
        line = next(line for line in axes.lines if len(line.get_xdata()) == N + 1)
        np.testing.assert_allclose(line.get_xdata(), np.arange(N + 1) * 45.0)
        wanted = np.arange(N) * 6.0 + CURVES.index(curve)
        np.testing.assert_allclose(line.get_ydata(), np.append(wanted, wanted[0]))
        [band] = axes.collections
        heights = band.get_paths()[0].vertices[:, 1]
        assert heights.min() == pytest.approx(wanted.min() - 0.1)
        assert heights.max() == pytest.approx(wanted.max() + 0.1)


def test_a_band_that_is_much_wider_is_not_drawn(motions):
    """It would cover the panel: lines and narrow bands set the scale, the legend says so; alone, it is drawn."""
    wide = replace(motions, u=np.full((N, 6), 5e-6))
    made = six_curves([Series('final', motions), Series('base', wide)])
    words = [text.get_text() for text in made.legends[0].get_texts()]
    assert 'bands: U (k = 2); much wider ones are not drawn' in words
    for curve, axes in panels(made).items():
        first, last = CURVES.index(curve), CURVES.index(curve) + 6.0 * (N - 1)
        assert len(axes.collections) == 1
        assert axes.get_ylim() == pytest.approx((min(0.0, first - 0.1), last + 0.1), abs=0.06 * last)
    for axes in panels(six_curves([Series('one', wide)])).values():
        assert axes.get_ylim()[0] < -5.0


def test_the_plate_is_shown_as_if_it_lay_true_on_the_table():
    """Eccentricity, height, tilt and turn are removed and told; what each ball deviates by itself stays."""
    beta, radius = TWO_PI * np.arange(6) / 6, 0.18
    own = 1e-6 * np.stack([np.cos(2 * beta), -np.sin(2 * beta), np.sin(3 * beta + 0.4)], axis=-1)
    moved = own + [30e-6, 40e-6, 7e-6] + radius * np.stack(
        [-20e-6 * np.sin(beta), 20e-6 * np.cos(beta), 60e-6 * np.sin(beta)], axis=-1)
    shift, turn, freed = clamping(moved, radius)
    np.testing.assert_allclose(freed, own, atol=1e-15)
    assert clamping_words(shift, turn) == 'eccentricity 50.00 µm, height 7.00 µm, tilt 60.0 µrad, turn 20.0 µrad'
    made = deviations(np.where(np.arange(6)[:, None] == 2, np.nan, moved), own, radius)
    assert any('Removed from the plate: eccentricity' in text.get_text() for text in made.texts)
    assert made.axes[0].get_title(loc='left') == 'Ball plate, freed of eccentricity, tilt and turn'


def test_truth_and_several_runs_have_their_own_look_and_legend(motions):
    """One entry per line and band, none twice, no two runs alike."""
    made = six_curves([Series('first', motions), Series('second', motions)], 'title',
                      truth=motions.values)
    [legend] = made.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ['first', 'second', 'truth of the simulated machine', 'bands: U (k = 2)']
    first, second = legend.legend_handles[:2]
    assert first.get_color() != second.get_color()
    assert first.get_marker() != second.get_marker()
    red, green, blue, _ = legend.legend_handles[-1].get_facecolor()
    assert red == green == blue, 'the bands of all runs, not that of the first'


def test_polar_plots_have_the_reference_circle(motions):
    """Its centre is the once-per-turn part, its radius that of the circle of no deviation and the mean."""
    wave = np.cos(motions.angle - 0.5)
    panel = polar_motions(replace(motions, values=motions.values * 0 + 1e-6 * (1 + 2 * wave)[:, None])).axes[0]
    [circle] = [line for line in panel.lines if line.get_linestyle() == '--']
    [base] = [line for line in panel.lines if line.get_linewidth() == 0.9]
    (turn, radius), around = circle.get_data(), base.get_ydata()[0]
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    centre = np.array([(x.max() + x.min()) / 2, (y.max() + y.min()) / 2])
    assert np.arctan2(*centre[::-1]) == pytest.approx(0.5, abs=0.01)
    assert 2 * (np.ptp(x) / 2 - around) == pytest.approx(np.hypot(*centre), rel=0.01)


@pytest.mark.parametrize(('ending', 'begin'), [('png', b'\x89PNG'), ('svg', b'<?xml')])
def test_save(motions, tmp_path, ending, begin):
    """The ending says the format."""
    path = tmp_path / f'six.{ending}'
    save(six_curves([Series('measured', motions)]), path)
    assert path.read_bytes().startswith(begin)


def test_a_picture_that_cannot_be_written(motions, tmp_path):
    """In words."""
    with pytest.raises(InvalidData, match='cannot be written: No such file or directory'):
        save(six_curves([Series('measured', motions)]), tmp_path / 'nowhere' / 'six.png')

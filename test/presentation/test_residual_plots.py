# SPDX-License-Identifier: Apache-2.0
"""Pictures of residuals and deviations: which number is drawn where, in which unit."""

import numpy as np
import pytest
from figure_texts import faults, texts_of
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgb
from matplotlib.quiver import Quiver

from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import plan
from rosette_ros.presentation.plots.plot_style import DARK, FAINT, INK
from rosette_ros.presentation.plots.residual_plots import Residuals, against, histogram, residual_maps, section_means
from rosette_ros.presentation.plots.result_plots import deviations, scale_arrow

N = 6


@pytest.fixture
def run():
    """A complete run in a random order, 30 s a ball, slowly warming."""
    scheme = plan(N, 'random', 3)
    return Run(N, 0.1825, scheme.table_position, scheme.ball, scheme.centres(0.1825), time=30.0 * np.arange(N**2),
               temperature=20 + 0.001 * np.arange(N**2), repeatability=1e-7)


@pytest.fixture
def residuals(run):
    """Residuals that say where they belong: x the table position, y the ball, z the number; µm."""
    values = np.stack([run.table_position, run.ball, np.arange(run.size) / 10], axis=1)
    return Residuals('before', run, 1e-6 * values)


def test_maps_hold_each_reading_in_its_cell(residuals):
    """Rows table positions, columns balls, µm; all maps on one symmetric scale."""
    made = residual_maps([residuals, Residuals('after', residuals.run, 0.1 * residuals.values)])
    maps = [panel for panel in made.axes if panel.get_title().startswith('residual in')]
    assert [panel.get_title() for panel in maps] == [f'residual in {axis}' for axis in 'xyz'] * 2
    x, y = (panel.images[0].get_array() for panel in maps[:2])
    np.testing.assert_allclose(x, np.repeat(np.arange(1, N + 1)[:, None], N, axis=1))
    np.testing.assert_allclose(y, np.repeat(np.arange(1, N + 1)[None, :], N, axis=0))
    assert maps[3].images[0].get_array()[2, 0] == pytest.approx(0.3)
    assert {panel.images[0].get_clim() for panel in maps} == {(-6.0, 6.0)}
    assert [panel.get_xlabel() for panel in maps] == ['ball'] * 6
    assert maps[0].get_ylabel() == 'table position'


def test_dashed_lines_join_one_cmm_position(residuals):
    """k = (i + j - 2) mod n + 1: every cell on such a line has the number of the table position at its left end."""
    panel = residual_maps([residuals]).axes[0]
    [lines] = [one for one in panel.collections if isinstance(one, LineCollection)]
    numbers = {*map(int, panel.get_yticks())}
    assert numbers == {1, 3, 4, 5}
    for start, end in lines.get_segments():
        assert start.sum() == pytest.approx(end.sum())
        assert (round(start.sum()) - 2) % N + 1 in numbers


def test_signs_do_not_need_colour(run):
    """A bar lies in each negative cell that has a visible colour, white where that is dark, and in no other."""
    values = np.zeros((run.size, 3))
    values[:, 0] = 1e-6 * np.random.default_rng(1).uniform(-1, 1, run.size)
    row = Residuals('', run, values)
    grid, panel = row.grid()[..., 0], residual_maps([row]).axes[0]
    limit = np.abs(grid).max()
    for patch, low, high in zip(panel.patches, (FAINT, DARK), (DARK, 2), strict=True):
        ends = patch.get_path().vertices.reshape(-1, 2, 2)
        assert (ends[:, 0, 1] == ends[:, 1, 1]).all()
        x, y = (ends.mean(axis=1) - 1).round().astype(int).T
        marked = np.zeros(grid.shape, dtype=bool)
        marked[y, x] = True
        np.testing.assert_array_equal(marked, (grid < -low * limit) & (grid >= -high * limit))
    assert [patch.get_edgecolor()[:3] for patch in panel.patches] == [to_rgb(INK), to_rgb('white')]


def test_cells_that_were_not_measured_stay_empty(run):
    """NaN, not zero."""
    part = run.take(slice(0, 20))
    grid = Residuals('', part, np.zeros((20, 3))).grid()
    assert np.isnan(grid[..., 0]).sum() == N**2 - 20


def test_residuals_stand_against_time_angle_and_temperature(residuals):
    """Rows x, y, z; dots at every reading, in µm; the mean of neighbours as a line."""
    made = against([residuals], 1e-7)
    bottom = [panel.get_xlabel() for panel in made.axes[-3:]]
    assert bottom == ['time in minutes', 'table angle in degrees', 'temperature in °C']
    assert [panel.get_ylabel() for panel in made.axes[::3]] == ['x, µm', 'y, µm', 'z, µm']
    dots = made.axes[6].patches[-1].get_path().vertices[::2]
    np.testing.assert_allclose(dots[:, 0], 0.5 * np.arange(N**2))
    np.testing.assert_allclose(dots[:, 1], np.arange(N**2) / 10)
    assert faults(made) == []


def test_an_unknown_or_constant_temperature_has_no_column(residuals):
    """Nothing to see there."""
    for temperature in (np.nan, 20.0):
        run = residuals.run.replace(temperature=np.full(N**2, temperature))
        made = against([Residuals('', run, residuals.values)])
        assert [panel.get_xlabel() for panel in made.axes[-2:]] == ['time in minutes', 'table angle in degrees']


def test_section_means():
    """In order of the values, in equally full sections."""
    place, mean = section_means(np.array([3.0, 1.0, 2.0, 4.0, np.nan]), np.array([30.0, 10.0, 20.0, 40.0, 99.0]), 2)
    assert place.tolist() == [1.5, 3.5]
    assert mean.tolist() == [15.0, 35.0]


def test_histogram_counts_every_coordinate_and_draws_the_noise(run):
    """Bars add up to 3 N; the curve has the area of the bars and the width that the fit leaves."""
    values = 1e-7 * np.random.default_rng(1).standard_normal((run.size, 3))
    panel = histogram([Residuals('fit', run, values)], 1e-7, [60]).axes[0]
    counts = [patch.get_data().values for patch in panel.patches]
    assert {int(one.sum()) for one in counts} == {3 * N**2}
    [curve] = [line for line in panel.lines if 'noise' in line.get_label()]
    x, y = curve.get_data()
    width = np.diff(panel.patches[0].get_data().edges)[0]
    assert np.trapezoid(y, x) == pytest.approx(3 * N**2 * width, rel=0.01)
    spread = np.sqrt(np.trapezoid(x**2 * y, x) / np.trapezoid(y, x))
    assert spread == pytest.approx(0.1 * np.sqrt(60 / 108), rel=0.01)


def test_arrows_have_the_scale_that_is_written_beside_them():
    """The scale arrow is as long as its number says, in the same data units as the others."""
    rng = np.random.default_rng(2)
    cmm, angle = 1e-6 * rng.standard_normal((8, 3)), 2 * np.pi * np.arange(8) / 8
    place = 0.1825 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)])
    moves = np.stack([*(np.broadcast_to(one, (8, 3)) for one in np.eye(3)), *np.cross(np.eye(3)[:, None], place)])
    moves = moves.reshape(6, -1).T  # of the whole plate: eccentricity, height, tilt, turn
    plate = 2e-5 * rng.standard_normal(24)
    plate = (plate - moves @ np.linalg.lstsq(moves, plate)[0]).reshape(8, 3)
    made = deviations(plate, cmm, 0.1825)
    for panel, values in zip(made.axes[:2], (plate, cmm), strict=True):
        arrows = [one for one in panel.collections if isinstance(one, Quiver)]
        field = next(one for one in arrows if one.N == 8)
        np.testing.assert_allclose(np.stack([field.U, field.V], axis=1), 1e6 * values[:, :2])
        [words] = [text.get_text() for text in panel.texts if text.get_text().endswith(' µm')]
        ruler = next(one for one in arrows if one.N == 1)
        assert ruler.scale == field.scale
        assert ruler.U[0] == float(words.removesuffix(' µm'))
        up, down = [one for one in panel.collections if isinstance(one, PathCollection)]
        for balls, chosen in ((up, values[:, 2] >= 0), (down, values[:, 2] < 0)):
            np.testing.assert_allclose(balls.get_array(), 1e6 * values[chosen, 2])
            assert balls.get_clim()[0] == -balls.get_clim()[1]
        tips = [one.get_paths()[0].vertices[:, 1] for one in (up, down)]
        assert abs(tips[0].max()) > abs(tips[0].mean()) and np.allclose(tips[0].max(), -tips[1].min())


@pytest.mark.parametrize('n', [6, pytest.param(12, marks=pytest.mark.long), 24])
def test_no_arrow_crosses_a_number(n):
    """All arrows have their greatest length and point to the axis, to neighbours and between them."""
    beta = 2 * np.pi * np.arange(n) / n
    for turn in np.deg2rad([0, 20, 45, 70, 90]):
        cmm = 1e-6 * np.stack([-np.cos(beta + turn), -np.sin(beta + turn), 0 * beta], axis=1)
        made = deviations(cmm, cmm, 0.1825)
        field = next(one for one in made.axes[1].collections if isinstance(one, Quiver))
        ends = field.XY + np.stack([field.U, field.V], axis=1) / field.scale
        along = np.linspace(field.XY, ends, 50).reshape(-1, 2)
        numbers = [box for text, box, _ in texts_of(made) if text.isdigit() and made.axes[1].bbox.contains(*box.p0)]
        assert len(numbers) >= 6
        assert not any(box.padded(2).contains(*point) for box in numbers
                       for point in made.axes[1].transData.transform(along))
    assert faults(made) == []


@pytest.mark.parametrize(('longest', 'length'), [
    (37.0, 20.0), (0.9, 0.5), (1.0, 0.5), (10.0, 5.0), (0.04, 0.02), (0.0, 1.0)])
def test_scale_arrows_are_round(longest, length):
    """1, 2 or 5 times a power of ten, not longer than 0.6 of the longest arrow."""
    assert scale_arrow(longest) == length

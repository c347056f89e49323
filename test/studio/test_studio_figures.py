# SPDX-License-Identifier: Apache-2.0
"""Figures and words of the page from records, without a browser."""

from base64 import b64decode

import numpy as np
import pytest

from rosette_ros.analysis import analyse
from rosette_ros.core.diagnosis.recovered_shape import Shape, ShapeCurve
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.messages import Phase, Target
from rosette_ros.presentation.cell_results import CauseDot, CausesOfRuns
from rosette_ros.presentation.formatting import signed
from rosette_ros.presentation.plots.plot_style import AFTER
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.figures import (
    CURRENT,
    DONE,
    FAILED,
    MOST_CELLS,
    MOST_DOTS,
    MOST_MARKS,
    OPEN,
    Curves,
    causes_figure,
    curves_figure,
    filling_figure,
    maps_figure,
    plan_view_figure,
    reading_in_map,
    reading_in_time,
    shape_figure,
    shape_height,
    time_figure,
)
from rosette_ros.studio.live_state import CellView, ReadingPlace
from rosette_ros.studio.panels.open_dialog import safe_name

TARGET = Target('a', 1, 1, 1, Phase.RUN, 5, 0.18, 1, 1, 1, 0.0, 1, (0.0, 0.0, 0.0), 'table', 0)


def numbers(array):
    """Return the numbers of a typed array."""
    values = np.frombuffer(b64decode(array['bdata']), '<f4')
    return values.reshape([int(size) for size in array['shape'].split(',')]) if 'shape' in array else values


@pytest.fixture(scope='module')
def fit():
    """Return the fit of a run of five balls."""
    return analyse(Machine(MachineConfig().changed(seed=2, plate={'balls': 5})).run(plan(5, 'random')))


@pytest.fixture(scope='module')
def large():
    """Return the fit of a run that has to be thinned."""
    n = MOST_CELLS + 6
    return analyse(Machine(MachineConfig().changed(seed=2, plate={'balls': n})).run(plan(n, 'row')))


def test_curves_are_the_fit_s(fit):
    """Six panels in µm and µrad, closed to a whole turn, U (k = 2) around them."""
    figure = curves_figure([Curves('now', fit.error_motions, AFTER)])
    bands, lines = figure['data'][::2], figure['data'][1::2]
    assert len(lines) == 6
    for line, band, curve in zip(lines, bands, ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')):
        value = 1e6 * fit.error_motions[curve]
        assert numbers(line['y']) == pytest.approx([*value, value[0]], rel=1e-6)
        spread = 2e6 * fit.error_motions.uncertainty(curve)
        assert numbers(line['customdata'])[:-1] == pytest.approx(spread, rel=1e-6)
        assert numbers(band['y']).max() == pytest.approx((value + spread).max(), rel=1e-6)
        assert ('µm' if curve.startswith('ct') else 'µrad') in line['hovertemplate']
    assert [line['showlegend'] for line in lines] == [True] + 5 * [False]


def drawn(figure, name, numbered):
    """Return the readings that the marks of a name stand for: of the balls, or of the dots outside."""
    [trace] = [one for one in figure['data'] if one['name'] == name and 'text' in one and (
        one['marker']['size'] > 10) == numbered]
    return {tuple(row) for row in numbers(trace['customdata']).reshape(-1, 3).astype(int).tolist()}


def test_the_cell_is_seen_from_above():
    """Balls stand at their CMM position, turned with the table; measured, failed and current ones are told apart."""
    done, failed = frozenset({ReadingPlace(1, 1, 1), ReadingPlace(2, 4, 5)}), frozenset({ReadingPlace(2, 1, 2)})
    target = TARGET._replace(table_position=2, ball=3, table_angle=2 * np.pi / 5)
    figure = plan_view_figure(CellView(5, target, True, done, failed))
    assert drawn(figure, CURRENT, True) == drawn(figure, CURRENT, False) == {(2, 3, 4)}
    assert drawn(figure, DONE, True) == {(2, 4, 5)} and drawn(figure, DONE, False) == set(done)
    assert drawn(figure, FAILED, True) == set(failed)
    assert len(drawn(figure, OPEN, False)) == 25 - 4
    balls = [one for one in figure['data'] if 'text' in one and one['marker']['size'] > 10]
    places = {int(row[1]): np.arctan2(y, x) for one in balls for row, x, y in zip(
        numbers(one['customdata']).reshape(-1, 3), numbers(one['x']), numbers(one['y']))}
    expected = 2 * np.pi / 5 * np.arange(1, 6)
    assert [np.exp(1j * places[ball]) for ball in range(1, 6)] == pytest.approx(np.exp(1j * expected), abs=1e-6)
    answered = plan_view_figure(CellView(5, target, False, done | {ReadingPlace(2, 3, 4)}, failed))
    assert drawn(answered, CURRENT, True) == set() and (2, 3, 4) in drawn(answered, DONE, True)
    large = plan_view_figure(CellView(MOST_DOTS + 1, target, True, done, failed))
    assert sum(len(one.get('text', ())) for one in large['data']) == MOST_DOTS + 1


@pytest.mark.parametrize('run', ['fit', 'large'])
def test_a_click_finds_its_reading(run, request):
    """In the maps, thinned or not, and in the time series: the reading that is shown there, framed in all panels."""
    found = request.getfixturevalue(run)
    maps, times = maps_figure(found, chosen=7), time_figure(found, chosen=7)
    cells = numbers(maps['data'][2]['customdata'])
    assert reading_in_map(found, 2, 3, 4) == int(cells[3, 4, 4]) - 1
    minutes = numbers(times['data'][1]['x'])
    reading = reading_in_time(found, 1, 9)
    assert (found.run.time[reading] - found.run.time[0]) / 60 == pytest.approx(minutes[9], rel=1e-6)
    assert [one['type'] for one in maps['layout']['shapes']] == ['rect'] * 3
    frame = maps['layout']['shapes'][0]
    assert frame['x0'] < found.run.ball[7] < frame['x1'] and frame['y0'] < found.run.table_position[7] < frame['y1']


def test_a_cell_of_the_map_is_its_reading(fit):
    """Row: table position, column: ball; hovering shows all of the reading."""
    figure = maps_figure(fit)
    run, k = fit.run, 7
    row, column = run.table_position[k] - 1, run.ball[k] - 1
    for axis, trace in enumerate(figure['data']):
        assert numbers(trace['z'])[row, column] == pytest.approx(1e6 * fit.residual[k, axis], rel=1e-6)
        shown = numbers(trace['customdata'])[row, column]
        assert shown[:3].tolist() == [run.table_position[k], run.ball[k], run.cmm_position[k]]
        x, y, z = (signed(1e6 * size, 3) for size in fit.residual[k])
        assert trace['text'][row][column] == f'x {x}, y {y}, z {z}'
        assert shown[4] == k + 1
        assert shown[5] == pytest.approx((run.time[k] - run.time[0]) / 60, rel=1e-6)
        assert trace['zmin'] == -trace['zmax']
    sizes = numbers(figure['data'][0]['customdata'])[..., 3]
    left = np.sqrt(np.mean(fit.residual**2))
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(left / run.repeatability, rel=1e-5)
    assert '× the repeatability' in figure['data'][0]['hovertemplate']


def test_residuals_are_judged_by_the_repeatability(fit):
    """Also those of a model that fails; where it is not known, by all residuals, and it is said."""
    run = fit.run
    for judged, size, words in ((fit, run.repeatability, 'dotted: ± 2 × the repeatability'),
                                (analyse(run.replace(repeatability=None)), fit.rms, 'the repeatability is not known')):
        layout = time_figure(judged)['layout']
        assert [abs(line['y0']) for line in layout['shapes']] == pytest.approx([2e6 * size] * 6)
        assert words in layout['annotations'][0]['text']


def test_missing_readings_are_gaps(fit):
    """And are no zeros."""
    part = analyse(fit.run.take(np.arange(fit.run.size) != 3))
    row, column = fit.run.table_position[3] - 1, fit.run.ball[3] - 1
    assert np.isnan(numbers(maps_figure(part)['data'][0]['z'])[row, column])


def test_large_maps_show_the_largest_of_each_block(large):
    """No residual is hidden by thinning."""
    trace = maps_figure(large)['data'][1]
    shown = numbers(trace['z'])
    assert shown.shape[0] <= MOST_CELLS
    assert np.abs(shown).max() == pytest.approx(1e6 * np.abs(large.residual[:, 1]).max(), rel=1e-6)
    assert 'the largest of 2 × 2 readings' in trace['hovertemplate']


def test_large_series_show_their_extremes(large):
    """In time order."""
    for axis, trace in enumerate(time_figure(large)['data']):
        shown, residual = numbers(trace['y']), 1e6 * large.residual[:, axis]
        assert shown.size <= MOST_MARKS
        assert (shown.min(), shown.max()) == pytest.approx((residual.min(), residual.max()), rel=1e-6)
        assert np.all(np.diff(numbers(trace['x'])) >= 0)


def test_ball_centres_fill_the_map_as_they_are_received():
    """Those not received yet are gaps."""
    values = filling_figure(3, {(1, 2): 5e-6})['data'][0]['z']
    assert values == [[None, 5.0, None], [None] * 3, [None] * 3]


@pytest.mark.parametrize(('name', 'kept'), [
    ('run.csv', 'run.csv'), ('../../etc/passwd', 'passwd'), ('C:\\runs\\a.mcap', 'a.mcap'), ('..', 'upload'),
    ('', 'upload'), ('.hidden', 'hidden'), ('a\nb.csv', 'a_b.csv'), ('<b>.csv', '_b_.csv'),
    ('x' * 300 + '.csv', 'x' * 116 + '.csv'),
])
def test_names_of_uploads_mean_nothing_to_the_system(name, kept):
    """Only their last part is kept, without what could be taken for more."""
    assert safe_name(name) == kept


def test_a_shape_has_a_panel_for_each_axis():
    """All of them below each other, with the band of U and the claim; the legend is there once."""
    at = np.linspace(0, 600, 5)
    curves = tuple(ShapeCurve(axis, '', 1e-6 * at / 600, np.full(5, 1e-7), 1e-6 * at / 600) for axis in 'xyz')
    shape = Shape('free', {}, 'a drift', 'frame_drift', 'time', 's', at, curves)
    figure = shape_figure(shape)
    assert [one['text'] for one in figure['layout']['annotations']] == [f'<b>{axis}</b> / µm' for axis in 'xyz']
    assert [one['name'] for one in figure['data'] if one['showlegend']] == ['recovered', 'claimed']
    assert len(figure['data']) == 9 and shape_height(shape) > 300


def test_causes_stand_against_runs_by_probability_and_size():
    """The area of a dot is the probability; those that a run does not name are a trace of their own, open."""
    figure = causes_figure(CausesOfRuns(('drift', 'backlash'), ('a', 'b'), (
        CauseDot(0, 0, 1.0, 5e-7), CauseDot(0, 1, 0.25), CauseDot(1, 1, 0.81, 2e-6))))
    named, others = figure['data']
    assert (named['x'], named['y'], named['marker']['color']) == ([0, 1], [0, 1], [0.5, 2.0])
    assert np.square(named['marker']['size']) / named['marker']['size'][0]**2 == pytest.approx([1.0, 0.81])
    assert others['text'] == ['b<br>drift<br>probability 25 %; not named by this run']

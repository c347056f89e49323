# SPDX-License-Identifier: Apache-2.0
"""The figures in which people zoom or click: Plotly's data and layout as plain dicts, made of records.

Colours of text, grid and background come from the page's style sheet, so that one figure serves light and dark. What
would be too much for a browser is thinned, and the figure states it.
"""

from base64 import b64encode
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.core.diagnosis.recovered_shape import Shape, strongest
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import AXES
from rosette_ros.core.run.geometry import TWO_PI, nominal_angles, rotate_z
from rosette_ros.core.run.number_words import SCALES
from rosette_ros.core.run.records import CURVES, ErrorMotions, Floats, Ints
from rosette_ros.core.run.scheme import cmm_position, nominal_places
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.cell_results import CausesOfRuns
from rosette_ros.presentation.formatting import curve_scales, curve_units, iso_name, signed
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE, COLOURS
from rosette_ros.presentation.plots.residual_plots import MOST_CURVES, UNITS
from rosette_ros.presentation.plots.result_plots import MEANING, closed
from rosette_ros.presentation.tables import noise_of
from rosette_ros.studio.live_state import CellView, ReadingPlace

PlotlyFigure = dict[str, Any]
"""Data, layout and config as JSON: their many forms are Plotly's."""
FONT = 'Roboto, system-ui, sans-serif'
DIVERGING = ((0, '#0072b2'), (0.25, '#7fb8d8'), (0.5, '#f2f2f2'), (0.75, '#eaae7f'), (1, '#d55e00'))
MOST_CELLS = 64
"""A map of more rows is thinned to at most so many; each block shows its largest residual."""
MOST_GAPS = 20
"""Cells of a map of at most so many rows have gaps between them."""
MOST_MARKS = 1500
"""A line of more points shows the lowest and the highest of each section."""
CHOSEN = {'color': '#cc79a7', 'width': 3}
"""Line around or through a chosen reading."""
AXIS = {'zeroline': False, 'fixedrange': True, 'title': {'standoff': 6, 'font': {'size': 12}}}
HOVER = ('table position %{customdata[0]}, ball %{customdata[1]}, CMM position %{customdata[2]}'
         '<br>%{text} µm<br>rms %{customdata[3]:.1f} × NOISE<br>reading %{customdata[4]}, at %{customdata[5]:.1f} TIME')


DASHES = ('solid', 'dash', 'dot', 'dashdot', 'longdash')
DONE, FAILED, CURRENT, OPEN = 'measured', 'failed', 'current target', 'not measured'
LOOKS: dict[str, dict[str, Any]] = {
    OPEN: {'symbol': 'circle-open', 'color': '#8a8a8a', 'line': {'width': 1}},
    DONE: {'symbol': 'circle', 'color': AFTER},
    FAILED: {'symbol': 'x', 'color': BEFORE},
    CURRENT: {'symbol': 'diamond', 'color': COLOURS[5], 'line': {'width': 1.5, 'color': '#222222'}}}
"""How a ball or a reading looks, told apart without its colour, too."""
SOFT, FAINT = 'rgba(128,128,128,0.5)', 'rgba(128,128,128,0.10)'
"""Lines and areas that are seen on a light and on a dark ground."""
TABLE, INNER, OUTER, NAMES = 0.8, 1.3, 2.25, 2.45
"""Radii in those of the circle of balls: table, first and last table position, numbers of the CMM positions."""
MOST_DOTS = 36
"""The readings of larger plates are not drawn one by one."""


class Curves(NamedTuple):
    """Six curves to draw: the name in the legend, the curves, the colour."""

    name: str
    motions: ErrorMotions
    colour: str
    dash: str = 'solid'


def curves_figure(every: Sequence[Curves], angle: float | None = None) -> PlotlyFigure:
    """Return six panels of curves against the table angle with bands of U (k = 2); angle: of a chosen reading, rad."""
    if not every:
        return figure_of([], {**layout_of(), 'xaxis': {'visible': False}, 'yaxis': {'visible': False}})
    data, layout = [], _panels(2, 3, gap=(0.2, 0.3), legend=True)
    for place, (curve, unit) in enumerate(zip(CURVES, curve_units(), strict=True), 1):
        for one in every:
            data += _curve(one, curve, unit, place)
        x = {'range': [-8, 368], 'tickvals': [0, 90, 180, 270, 360],
             'title': {'text': 'table angle / °' if place > 3 else ''}}
        _set_panel(layout, place, x, {'zeroline': True}, f'<b>{curve}</b> {MEANING[curve]} / {unit}')
        if angle is not None:
            layout['shapes'].append(_upright(place, float(np.rad2deg(angle) % 360)))
    return figure_of(data, layout)


def trend_figure(dates: Sequence[datetime], values: Floats, expanded: Floats, tolerances: Mapping[str, float],
                 changes: Sequence[tuple[int, int, Collection[str]]]) -> PlotlyFigure:
    """Return the six error motions, (m, 6) with U, over the dates, a trace each with a point a run; tolerances dashed.

    changes: before and after which run, and in which curves, something has changed; fainter in the other panels."""
    when = [f'{date:%Y-%m-%d %H:%M}' for date in dates]
    data, layout = [], _panels(2, 3, gap=(0.2, 0.34))
    for place, (curve, (factor, unit)) in enumerate(zip(CURVES, curve_scales(), strict=True), 1):
        data.append({'type': 'scatter', 'mode': 'lines+markers', 'x': when, 'y': packed(factor * values[:, place - 1]),
                     'error_y': {'type': 'data', 'array': packed(factor * expanded[:, place - 1]), 'thickness': 0.8,
                                 'width': 0}, 'line': {'color': AFTER, 'width': 1}, 'marker': {'size': 5},
                     'name': curve, 'showlegend': False, **_axes(place),
                     'hovertemplate': f'%{{x}}<br>%{{y:.3f}} {unit}<extra>{curve}</extra>'})
        _set_panel(layout, place, {'type': 'date', 'nticks': 5}, {'rangemode': 'tozero'},
                   f'<b>{curve}</b> range / {unit}')
        x, y = (f'{axis}{_number(place)}' for axis in 'xy')
        for begin, end, curves in changes:
            layout['shapes'].append({
                'type': 'rect', 'xref': x, 'yref': f'{y} domain', 'x0': when[begin], 'x1': when[end], 'y0': 0, 'y1': 1,
                'line': {'width': 0}, 'fillcolor': BEFORE, 'opacity': 0.45 if curve in curves else 0.12})
        if curve in tolerances:
            limit = factor * tolerances[curve]
            layout['shapes'].append({
                'type': 'line', 'xref': f'{x} domain', 'yref': y, 'x0': 0, 'x1': 1, 'y0': limit, 'y1': limit,
                'line': {'color': BEFORE, 'width': 1.5, 'dash': 'dash'}})
    return figure_of(data, layout)


def shape_figure(shape: Shape) -> PlotlyFigure:
    """Return what was recovered of a shape with its band of U (k = 2), and the claim beside it; a panel for each axis,
    one below the other."""
    unit, factor = UNITS.get(shape.unit, (shape.unit, 1.0))
    curves = strongest(shape, MOST_CURVES)
    data, layout = [], _panels(len(curves), 1, gap=(0.0, 0.16), legend=True, margin={'l': 44, 't': 44, 'b': 36})
    for place, curve in enumerate(curves, 1):
        x, value = factor * shape.values, 1e6 * curve.value
        data.append({**band_trace(x, value, COVERAGE_FACTOR * 1e6 * curve.u, AFTER), **_axes(place)})
        for name, line, colour, dash in (('recovered', value, AFTER, 'solid'), (
                'claimed', None if curve.claimed is None else 1e6 * curve.claimed, BEFORE, 'dash')):
            if line is not None:
                data.append({'type': 'scatter', 'mode': 'lines', 'x': packed(x), 'y': packed(line), 'name': name,
                             'legendgroup': name, 'showlegend': place == 1, 'line': {'color': colour, 'width': 2,
                                                                                    'dash': dash},
                             'hovertemplate': f'{curve.axis} %{{y:.3f}} µm<extra>{name}</extra>', **_axes(place)})
        times = f' × {curve.carrier}' if curve.carrier else ''
        below = {'title': {'text': f'{shape.variable} / {unit}'}} if place == len(curves) else {'showticklabels': False}
        _set_panel(layout, place, below, {'zeroline': True, 'nticks': 4},
                   f'<b>{curve.axis}</b> / µm{times}')
    return figure_of(data, layout)


def shape_height(shape: Shape) -> int:
    """Return the height of `shape_figure`, px."""
    return 80 + 95 * len(strongest(shape, MOST_CURVES))


def causes_figure(found: CausesOfRuns) -> PlotlyFigure:
    """Return causes against runs: the area of a dot is the probability, its colour the size. A trace of those that the
    run names, one of others."""
    data: list[PlotlyFigure] = []
    causes, runs = found.causes, found.runs
    for is_named in (True, False):
        shown = [one for one in found.dots if (one.size is not None) == is_named]
        marker: PlotlyFigure = {'size': [22 * one.probability**0.5 for one in shown], 'opacity': 1.0}
        if is_named:
            marker |= {'color': [1e6 * (one.size or 0.0) for one in shown], 'colorscale': 'Cividis',
                       'line': {'width': 1, 'color': SOFT},
                       'colorbar': {'title': {'text': 'µm rms', 'side': 'top'}, 'thickness': 12}}
        else:
            marker |= {'symbol': 'circle-open', 'color': '#8a8a8a', 'line': {'width': 1.5}}
        data.append({
            'type': 'scatter', 'mode': 'markers', 'x': [one.run for one in shown], 'y': [one.cause for one in shown],
            'marker': marker, 'showlegend': False, 'text': [
                f'{runs[one.run]}<br>{causes[one.cause]}<br>probability {100 * one.probability:.0f} %'
                + ('; not named by this run' if one.size is None else f', {1e6 * one.size:.3g} µm rms')
                for one in shown],
            'hovertemplate': '%{text}<extra></extra>'})
    step = -(-len(runs) // 12)
    layout = layout_of(margin={'l': 230, 'b': 80, 't': 12})
    layout['xaxis'] = {'range': [-0.7, len(runs) - 0.3], 'tickvals': list(range(0, len(runs), step)),
                       'ticktext': list(runs[::step]), 'tickangle': 30}
    layout['yaxis'] = {'range': [len(causes) - 0.4, -0.6], 'tickvals': list(range(len(causes))),
                       'ticktext': list(causes)}
    return figure_of(data, layout)


def _curve(one: Curves, curve: str, unit: str, place: int) -> list[PlotlyFigure]:
    """Return the band and the line of one curve, closed to a whole turn."""
    angle, value = closed(one.motions.angle, one.motions[curve], curve)
    spread = COVERAGE_FACTOR * closed(one.motions.angle, one.motions.uncertainty(curve), curve)[1]
    common = {'type': 'scatter', 'legendgroup': one.name, **_axes(place)}
    band = {**common, **band_trace(angle, value, spread, one.colour)}
    line = {**common, 'x': packed(angle), 'y': packed(value), 'name': one.name, 'customdata': packed(spread),
            'mode': 'lines+markers' if value.size <= 80 else 'lines', 'showlegend': place == 1,
            'marker': {'size': 5, 'symbol': 'circle' if one.dash == 'solid' else 'square'},
            'line': {'color': one.colour, 'width': 2, 'dash': one.dash},
            'hovertemplate': f'{curve} ({iso_name(curve, one.motions.rotation)}) %{{y}} ± %{{customdata:.3f}} {unit}'
                             f'<br>at %{{x:.2f}}°, U with k = {COVERAGE_FACTOR}<extra>{one.name}</extra>'}
    return [band, line]


def band_trace(x: Floats, value: Floats, spread: Floats, colour: str) -> PlotlyFigure:
    """Return the area within `spread` of values."""
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    return {'type': 'scatter', 'x': packed(np.concatenate([x, x[::-1]])),
            'y': packed(np.concatenate([value + spread, (value - spread)[::-1]])), 'fill': 'toself', 'mode': 'lines',
            'fillcolor': f'rgba({red},{green},{blue},0.22)', 'line': {'width': 0}, 'hoverinfo': 'skip',
            'showlegend': False}


def maps_figure(fit: Fit, scale: Fit | None = None, chosen: int | None = None) -> PlotlyFigure:
    """Return three maps of residuals, table position and ball, one per axis; `scale`: its residuals span the colours.

    The size of a reading is the rms over the axes in units of the repeatability, where it is known; chosen: index of
    a reading that is framed.
    """
    run, residual, noise = fit.run, 1e6 * fit.residual, noise_of(fit)[1].partition(';')[0]
    step = -(-run.n // MOST_CELLS)
    count = -(-run.n // step)
    top = 1e6 * float(np.abs((scale or fit).residual).max()) or 1.0
    centre = 1 + step * np.arange(count) + (step - 1) / 2
    gap = 1 if count <= MOST_GAPS else 0
    block = f'<br>the largest of {step} × {step} readings' if step > 1 else ''
    hover = f'{HOVER.replace("NOISE", noise).replace("TIME", SCALES[run.time_unit].unit)}{block}<extra></extra>'
    data, layout = [], _panels(1, 3, gap=(0.18, 0.2), margin={'t': 24, 'r': 64})
    for place, axis in enumerate(AXES, 1):
        values, readings, texts = _cells(fit, residual, place - 1, step)
        data.append({
            'type': 'heatmap', 'z': packed(values), 'x': packed(centre), 'y': packed(centre), 'zmin': -top, 'zmax': top,
            'colorscale': DIVERGING, 'customdata': packed(readings), 'text': texts, 'hovertemplate': hover,
            'xgap': gap, 'ygap': gap, 'showscale': place == 3, **_axes(place),
            'colorbar': {'title': {'text': 'µm', 'side': 'top'}, 'thickness': 12, 'len': 1.02, 'x': 1.01}})
        x = {'title': {'text': 'ball'}, 'dtick': _tick(run.n), 'tickangle': 0}
        y = {'autorange': 'reversed', 'dtick': _tick(run.n), 'title': {'text': 'table position' if place == 1 else ''}}
        _set_panel(layout, place, x, y, f'residual in <b>{axis}</b> / µm')
        if chosen is not None:
            at = [centre[(one[chosen] - 1) // step] for one in (run.ball, run.table_position)]
            layout['shapes'].append({
                'type': 'rect', 'xref': f'x{_number(place)}', 'yref': f'y{_number(place)}', 'x0': at[0] - step / 2,
                'x1': at[0] + step / 2, 'y0': at[1] - step / 2, 'y1': at[1] + step / 2, 'line': CHOSEN})
    return figure_of(data, layout)


def reading_in_map(fit: Fit, axis: int, row: int, column: int) -> int | None:
    """Return the index of the reading that a cell of a map shows, None where it is empty."""
    shown = _cells(fit, 1e6 * fit.residual, axis, -(-fit.run.n // MOST_CELLS))[1][row, column, 4]
    return None if np.isnan(shown) else int(shown) - 1


def _tick(n: int) -> int:
    return next(step for step in (1, 2, 3, 5, 10, 20, 50, 100) if n / step <= 12 or step == 100)


def _cells(fit: Fit, residual: Floats, axis: int, step: int) -> tuple[Floats, Floats, list[list[str]]]:
    """Return values, and numbers and texts for HOVER, of each cell; a cell is a block of step x step readings."""
    run = fit.run
    count = -(-run.n // step)
    row, column = (run.table_position - 1) // step, (run.ball - 1) // step
    block = row * count + column
    order = np.lexsort((np.abs(residual[:, axis]), block))
    shown = order[np.flatnonzero(np.diff(block[order], append=-1))]  # of each block the largest
    values, readings = np.full((count, count), np.nan), np.full((count, count, 6), np.nan)
    values[row[shown], column[shown]] = residual[shown, axis]
    noise = 1e6 * noise_of(fit)[0]
    readings[row[shown], column[shown]] = np.column_stack([
        run.table_position[shown], run.ball[shown], run.cmm_position[shown],
        np.sqrt(np.mean(residual[shown]**2, axis=1)) / noise, shown + 1,
        (run.time[shown] - run.time[0]) * SCALES[run.time_unit].factor])
    texts = [[''] * count for _ in range(count)]
    for k in shown:
        texts[row[k]][column[k]] = ', '.join(f'{name} {signed(size, 3)}'
                                             for name, size in zip(AXES, residual[k], strict=True))
    return values, readings, texts


def time_figure(fit: Fit, colour: str = AFTER, chosen: int | None = None) -> PlotlyFigure:
    """Return residuals of x, y, z against time, with lines at twice the repeatability, where it is known.

    chosen: index of a reading that is marked."""
    run, residual, (noise, name) = fit.run, 1e6 * fit.residual, noise_of(fit)
    factor, unit = SCALES[run.time_unit]
    minutes, limit = factor * (run.time - run.time[0]), 2e6 * noise
    data, layout = [], _panels(3, 1, gap=(0.0, 0.08), margin={'t': 24})
    for place, (axis, symbol) in enumerate(zip(AXES, ('circle', 'square', 'diamond'), strict=True), 1):
        shown = _thinned(residual[:, place - 1])
        data.append({
            'type': 'scatter', 'mode': 'markers' if run.size <= MOST_MARKS else 'lines', 'name': axis,
            'x': packed(minutes[shown]), 'y': packed(residual[shown, place - 1]), **_axes(place),
            'marker': {'size': 4, 'color': colour, 'symbol': symbol}, 'showlegend': False,
            'line': {'color': colour, 'width': 1},
            'hovertemplate': f'{axis} %{{y}} µm at %{{x:.1f}} {unit}<extra></extra>'})
        x = {'title': {'text': f'time / {unit}'}} if place == 3 else {'showticklabels': False, 'matches': 'x3'}
        heading = f'dotted: ± 2 × {name}' if place == 1 else ''
        _set_panel(layout, place, x, {'title': {'text': f'{axis} / µm'}, 'zeroline': True, 'nticks': 5}, heading)
        layout['shapes'] += [
            {'type': 'line', 'xref': f'x{_number(place)} domain', 'yref': f'y{_number(place)}', 'x0': 0, 'x1': 1,
             'y0': level, 'y1': level, 'line': {'color': COLOURS[2], 'width': 1.5, 'dash': 'dot'}}
            for level in (-limit, limit)]
        if chosen is not None:
            layout['shapes'].append(_upright(place, float(minutes[chosen])))
    return figure_of(data, layout)


def reading_in_time(fit: Fit, axis: int, point: int) -> int:
    """Return the index of the reading that a point of a panel of the time series shows."""
    return int(_thinned(fit.residual[:, axis])[point])


def _thinned(values: Floats) -> Ints:
    """Return the indices of all values, or of the extremes of as many sections as can be shown."""
    if values.size <= MOST_MARKS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, MOST_MARKS // 2 + 1).astype(int)
    pairs = [(a + int(np.argmin(values[a:b])), a + int(np.argmax(values[a:b]))) for a, b in pairwise(edges)]
    return np.unique(np.array(pairs).reshape(-1))


def filling_figure(n: int, cells: Mapping[tuple[int, int], float]) -> PlotlyFigure:
    """Return a map of the ball centres received so far; cells: of CellState."""
    values: list[list[float | None]] = [[None] * n for _ in range(n)]
    for (position, ball), size in cells.items():
        values[position - 1][ball - 1] = round(1e6 * size, 1)
    numbers = list(range(1, n + 1))
    data = [{'type': 'heatmap', 'z': values, 'x': numbers, 'y': numbers, 'colorscale': 'Cividis', 'xgap': 1, 'ygap': 1,
             'colorbar': {'title': {'text': 'µm', 'side': 'top'}, 'thickness': 12},
             'hovertemplate': 'table position %{y}, ball %{x}<br>%{z} µm from its place<extra></extra>'}]
    layout = layout_of(margin={'l': 52, 't': 12})
    layout['xaxis'] = {'dtick': _tick(n), 'range': [0.5, n + 0.5], 'title': {'text': 'ball'}}
    layout['yaxis'] = {'dtick': _tick(n), 'range': [n + 0.5, 0.5], 'title': {'text': 'table position'}}
    return figure_of(data, layout)


def plan_view_figure(view: CellView) -> PlotlyFigure:
    """Return the cell from above: table, balls where they stand, and outside, at each CMM position, its readings.

    The readings of a CMM position lie one behind the other, table position 1 inside.
    """
    n, target = view.balls, view.target
    balls, position = np.arange(1, n + 1), target.table_position if target else 1
    offset = target.table_offset if target else 0.0
    places = rotate_z(offset, nominal_places(n, 1.0, position, balls))[:, :2]
    states = [_state(view, ReadingPlace(position, int(ball), int(at)))
              for ball, at in zip(balls, cmm_position(n, position, balls))]
    size, far = max(7.0, min(22.0, 260 / n)), n if n <= MOST_DOTS else 0
    numbers = np.array(list(product(range(1, far + 1), balls)), dtype=int).reshape(-1, 2)
    at = cmm_position(n, numbers[:, 0], numbers[:, 1])
    radius = INNER + (OUTER - INNER) * (numbers[:, 0] - 1) / max(1, n - 1)
    spoke = TWO_PI * (at - 1) / n + offset
    dots = radius[:, None] * np.stack([np.cos(spoke), np.sin(spoke)], axis=-1)
    kinds = [_state(view, ReadingPlace(int(i), int(j), int(k))) for (i, j), k in zip(numbers, at)]
    data: list[PlotlyFigure] = [
        {'type': 'scatter', 'x': [None], 'y': [None], 'mode': 'markers', 'name': name, 'marker': {**look, 'size': 10}}
        for name, look in LOOKS.items()]
    data += [_marks(name, places, states, 'ball %{customdata[1]}, CMM position %{customdata[2]}', size, True,
                    np.column_stack([np.full(n, position), balls, cmm_position(n, position, balls)]))
             for name in LOOKS]
    data += [_marks(name, dots, kinds, 'table position %{customdata[0]}, ball %{customdata[1]}, CMM position '
                    '%{customdata[2]}', max(4.0, min(9.0, 80 / n)), False, np.column_stack([numbers, at]))
             for name in LOOKS if far]
    turned = target.table_angle if target else 0.0
    layout = layout_of(legend=True, margin={'l': 4, 'r': 4, 't': 34, 'b': 4})
    layout['shapes'] = [
        {'type': 'circle', 'x0': -TABLE, 'x1': TABLE, 'y0': -TABLE, 'y1': TABLE, 'line': {'color': SOFT, 'width': 1.5},
         'fillcolor': FAINT, 'layer': 'below'},
        {'type': 'line', 'x0': 0, 'y0': 0, 'x1': TABLE * np.cos(turned), 'y1': TABLE * np.sin(turned),
         'line': {'color': SOFT, 'width': 2}}]
    layout['annotations'] = [_note(0, -0.25 if np.sin(turned) > -0.2 else 0.25, _place_words(view))]
    layout['annotations'] += [_note(NAMES * np.cos(angle), NAMES * np.sin(angle), str(number))
                              for number, angle in enumerate(nominal_angles(n) + offset, 1)
                              if n <= MOST_DOTS and (n <= 18 or number % 3 == 1)]
    free = {'visible': False, 'fixedrange': True}
    layout |= {'xaxis': {**free, 'range': [-2.6, 2.6]}, 'yaxis': {**free, 'range': [-2.6, 2.6], 'scaleanchor': 'x'}}
    return figure_of(data, layout)


def _place_words(view: CellView) -> str:
    if view.target is None:
        return ''
    return f'table position {view.target.table_position}<br>{np.rad2deg(view.target.table_angle) % 360:.1f}°'


def _state(view: CellView, place: ReadingPlace) -> str:
    if view.target and view.is_waiting and place[:2] == (view.target.table_position, view.target.ball):
        return CURRENT
    return DONE if place in view.done else FAILED if place in view.failed else OPEN


def _marks(name: str, places: Floats, states: Collection[str], words: str, size: float, numbered: bool,
           data: Any) -> PlotlyFigure:
    """Return the marks of one state; numbered: with the number of the ball."""
    which = np.array([state == name for state in states], dtype=bool)
    return {'type': 'scatter', 'mode': 'markers+text' if numbered and size > 14 else 'markers', 'name': name,
            'showlegend': False, **{axis: packed(places[which, place])
                                                            for place, axis in enumerate('xy')},
            'text': [str(one) for one in data[which, 1]], 'textposition': 'middle center',
            'textfont': {'size': 11}, 'customdata': packed(data[which]),
            'marker': {**LOOKS[name], 'size': size, 'opacity': 0.55 if numbered and name != OPEN else 1.0},
            'hovertemplate': f'{words}<extra>{name}</extra>'}


def _note(x: float, y: float, words: str) -> PlotlyFigure:
    return {'x': x, 'y': y, 'text': words, 'showarrow': False, 'font': {'size': 12}}


# What all figures have


def figure_of(data: list[PlotlyFigure], layout: PlotlyFigure) -> PlotlyFigure:
    config = {'displaylogo': False, 'responsive': True, 'displayModeBar': False}
    return {'data': data, 'layout': layout, 'config': config}


def layout_of(legend: bool = False, margin: Mapping[str, int] | None = None) -> PlotlyFigure:
    return {'template': {'layout': {'xaxis': AXIS, 'yaxis': {**AXIS, 'hoverformat': '.3f'}}},
            'annotations': [], 'shapes': [], 'paper_bgcolor': 'rgba(0,0,0,0)', 'plot_bgcolor': 'rgba(0,0,0,0)',
            'font': {'size': 12, 'family': FONT},
            'margin': {'l': 48, 'r': 12, 't': 30, 'b': 44, **(margin or {})}, 'showlegend': legend,
            'hovermode': 'closest', 'legend': {'orientation': 'h', 'x': 1, 'xanchor': 'right', 'y': 1.0,
                                               'yref': 'container', 'yanchor': 'top'}}


def _panels(rows: int, columns: int, gap: tuple[float, float], legend: bool = False,
            margin: Mapping[str, int] | None = None) -> PlotlyFigure:
    """Return the layout of panels, numbered along the rows from the top left; gap: shares of a panel's size."""
    grid = {'rows': rows, 'columns': columns, 'pattern': 'independent', 'xgap': gap[0], 'ygap': gap[1]}
    return {**layout_of(legend, {'t': 46, **(margin or {})}), 'grid': grid}


def _set_panel(layout: PlotlyFigure, place: int, x: PlotlyFigure, y: PlotlyFigure, heading: str = '') -> None:
    """Set the axes of a panel, and the text above it, at its left edge."""
    number = _number(place)
    layout |= {f'xaxis{number}': x, f'yaxis{number}': y}
    layout['annotations'].append(
        {'xref': f'x{number} domain', 'yref': f'y{number} domain', 'x': 0, 'y': 1, 'text': heading, 'showarrow': False,
         'xanchor': 'left', 'yanchor': 'bottom', 'font': {'size': 12}})


def _upright(place: int, x: float) -> PlotlyFigure:
    """Return an upright line through a panel."""
    return {'type': 'line', 'xref': f'x{_number(place)}', 'yref': f'y{_number(place)} domain', 'x0': x, 'x1': x,
            'y0': 0, 'y1': 1, 'line': {**CHOSEN, 'width': 2}}


def _axes(place: int) -> dict[str, str]:
    return {'xaxis': f'x{_number(place)}', 'yaxis': f'y{_number(place)}'}


def _number(place: int) -> str:
    return '' if place == 1 else str(place)


def packed(values: ArrayLike) -> dict[str, str]:
    """Return numbers as Plotly's typed array: short to send, and quick for the browser."""
    numbers = np.ascontiguousarray(values, dtype='<f4')
    made = {'dtype': 'f4', 'bdata': b64encode(numbers).decode('ascii')}
    return made | {'shape': ', '.join(map(str, numbers.shape))} if numbers.ndim > 1 else made

# SPDX-License-Identifier: Apache-2.0
"""The figures of the page: Plotly's data and layout as plain dicts, made of records.

Colours of text, grid and background come from the page's style sheet, so that one figure serves light and dark. What
would be too much for a browser is thinned, and the figure states it.
"""

from base64 import b64encode
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rosette_ros.analysis import LadderStep
from rosette_ros.core.diagnosis.recovered_shape import Shape, ShapeCurve, strongest
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.noise import AXES
from rosette_ros.core.records import CURVES, ErrorMotions, Floats, Ints
from rosette_ros.core.uncertainty_budget import Budget
from rosette_ros.presentation.formatting import COVERAGE_FACTOR, CURVE_UNITS, iso_name, signed
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE, COLOURS
from rosette_ros.presentation.plots.result_plots import MEANING, closed
from rosette_ros.presentation.plots.shape_plots import MOST_CURVES, UNITS
from rosette_ros.presentation.tables import nested_names, noise_of

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
BARS: dict[str, tuple[str, dict[str, Any]]] = {
    'A': ('type A: by statistics', {'color': COLOURS[0]}),
    'B': ('type B: other knowledge', {'color': COLOURS[5], 'pattern': {'shape': '/', 'fgcolor': '#333333'}}),
    'hidden': ('bound of hidden effects', {'color': '#bbbbbb', 'line': {'width': 1, 'color': '#333333'}}),
    '': ('combined u', {'color': '#777777'})}
"""Labels and looks of the bars of a budget, by kind of evaluation."""
HOVER = ('table position %{customdata[0]}, ball %{customdata[1]}, CMM position %{customdata[2]}'
         '<br>%{text} µm<br>rms %{customdata[3]:.1f} × NOISE<br>reading %{customdata[4]}, at %{customdata[5]:.1f} min')


DASHES = ('solid', 'dash', 'dot', 'dashdot', 'longdash')
SYMBOLS = ('circle', 'square', 'diamond', 'triangle-up', 'cross', 'star')


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
    for place, (curve, unit) in enumerate(zip(CURVES, CURVE_UNITS, strict=True), 1):
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
    """Return the six errors, (m, 6) with U, over the dates, a trace each with a point a run; tolerances dashed.

    changes: before and after which run, and in which curves, something has changed; fainter in the other panels."""
    when = [f'{date:%Y-%m-%d %H:%M}' for date in dates]
    data, layout = [], _panels(2, 3, gap=(0.2, 0.34))
    for place, (curve, unit) in enumerate(zip(CURVES, CURVE_UNITS, strict=True), 1):
        data.append({'type': 'scatter', 'mode': 'lines+markers', 'x': when, 'y': packed(1e6 * values[:, place - 1]),
                     'error_y': {'type': 'data', 'array': packed(1e6 * expanded[:, place - 1]), 'thickness': 0.8,
                                 'width': 0}, 'line': {'color': AFTER, 'width': 1}, 'marker': {'size': 5},
                     'name': curve, 'showlegend': False, **_axes(place),
                     'hovertemplate': f'%{{x}}<br>%{{y:.3f}} {unit}<extra>{curve}</extra>'})
        _set_panel(layout, place, {'type': 'date', 'nticks': 5}, {'rangemode': 'tozero'},
                   f'<b>{curve}</b> peak to valley / {unit}')
        x, y = (f'{axis}{_number(place)}' for axis in 'xy')
        for begin, end, curves in changes:
            layout['shapes'].append({
                'type': 'rect', 'xref': x, 'yref': f'{y} domain', 'x0': when[begin], 'x1': when[end], 'y0': 0, 'y1': 1,
                'line': {'width': 0}, 'fillcolor': BEFORE, 'opacity': 0.45 if curve in curves else 0.12})
        if curve in tolerances:
            limit = 1e6 * tolerances[curve]
            layout['shapes'].append({
                'type': 'line', 'xref': f'{x} domain', 'yref': y, 'x0': 0, 'x1': 1, 'y0': limit, 'y1': limit,
                'line': {'color': BEFORE, 'width': 1.5, 'dash': 'dash'}})
    return figure_of(data, layout)


def _curve(one: Curves, curve: str, unit: str, place: int) -> list[PlotlyFigure]:
    """Return the band and the line of one curve, closed to a whole turn."""
    angle, value = closed(one.motions.angle, one.motions[curve])
    spread = COVERAGE_FACTOR * closed(one.motions.angle, one.motions.uncertainty(curve))[1]
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


def shape_figure(shape: Shape) -> PlotlyFigure:
    """Return the curves of a recovered shape that stand out most, with bands of U (k = 2), beside what is claimed."""
    shown, (unit, factor) = strongest(shape, MOST_CURVES), UNITS.get(shape.unit, (shape.unit, 1.0))
    data, layout = [], _panels(len(shown), 1, gap=(0.0, 0.4), legend=True)
    first, last = (factor * float(shape.values[k]) for k in (0, -1))
    ends = [first - 0.1 * (last - first), last + 0.04 * (last - first)]  # the first label stays off those of the y axis
    for place, curve in enumerate(shown, 1):
        data += _shape_curve(curve, factor * shape.values, f'{shape.variable} %{{x:.4g}} {unit}', place)
        title = f'{shape.variable} / {unit}' if place == len(shown) else ''
        carrier = f' × {curve.carrier}' if curve.carrier else ''
        x = {'range': ends, 'title': {'text': title}}
        _set_panel(layout, place, x, {'zeroline': True}, f'<b>{curve.axis}</b>{carrier} / µm')
    return figure_of(data, layout)


def _shape_curve(curve: ShapeCurve, x: Floats, at: str, place: int) -> list[PlotlyFigure]:
    value, spread = 1e6 * curve.value, 1e6 * COVERAGE_FACTOR * curve.u
    common = {'type': 'scatter', 'x': packed(x), 'mode': 'lines', 'showlegend': place == 1, **_axes(place)}
    line = {**common, 'y': packed(value), 'customdata': packed(spread), 'name': 'recovered',
            'line': {'color': AFTER, 'width': 2},
            'hovertemplate': f'%{{y}} ± %{{customdata:.3f}} µm, U with k = {COVERAGE_FACTOR}<br>{at}'
                             '<extra>recovered</extra>'}
    claimed = [] if curve.claimed is None else [
        {**common, 'y': packed(1e6 * curve.claimed), 'name': 'claimed', 'line': {'color': BEFORE, 'dash': 'dash'},
         'hovertemplate': f'%{{y}} µm<br>{at}<extra>claimed</extra>'}]
    return [{**band_trace(x, value, spread, AFTER), **_axes(place)}, line, *claimed]


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
    hover = f'{HOVER.replace("NOISE", noise)}{block}<extra></extra>'
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
        np.sqrt(np.mean(residual[shown]**2, axis=1)) / noise, shown + 1, (run.time[shown] - run.time[0]) / 60])
    texts = [[''] * count for _ in range(count)]
    for k in shown:
        texts[row[k]][column[k]] = ', '.join(f'{name} {signed(size, 3)}'
                                             for name, size in zip(AXES, residual[k], strict=True))
    return values, readings, texts


def time_figure(fit: Fit, colour: str = AFTER, chosen: int | None = None) -> PlotlyFigure:
    """Return residuals of x, y, z against time, with lines at twice the repeatability, where it is known.

    chosen: index of a reading that is marked."""
    run, residual, (noise, name) = fit.run, 1e6 * fit.residual, noise_of(fit)
    minutes, limit = (run.time - run.time[0]) / 60, 2e6 * noise
    data, layout = [], _panels(3, 1, gap=(0.0, 0.08), margin={'t': 24})
    for place, (axis, symbol) in enumerate(zip(AXES, ('circle', 'square', 'diamond'), strict=True), 1):
        shown = _thinned(residual[:, place - 1])
        data.append({
            'type': 'scatter', 'mode': 'markers' if run.size <= MOST_MARKS else 'lines', 'name': axis,
            'x': packed(minutes[shown]), 'y': packed(residual[shown, place - 1]), **_axes(place),
            'marker': {'size': 4, 'color': colour, 'symbol': symbol}, 'showlegend': False,
            'line': {'color': colour, 'width': 1},
            'hovertemplate': f'{axis} %{{y}} µm at %{{x:.1f}} min<extra></extra>'})
        x = {'title': {'text': 'time / min'}} if place == 3 else {'showticklabels': False, 'matches': 'x3'}
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


def ladder_figure(ladder: Sequence[LadderStep], present: int, noise: float | None = None) -> PlotlyFigure:
    """Return the error of each model from the base on; so many as `present` are in the model, the others proposed."""
    labels = [name.replace('_', '_<br>').replace('(', '<br>(') for name in nested_names(ladder)]
    labels = [label if k < present else f'<i>{label} ?</i>' for k, label in enumerate(labels)]
    places, ends = list(range(len(ladder))), [-0.35, len(ladder) - 0.65]
    series = (('fit', [1e6 * step.fit.rms for step in ladder], AFTER, 'circle'),
              ('cross-validation', [1e6 * step.cross_validation for step in ladder], COLOURS[4], 'square'))
    data: list[PlotlyFigure] = [
        {'type': 'scatter', 'mode': 'lines+markers', 'x': places, 'y': packed(values), 'name': name,
         'line': {'color': colour, 'width': 2}, 'marker': {'size': 8, 'symbol': symbol},
         'hovertemplate': f'%{{y}} µm<extra>{name}</extra>'} for name, values, colour, symbol in series]
    if noise is not None:
        data.append({'type': 'scatter', 'mode': 'lines', 'x': ends, 'y': [1e6 * noise] * 2,
                     'name': 'repeatability', 'line': {'color': COLOURS[2], 'width': 2, 'dash': 'dash'},
                     'hovertemplate': 'repeatability %{y} µm<extra></extra>'})
    layout = layout_of(legend=True, margin={'l': 52})
    layout['xaxis'] = {'tickvals': places, 'ticktext': labels, 'range': ends, 'automargin': True, 'tickangle': 0,
                       'tickfont': {'size': 11 if len(labels) < 4 else 9}}
    layout['yaxis'] = {'title': {'text': 'rms / µm'}, 'rangemode': 'tozero'}
    return figure_of(data, layout)


def filling_figure(n: int, cells: Mapping[tuple[int, int], float]) -> PlotlyFigure:
    """Return a map of the ball centres received so far; cells: of CellState."""
    values: list[list[float | None]] = [[None] * n for _ in range(n)]
    for (position, ball), size in cells.items():
        values[position - 1][ball - 1] = round(1e6 * size, 1)
    numbers = list(range(1, n + 1))
    data = [{'type': 'heatmap', 'z': values, 'x': numbers, 'y': numbers, 'colorscale': 'Cividis', 'xgap': 1, 'ygap': 1,
             'colorbar': {'title': {'text': 'µm', 'side': 'top'}, 'thickness': 12},
             'hovertemplate': 'table position %{y}, ball %{x}<br>%{z} µm from its expected place<extra></extra>'}]
    layout = layout_of(margin={'l': 52, 't': 12})
    layout['xaxis'] = {'dtick': _tick(n), 'range': [0.5, n + 0.5], 'title': {'text': 'ball'}}
    layout['yaxis'] = {'dtick': _tick(n), 'range': [n + 0.5, 0.5], 'title': {'text': 'table position'}}
    return figure_of(data, layout)


def budget_height(made: Budget) -> int:
    """Return the height of budget_figure, px."""
    return 2 * (15 * len(made.contributions) + 75)


def budget_figure(made: Budget) -> PlotlyFigure:
    """Return bars: standard uncertainty of each curve by contribution, the longest on top, and what they make."""
    names = [*(one.name for one in made.contributions), 'combined']
    kinds = [*('hidden' if one.is_bound else one.kind for one in made.contributions), '']
    values, labels = np.vstack([*(one.mean for one in made.contributions), made.mean]), list(dict.fromkeys(names))
    data, layout = [], _panels(2, 3, gap=(0.08, 0.25), legend=True, margin={'l': 190})
    for place, (curve, unit) in enumerate(zip(CURVES, CURVE_UNITS, strict=True), 1):
        for kind, (label, look) in BARS.items():
            rows = [row for row, one in enumerate(kinds) if one == kind]
            data.append({
                'type': 'bar', 'orientation': 'h', 'y': [names[row] for row in rows],
                'x': packed(1e6 * values[rows, place - 1]), 'name': label, 'legendgroup': label,
                'showlegend': place == 1 and bool(rows), 'marker': look, **_axes(place),
                'hovertemplate': f'%{{y}}: u = %{{x:.3f}} {unit}<extra>{curve}</extra>'})
        y = {'categoryorder': 'array', 'categoryarray': labels[::-1], 'automargin': False,
             'showticklabels': place % 3 == 1, 'tickfont': {'size': 11}}
        _set_panel(layout, place, {'rangemode': 'tozero', 'nticks': 4}, y, f'<b>{curve}</b> u / {unit}')
    return figure_of(data, layout | {'barmode': 'overlay', 'bargap': 0.25})


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

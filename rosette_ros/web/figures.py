# SPDX-License-Identifier: Apache-2.0
"""The pictures of the page as Plotly figures: plain dicts of data and layout, made of records.

Colours of text, grid and ground come from the page's style sheet, so that one figure serves light
and dark. What would be too much for a browser is thinned, and says so.
"""

from base64 import b64encode
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rosette_ros.core.compare import AXES
from rosette_ros.core.records import ISO_NAMES
from rosette_ros.pictures.style import COLOURS
from rosette_ros.report_json import COVERAGE_FACTOR

NOW, THEN = COLOURS[0], COLOURS[1]
"""The model as it is, and with the preview."""
LAYOUT = ('ctx', 'cty', 'ctz', 'crx', 'cry', 'crz')
MEANING = {'ctx': 'radial x', 'cty': 'radial y', 'ctz': 'axial', 'crx': 'tilt about x',
           'cry': 'tilt about y', 'crz': 'positioning'}
DIVERGING = ((0, '#0072b2'), (0.25, '#7fb8d8'), (0.5, '#f2f2f2'), (0.75, '#eaae7f'), (1, '#d55e00'))
MOST_CELLS = 64
"""A map of more rows is thinned to at most so many; each block shows its largest residual."""
MOST_GAPS = 20
"""Cells of a map of at most so many rows stand apart."""
MOST_MARKS = 1500
"""A line of more points shows the lowest and highest of each section."""
CONFIG = {'displaylogo': False, 'responsive': True, 'displayModeBar': False}
FONT = 'Roboto, system-ui, sans-serif'
HOVER = ('table position %{customdata[0]}, ball %{customdata[1]}, CMM position %{customdata[2]}'
         '<br>x %{customdata[3]:+.3f}, y %{customdata[4]:+.3f}, z %{customdata[5]:+.3f} µm'
         '<br>size %{customdata[6]:.1f} σ<br>reading %{customdata[7]}, at %{customdata[8]:.1f} min')
SYMBOLS = ('circle', 'square', 'diamond')


@dataclass(frozen=True, eq=False)
class Line:
    """Six curves to draw: a name, the ErrorMotions, and the colour."""

    name: str
    motions: object
    colour: str
    dash: str = 'solid'


def curve_unit(curve):
    """Return the unit in which a curve is shown."""
    return 'µm' if curve.startswith('ct') else 'µrad'


def curves_figure(lines):
    """Return six panels of curves against the table angle with bands of U (k = 2)."""
    data, layout = [], _grid(2, 3, gap=(0.075, 0.22))
    notes = []
    for place, curve in enumerate(LAYOUT, 1):
        unit = curve_unit(curve)
        for line in lines:
            data += _curve(line, curve, unit, place)
        layout[_axis('x', place)] |= {'range': [-8, 368], 'tickvals': [0, 90, 180, 270, 360]}
        layout[_axis('y', place)] |= {'zeroline': True}
        if place > 3:
            layout[_axis('x', place)]['title'] = _title('table angle / °')
        notes.append(_heading(layout, place, f'<b>{curve}</b> {MEANING[curve]} / {unit}'))
    return _figure(data, layout, notes, legend=True)


def _curve(line, curve, unit, place):
    angle = np.rad2deg(line.motions.angle)
    value, spread = 1e6 * line.motions[curve], COVERAGE_FACTOR * 1e6 * line.motions.uncertainty(curve)
    angle = np.append(angle, angle[0] + 360)
    value, spread = np.append(value, value[0]), np.append(spread, spread[0])
    axes = {'xaxis': f'x{place}' if place > 1 else 'x', 'yaxis': f'y{place}' if place > 1 else 'y'}
    band = {'type': 'scatter', 'x': _array(np.concatenate([angle, angle[::-1]])),
            'y': _array(np.concatenate([value + spread, (value - spread)[::-1]])), 'fill': 'toself',
            'fillcolor': _clear(line.colour, 0.22), 'line': {'width': 0}, 'hoverinfo': 'skip',
            'mode': 'lines', 'showlegend': False, 'legendgroup': line.name, **axes}
    marks = {'type': 'scatter', 'x': _array(angle), 'y': _array(value), 'name': line.name,
             'mode': 'lines+markers' if value.size <= 80 else 'lines', 'legendgroup': line.name,
             'showlegend': place == 1, 'customdata': _array(spread),
             'marker': {'size': 5, 'symbol': 'circle' if line.dash == 'solid' else 'square'},
             'line': {'color': line.colour, 'width': 2, 'dash': line.dash},
             'hovertemplate': f'{curve} ({ISO_NAMES[curve]}) %{{y:.3f}} ± %{{customdata:.3f}} {unit}'
                              f'<br>at %{{x:.2f}}°, U with k = {COVERAGE_FACTOR}<extra>{line.name}</extra>',
             **axes}
    return [band, marks]


def maps_figure(report, scale=None):
    """Return three maps of residuals, table position against ball, one per axis.

    scale: Report whose residuals span the colours, so that two models can be held against each other.

    Hovering a cell tells the reading; its size is the rms over the axes in units of what the noise
    leaves there on average.
    """
    run, residual = report.run, 1e6 * report.fit.residual
    step = -(-run.n // MOST_CELLS)
    top = 1e6 * float(np.abs((scale or report).fit.residual).max()) or 1.0
    data, layout, notes = [], _grid(1, 3, gap=(0.06, 0.2)), []
    layout['margin'] |= {'r': 64, 't': 24}
    count = -(-run.n // step)
    centre = 1 + step * np.arange(count) + (step - 1) / 2
    gap = 1 if count <= MOST_GAPS else 0
    for place, axis in enumerate(AXES, 1):
        values, readings = _cells(report, residual, place - 1, step)
        data.append({
            'type': 'heatmap', 'z': _array(values), 'x': _array(centre), 'y': _array(centre),
            'zmin': -top, 'zmax': top, 'colorscale': DIVERGING, 'customdata': _array(readings),
            'hovertemplate': HOVER + (f'<br>the largest of {step} × {step} readings' if step > 1 else '')
            + '<extra></extra>', 'xgap': gap, 'ygap': gap, 'showscale': place == 3,
            'colorbar': {'title': {'text': 'µm', 'side': 'top'}, 'thickness': 12, 'len': 1.02, 'x': 1.01},
            'xaxis': f'x{place}' if place > 1 else 'x', 'yaxis': f'y{place}' if place > 1 else 'y'})
        layout[_axis('x', place)] |= {'title': _title('ball'), 'dtick': _tick(run.n), 'tickangle': 0}
        layout[_axis('y', place)] |= {'autorange': 'reversed', 'dtick': _tick(run.n)}
        if place == 1:
            layout[_axis('y', place)]['title'] = _title('table position')
        notes.append(_heading(layout, place, f'residual in <b>{axis}</b> / µm'))
    return _figure(data, layout, notes)


def _tick(n):
    return next(step for step in (1, 2, 3, 5, 10, 20, 50, 100) if n / step <= 12 or step == 100)


def _cells(report, residual, axis, step):
    """Return values and what HOVER tells of each cell; a cell is a block of step x step readings."""
    run, fit = report.run, report.fit
    count = -(-run.n // step)
    row, column = (run.table_position - 1) // step, (run.ball - 1) // step
    block = row * count + column
    order = np.lexsort((np.abs(residual[:, axis]), block))
    shown = order[np.flatnonzero(np.diff(block[order], append=-1))]  # of each block the largest
    values, readings = np.full((count, count), np.nan), np.full((count, count, 9), np.nan)
    values[row[shown], column[shown]] = residual[shown, axis]
    left = 1e6 * fit.sigma * np.sqrt(fit.dof / residual.size)
    readings[row[shown], column[shown]] = np.column_stack([
        run.table_position[shown], run.ball[shown], run.cmm_position[shown], residual[shown],
        np.sqrt(np.mean(residual[shown]**2, axis=1)) / left, shown + 1, (run.time[shown] - run.time[0]) / 60])
    return values, readings


def time_figure(report):
    """Return residuals of x, y, z against time, with lines at twice sigma."""
    run, residual = report.run, 1e6 * report.fit.residual
    minutes = (run.time - run.time[0]) / 60
    data, layout, notes = [], _grid(3, 1, gap=(0.02, 0.06)), []
    layout['margin']['t'] = 10
    sigma = 2e6 * report.fit.sigma
    for place, axis in enumerate(AXES, 1):
        shown = _thinned(residual[:, place - 1])
        data.append({
            'type': 'scatter', 'mode': 'markers' if run.size <= MOST_MARKS else 'lines',
            'x': _array(minutes[shown]), 'y': _array(residual[shown, place - 1]), 'name': axis,
            'marker': {'size': 4, 'color': NOW, 'symbol': SYMBOLS[place - 1]},
            'line': {'color': NOW, 'width': 1}, 'showlegend': False,
            'hovertemplate': f'{axis} %{{y:+.3f}} µm at %{{x:.1f}} min<extra></extra>',
            'xaxis': f'x{place}' if place > 1 else 'x', 'yaxis': f'y{place}' if place > 1 else 'y'})
        layout[_axis('y', place)] |= {'title': _title(f'{axis} / µm'), 'zeroline': True, 'nticks': 5}
        if place == 3:
            layout[_axis('x', place)]['title'] = _title('time / min')
        else:
            layout[_axis('x', place)] |= {'showticklabels': False, 'matches': 'x3'}
    layout['shapes'] = [_rule(place, sign * sigma) for place in (1, 2, 3) for sign in (-1, 1)]
    return _figure(data, layout, notes)


def _rule(place, height):
    axis = '' if place == 1 else str(place)
    return {'type': 'line', 'xref': f'x{axis} domain', 'yref': f'y{axis}', 'x0': 0, 'x1': 1, 'y0': height,
            'y1': height, 'line': {'color': COLOURS[1], 'width': 1, 'dash': 'dot'}}


def _thinned(values):
    """Return the indices of all values, or of the extremes of as many sections as can be shown."""
    if values.size <= MOST_MARKS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, MOST_MARKS // 2 + 1).astype(int)
    pairs = [(a + int(np.argmin(values[a:b])), a + int(np.argmax(values[a:b])))
             for a, b in pairwise(edges)]
    return np.unique(np.array(pairs).reshape(-1))


def ladder_figure(rungs, present, noise=None):
    """Return the error of each model from the base on: in the fit and in readings left out.

    present: how many rungs are the model as it is, the others are only proposed; noise: standard
    deviation of the repeatability, m, or None.
    """
    labels = [_wrapped(f'+ {rung.added}' if rung.added else 'base model') for rung in rungs]
    labels = [label if k < present else f'<i>{label} ?</i>' for k, label in enumerate(labels)]
    series = [('fit', [1e6 * rung.report.fit.rms for rung in rungs], NOW, 'circle'),
              ('readings left out', [1e6 * rung.held_out for rung in rungs], THEN, 'square')]
    places = list(range(len(rungs)))
    data = [{'type': 'scatter', 'mode': 'lines+markers', 'x': places, 'y': _array(np.array(values)),
             'name': name, 'line': {'color': colour, 'width': 2}, 'marker': {'size': 8, 'symbol': symbol},
             'hovertemplate': f'%{{y:.3f}} µm<extra>{name}</extra>'} for name, values, colour, symbol in series]
    layout = {'xaxis': {'tickvals': places, 'ticktext': labels, 'range': [-0.35, len(rungs) - 0.65],
                        'zeroline': False, 'fixedrange': True},
              'yaxis': {'title': _title('rms / µm'), 'rangemode': 'tozero', 'fixedrange': True},
              'margin': {'l': 52, 'r': 12, 't': 30, 'b': 44}}
    if noise is not None:
        data.append({'type': 'scatter', 'mode': 'lines', 'x': [-0.35, len(rungs) - 0.65], 'y': [1e6 * noise] * 2,
                     'name': 'noise', 'line': {'color': COLOURS[2], 'width': 2, 'dash': 'dash'},
                     'hovertemplate': 'noise %{y:.3f} µm<extra></extra>'})
    return _figure(data, layout, [], legend=True)


def _wrapped(text):
    return text if len(text) < 16 else text.replace('_', '_<br>', 1)


def filling_figure(n, cells):
    """Return a map of the ball centres that have come: table position against ball.

    cells: {(table_position, ball): distance from the nominal place, m}.
    """
    values = [[None] * n for _ in range(n)]
    for (position, ball), size in cells.items():
        values[position - 1][ball - 1] = round(1e6 * size, 1)
    numbers = list(range(1, n + 1))
    data = [{'type': 'heatmap', 'z': values, 'x': numbers, 'y': numbers, 'colorscale': 'Cividis',
             'xgap': 1, 'ygap': 1, 'colorbar': {'title': {'text': 'µm', 'side': 'top'}, 'thickness': 12},
             'hovertemplate': 'table position %{y}, ball %{x}<br>%{z} µm from its nominal place'
                              '<extra></extra>'}]
    axis = {'dtick': _tick(n), 'range': [0.5, n + 0.5], 'zeroline': False}
    layout = {'xaxis': {**axis, 'title': _title('ball')},
              'yaxis': {**axis, 'title': _title('table position'), 'range': [n + 0.5, 0.5]},
              'margin': {'l': 52, 'r': 12, 't': 12, 'b': 44}}
    return _figure(data, layout, [])


# How all of them look


def _figure(data, layout, notes, legend=False):
    layout = {'paper_bgcolor': 'rgba(0,0,0,0)', 'plot_bgcolor': 'rgba(0,0,0,0)', 'font': {'size': 12, 'family': FONT},
              'margin': {'l': 48, 'r': 12, 't': 30, 'b': 44}, 'showlegend': legend, 'hovermode': 'closest',
              'legend': {'orientation': 'h', 'x': 1, 'xanchor': 'right', 'y': 1.0, 'yref': 'container',
                         'yanchor': 'top'}, 'annotations': notes, **layout}
    return {'data': data, 'layout': layout, 'config': CONFIG}


def _grid(rows, columns, gap):
    """Return a layout of panels, numbered along the rows from the top left."""
    across, down = gap
    width, height = (1 - across * (columns - 1)) / columns, (1 - down * (rows - 1)) / rows
    layout = {'margin': {'l': 48, 'r': 12, 't': 46, 'b': 44}}
    for place in range(1, rows * columns + 1):
        row, column = divmod(place - 1, columns)
        left, top = column * (width + across), 1 - row * (height + down)
        tail = '' if place == 1 else str(place)
        layout[_axis('x', place)] = {'domain': [left, min(left + width, 1)], 'anchor': f'y{tail}',
                                     'zeroline': False, 'fixedrange': True}
        layout[_axis('y', place)] = {'domain': [max(top - height, 0), top], 'anchor': f'x{tail}',
                                     'zeroline': False, 'fixedrange': True}
    return layout


def _heading(layout, place, text):
    """Return the note that stands above a panel, at its left edge."""
    return {'xref': 'paper', 'yref': 'paper', 'x': layout[_axis('x', place)]['domain'][0],
            'y': layout[_axis('y', place)]['domain'][1], 'xanchor': 'left', 'yanchor': 'bottom',
            'text': text, 'showarrow': False, 'font': {'size': 12}}


def _axis(letter, place):
    return f'{letter}axis' if place == 1 else f'{letter}axis{place}'


def _title(text):
    return {'text': text, 'standoff': 6, 'font': {'size': 12}}


def _array(values):
    """Return numbers as Plotly's typed array: short on the way, and quick for the browser."""
    values = np.ascontiguousarray(values, dtype='<f4')
    made = {'dtype': 'f4', 'bdata': b64encode(values).decode('ascii')}
    return made | {'shape': ', '.join(map(str, values.shape))} if values.ndim > 1 else made


def _clear(colour, share):
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    return f'rgba({red},{green},{blue},{share})'

# SPDX-License-Identifier: Apache-2.0
"""Figures in the plane of the table: the cell seen from above while it measures, its plate, polar plots of curves."""

from collections.abc import Collection, Sequence
from itertools import product
from typing import Any

import numpy as np

from rosette_ros.core.error_summary import once_per_turn
from rosette_ros.core.geometry import TWO_PI, nominal_angles, rotate_z
from rosette_ros.core.records import CURVES, Floats
from rosette_ros.core.scheme import cmm_position, nominal_places
from rosette_ros.presentation.formatting import COVERAGE_FACTOR, CURVE_UNITS, iso_name
from rosette_ros.presentation.plots.plot_style import AFTER, BEFORE, COLOURS
from rosette_ros.presentation.plots.polar_plots import SHOWN
from rosette_ros.presentation.plots.result_plots import LONGEST, MEANING, freed_plate, scale_arrow
from rosette_ros.studio.figures import DIVERGING, Curves, PlotlyFigure, band_trace, figure_of, layout_of, packed
from rosette_ros.studio.live_state import CellView, ReadingPlace

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
CIRCLE = np.linspace(0, TWO_PI, 181)


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
    layout['annotations'] = [_text(0, -0.25 if np.sin(turned) > -0.2 else 0.25, _words(view))]
    layout['annotations'] += [_text(NAMES * np.cos(angle), NAMES * np.sin(angle), str(number))
                              for number, angle in enumerate(nominal_angles(n) + offset, 1)
                              if n <= MOST_DOTS and (n <= 18 or number % 3 == 1)]
    free = {'visible': False, 'fixedrange': True}
    layout |= {'xaxis': {**free, 'range': [-2.6, 2.6]}, 'yaxis': {**free, 'range': [-2.6, 2.6], 'scaleanchor': 'x'}}
    return figure_of(data, layout)


def _words(view: CellView) -> str:
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


def _text(x: float, y: float, words: str) -> PlotlyFigure:
    return {'x': x, 'y': y, 'text': words, 'showarrow': False, 'font': {'size': 12}}


def plate_figure(plate: Floats, radius: float) -> PlotlyFigure:
    """Return the deviations (n, 3), m, of a plate as if it lay true on the table: arrows in x, y, colours in z."""
    freed, words = freed_plate(plate, radius)
    known = np.flatnonzero(np.isfinite(freed).all(axis=1))
    values, beta = 1e6 * freed[known], nominal_angles(len(plate))[known]
    start = np.stack([np.cos(beta), np.sin(beta)], axis=-1)
    longest = float(np.hypot(*values[:, :2].T).max(initial=0)) or 1.0
    ends = start + LONGEST / longest * values[:, :2]
    lines = np.stack([start, ends, np.full(start.shape, np.nan)], axis=1).reshape(-1, 2)
    top = float(np.abs(values[:, 2]).max(initial=0)) or 1.0
    length = scale_arrow(longest)
    data: list[PlotlyFigure] = [
        {'type': 'scatter', 'mode': 'lines', 'x': packed(np.cos(CIRCLE)), 'y': packed(np.sin(CIRCLE)),
         'line': {'color': SOFT, 'width': 1}, 'hoverinfo': 'skip'},
        {'type': 'scatter', 'mode': 'lines', 'x': packed(lines[:, 0]), 'y': packed(lines[:, 1]),
         'line': {'color': COLOURS[2], 'width': 2.5}, 'hoverinfo': 'skip'},
        {'type': 'scatter', 'mode': 'markers+text', 'x': packed(start[:, 0]), 'y': packed(start[:, 1]),
         'text': [str(one + 1) for one in known], 'textposition': 'bottom center', 'customdata': packed(values),
         'marker': {'size': 13, 'color': packed(values[:, 2]), 'colorscale': DIVERGING, 'cmin': -top, 'cmax': top,
                    'symbol': ['triangle-up' if one >= 0 else 'triangle-down' for one in values[:, 2]],
                    'line': {'width': 1, 'color': '#555555'},
                    'colorbar': {'title': {'text': 'z / µm', 'side': 'top'}, 'thickness': 12}},
         'hovertemplate': 'ball %{text}<br>x %{customdata[0]:.3f}, y %{customdata[1]:.3f}, z %{customdata[2]:.3f} µm'
                          '<extra></extra>'},
        {'type': 'scatter', 'mode': 'lines', 'x': [-1.9, -1.9 + LONGEST * length / longest], 'y': [-1.35, -1.35],
         'line': {'color': COLOURS[2], 'width': 2.5}, 'hoverinfo': 'skip'}]
    layout = layout_of(margin={'l': 4, 'r': 4, 't': 30, 'b': 4})
    free = {'visible': False, 'fixedrange': True}
    layout |= {'xaxis': {**free, 'range': [-2, 2]}, 'yaxis': {**free, 'range': [-1.6, 1.5], 'scaleanchor': 'x'}}
    layout['annotations'] = [
        {**_text(-1.9, -1.5, f'{length:g} µm'), 'xanchor': 'left'},
        {**_text(0, 1.02, f'without {words}'), 'xref': 'paper', 'yref': 'paper', 'xanchor': 'left',
         'yanchor': 'bottom'}]
    return figure_of(data, layout)


def polar_figure(every: Sequence[Curves]) -> PlotlyFigure:
    """Return radial and tilt motion over the table angle (ISO 230-7), µm and µrad, deviation outwards.

    Of the first curves also the reference circle, mean + Re(c exp(-i angle)): the least-squares one.
    """
    data, layout = list[PlotlyFigure](), layout_of(legend=True, margin={'l': 8, 'r': 8, 't': 56, 'b': 8})
    for place, curve in enumerate(SHOWN):
        unit, name = CURVE_UNITS[CURVES.index(curve)], f'polar{place + 1 if place else ""}'
        top = max(1e6 * float(np.max(np.abs(one.motions[curve]) + COVERAGE_FACTOR * one.motions.uncertainty(curve)))
                  for one in every) or 1.0
        for one in every:
            data += _polar(one, curve, unit, name, place == 0)
        first = every[0].motions
        values, turn = 1e6 * first[curve], np.rad2deg(CIRCLE)
        once = once_per_turn(values, first.angle)
        fitted = values.mean() + (once * np.exp(-1j * CIRCLE)).real
        for label, radius, look in (('no deviation', np.zeros(CIRCLE.size), {'color': '#8a8a8a', 'width': 1}),
                                    ('reference circle', fitted, {'color': COLOURS[2], 'width': 1.5, 'dash': 'dash'})):
            data.append({'type': 'scatterpolar', 'subplot': name, 'mode': 'lines', 'theta': packed(turn),
                         'r': packed(radius), 'name': label, 'legendgroup': label, 'showlegend': place == 0,
                         'line': look, 'hoverinfo': 'skip'})
        left = 0.04 + 0.25 * place
        layout[name] = {
            'domain': {'x': [left, left + 0.17], 'y': [0.04, 0.86]}, 'bgcolor': 'rgba(0,0,0,0)',
            'radialaxis': {'range': [-1.9 * top, 1.05 * top], 'nticks': 3, 'gridcolor': SOFT, 'angle': 45,
                           'tickangle': 0, 'tickfont': {'size': 10}, 'linecolor': SOFT, 'fixedrange': True},
            'angularaxis': {'dtick': 90, 'gridcolor': SOFT, 'linecolor': SOFT, 'tickfont': {'size': 10}}}
        layout['annotations'].append({
            'xref': 'paper', 'yref': 'paper', 'x': left - 0.02, 'y': 1.0, 'xanchor': 'left', 'yanchor': 'bottom',
            'showarrow': False, 'font': {'size': 12}, 'text': f'<b>{curve}</b> {MEANING[curve]} / {unit}'})
    return figure_of(data, layout)


def _polar(one: Curves, curve: str, unit: str, subplot: str, is_first: bool) -> list[PlotlyFigure]:
    """Return the band and the line of one curve, closed to a whole turn."""
    theta, value, spread = (np.append(values, values[0]) for values in (
        np.rad2deg(one.motions.angle), 1e6 * one.motions[curve],
        COVERAGE_FACTOR * 1e6 * one.motions.uncertainty(curve)))
    common = {'type': 'scatterpolar', 'subplot': subplot, 'legendgroup': one.name}
    band = band_trace(theta, value, spread, one.colour)
    band |= {'theta': band.pop('x'), 'r': band.pop('y')} | common
    return [band, {
        **common, 'theta': packed(theta), 'r': packed(value), 'name': one.name, 'showlegend': is_first,
        'mode': 'lines+markers', 'marker': {'size': 4}, 'line': {'color': one.colour, 'width': 2, 'dash': one.dash},
        'customdata': packed(spread), 'hovertemplate':
        f'{curve} ({iso_name(curve, one.motions.rotation)}) %{{r:.3f}} ± %{{customdata:.3f}} {unit}<br>at '
        f'%{{theta:.2f}}°, U with k = {COVERAGE_FACTOR}<extra>{one.name}</extra>'}]

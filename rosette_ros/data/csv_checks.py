# SPDX-License-Identifier: Apache-2.0
"""What makes a ball-centre table a run: indices, order, angles and places that fit each other."""

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import TWO_PI
from rosette_ros.core.scheme import cmm_position
from rosette_ros.data.assemble import MAX_BALLS
from rosette_ros.data.places import misplaced, nominal_places

_UNIT = 2.0  # factor within which a ratio of radii is taken for a wrong unit


def find_balls(table):
    """Return n, the number of balls and table positions, from the heading or the largest index.

    Raises InvalidData where an index is out of range, or heading and rows disagree.
    """
    columns = table.columns
    for name in ('table_position', 'ball'):
        low = np.flatnonzero(columns[name] < 1)
        if low.size:
            raise table.wrong(low[0], name, 'at least 1', columns[name][low[0]],
                              'indices count from 1')
    n = _inferred(table) if table.balls is None else table.balls
    if not 3 <= n <= MAX_BALLS:
        raise InvalidData(f'{table.source}: wanted 3 to {MAX_BALLS} balls, got {n}')
    for name in ('table_position', 'ball'):
        high = np.flatnonzero(columns[name] > n)
        if high.size:
            raise table.wrong(high[0], name, f'1..{n}', columns[name][high[0]],
                              f'the heading says "# balls: {n}"')
    _check_heading(table, n)
    return n


def _inferred(table):
    last = {name: int(table.columns[name].max()) for name in ('table_position', 'ball')}
    if last['table_position'] == last['ball']:
        return last['ball']
    larger = max(last, key=last.get)
    smaller = min(last, key=last.get)
    row = int(np.argmax(table.columns[larger]))
    raise table.wrong(row, larger, f'at most {last[smaller]}, as far as {smaller} goes',
                      last[larger], 'as many table positions as balls are measured; if some are '
                      f'missing, say so by "# balls: {last[larger]}"')


def _check_heading(table, n):
    """Refuse a heading that names more balls than a complete run has."""
    if table.balls is None:
        return
    i, j = table.columns['table_position'], table.columns['ball']
    last = int(max(i.max(), j.max()))
    if last < n and np.unique(i * (n + 1) + j).size == last * last:
        raise InvalidData(f'{table.source}: wanted a run with {n} balls, as the heading says '
                          f'("# balls: {n}"), got a complete one with {last}; correct the heading')


def check_readings(table, n):
    """Return the table angles in rad, (N,), once order, indices, angles and places fit.

    Raises InvalidData that names the line where they do not.
    """
    _check_approach(table)
    _check_order(table)
    _check_pairs(table)
    _check_cmm_position(table, n)
    angle = _angles(table, n)
    _check_places(table, n)
    return angle


def _check_approach(table):
    approach = table.columns.get('approach', np.zeros(0))
    bad = np.flatnonzero(np.abs(approach) > 1)
    if bad.size:
        raise table.wrong(bad[0], 'approach', '1, -1 or 0 (unknown)', approach[bad[0]],
                          'it is the sense of the last move of the table, counter-clockwise 1')


def _check_order(table):
    seq, time = table.columns['seq'], table.columns['time_s']
    back = np.flatnonzero(np.diff(seq) <= 0)
    if back.size:
        row = back[0] + 1
        raise table.wrong(row, 'seq', f'more than {seq[row - 1]}, the row before', seq[row],
                          'rows stand in the order of measuring')
    back = np.flatnonzero(np.diff(time) < 0)
    if back.size:
        row = back[0] + 1
        raise table.wrong(row, 'time_s', f'at least {time[row - 1]:.12g}, the row before',
                          f'{time[row]:.12g}', 'rows stand in the order of measuring')


def _check_pairs(table):
    if table.repeats:
        return
    pairs = np.stack([table.columns['table_position'], table.columns['ball']], axis=-1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    again = np.flatnonzero((np.diff(pairs[order], axis=0) == 0).all(axis=1))
    if again.size:
        first, second = order[again[0]], order[again[0] + 1]
        i, j = pairs[second]
        raise InvalidData(
            f'{table.source}: line {table.lines[second]}: wanted each pair of table position and '
            f'ball once, got table_position {i}, ball {j} again (first in line '
            f'{table.lines[first]}); remove one, or say "# repeated_balls: yes"')


def _check_cmm_position(table, n):
    given = table.columns.get('cmm_position')
    if given is None:
        return
    i, j = table.columns['table_position'], table.columns['ball']
    wanted = cmm_position(n, i, j)
    bad = np.flatnonzero(given != wanted)
    if bad.size:
        row = bad[0]
        raise table.wrong(row, 'cmm_position', f'{wanted[row]} for table_position {i[row]}, ball '
                          f'{j[row]} of {n}: (i + j - 2) mod n + 1', given[row],
                          'if there are more balls, say so by "# balls: ..."')


def _angles(table, n):
    """Return the table angles, nominal where the cell says no more than that, (N,), rad."""
    angle = table.columns['table_angle_deg']
    position = table.columns['table_position'] - 1
    nominal = 360.0 * position / n
    deviation = (angle - nominal + 180.0) % 360.0 - 180.0
    bad = np.flatnonzero(np.abs(deviation) > 180.0 / n)
    if bad.size:
        row = bad[0]
        raise table.wrong(row, 'table_angle_deg', f'about {nominal[row]:.6g} for table_position '
                          f'{position[row] + 1} of {n}', table.angle_cells[row].strip(),
                          _angle_advice(angle, nominal, n))
    unit = _last_decimal(table.angle_cells)
    turns = np.rint((angle - nominal) / 360.0)
    exact = TWO_PI * position / n
    exact = np.where(turns == 0, exact, exact + TWO_PI * turns)
    return np.where(np.abs(deviation) <= 0.5 * unit * (1 + 1e-6), exact, np.deg2rad(angle))


def _last_decimal(cells):
    """Return the value of the last written decimal of each number, (N,): 0.01 for 51.43."""
    texts = np.strings.lower(np.strings.strip(np.array(cells)))
    mantissa, _, exponent = np.strings.partition(texts, 'e')
    point = np.strings.find(mantissa, '.')
    decimals = np.where(point < 0, 0, np.strings.str_len(mantissa) - point - 1)
    return 10.0 ** (np.where(exponent == '', '0', exponent).astype(float) - decimals)


def _angle_advice(angle, nominal, n):
    def near(wanted, tolerance):
        return np.all(np.abs((angle - wanted + 180.0) % 360.0 - 180.0) <= tolerance)

    if np.all(np.abs(angle - np.deg2rad(nominal)) < 0.02):
        return 'these are radians; write degrees'
    if near(-nominal, 180.0 / n):
        return 'the table counts clockwise; table positions and angles count counter-clockwise'
    return 'is the number of balls right? If some are missing, say so by "# balls: ..."'


def _check_places(table, n):
    """Refuse ball centres that lie nearer to another ball's place than to their own."""
    columns, radius = table.columns, table.radius * 1e3
    centre = np.stack([columns[f'{axis}_mm'] for axis in 'xyz'], axis=-1)
    _check_units(table, np.median(np.hypot(centre[:, 0], centre[:, 1])), radius)
    i, j = columns['table_position'], columns['ball']
    bad = misplaced(n, radius, i, j, centre)
    if bad.size:
        row = bad[0]
        x, y, _ = nominal_places(n, radius, i, j)[row]
        got = ', '.join(f'{value:.3f}' for value in centre[row])
        raise table.wrong(row, 'x_mm, y_mm, z_mm', f'a place near ({x:.3f}, {y:.3f}, 0) for '
                          f'table_position {i[row]}, ball {j[row]}', f'({got})',
                          'coordinates stand in the table frame: z along the axis, ball 1 on +x '
                          'at table position 1, counted counter-clockwise')


def _check_units(table, measured, radius):
    """Refuse a radius and coordinates whose ratio tells of a wrong unit, both in mm."""
    for factor, unit in ((1e-3, 'metres'), (1e3, 'micrometres')):
        if not 1 / _UNIT < measured / radius / factor < _UNIT:
            continue
        if factor == 1e3 and radius < 1:
            raise InvalidData(
                f'{table.source}: radius_mm: wanted about {measured:.4g}, as far as the ball '
                f'centres lie from the axis, got {radius:.6g}; this is metres, write millimetres')
        raise InvalidData(
            f'{table.source}: columns x_mm, y_mm: wanted coordinates about {radius:.6g} mm from '
            f'the axis, as radius_mm says, got {measured:.4g}; these are {unit}, write '
            'millimetres')


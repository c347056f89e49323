# SPDX-License-Identifier: Apache-2.0
"""What the touches of a run show, for people and programs: spheres fitted again, ball form, probe lobing."""

from collections.abc import Iterable
from functools import partial

import numpy as np

from rosette_ros.core.run.number_words import micrometres, p_value
from rosette_ros.core.run.records import UNLIKELY
from rosette_ros.core.run.sphere_refit import SphereRefit
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.json_output import Json
from rosette_ros.presentation.json_output import plain as plain_json
from rosette_ros.presentation.table_format import Column, Table, column
from rosette_ros.words.effect_words import MICRO_DECIMALS, fixed


def sphere_rows(refit: SphereRefit) -> list[tuple[str, str]]:
    """Return what the fit of the spheres gave, as (name, text) rows."""
    touched, moved = refit.touched, refit.moved
    left = '; '.join(f'{count} with {why}' for why, count in touched.left_out.items())
    changed = int((moved > 1e-9).sum())
    furthest = int(np.argmax(moved))
    return [
        ('Spheres', f'{refit.radius.size} ball centres from {refit.residual.size} touches'
                    f'{f"; {left}: centre as sent" * bool(left)}'),
        ('Centres', f'those that were sent, to {_nanometres(max(float(moved.max()), 1e-12))}' if not changed else
                    f'{changed} of {moved.size} more than 1 nm from those that were sent, at most '
                    f'{_nanometres(float(moved.max()))} (table position {touched.table_position[furthest]}, ball '
                    f'{touched.ball[furthest]})'),
        ('Radius', _radius_words(refit)),
        ('Touch', f'standard deviation {micrometres(refit.sigma)} along its normal; largest residual '
                  f'{micrometres(float(np.abs(refit.residual).max()))}'),
        *([('Touches off', outlier_words(refit))] if refit.outliers.size else []),
        ('Probe lobing', lobing_words(refit)), ('Ball form', form_words(refit))]


def _nanometres(metres: float) -> str:
    return f'{1e9 * metres:.2g} nm' if metres < 1e-6 else micrometres(metres)


def _radius_words(refit: SphereRefit) -> str:
    unknown = int(np.isnan(refit.touched.tip).sum())
    spread = f', standard deviation {micrometres(float(np.std(refit.radius)))}'
    tip = f'; the tip of {unknown} is not known and contained' if unknown else ''
    return f'{fixed(1e3 * float(refit.radius.mean()), 5)} mm on average{spread}{tip}'


def outlier_words(refit: SphereRefit) -> str:
    """Return which touches are far off their sphere, the largest first, in words."""
    touched, order = refit.touched, refit.outliers[np.argsort(-np.abs(refit.residual[refit.outliers]))]
    found = [f'table position {touched.table_position[row]}, ball {touched.ball[row]}, touch '
             f'{place - touched.first[row] + 1}: {text.signed(1e6 * float(refit.residual[place]), 2)} µm'
             for place, row in zip(order[:5], touched.owner[order[:5]], strict=True)]
    return f'{"; ".join(found)}{f" and {order.size - 5} more" if order.size > 5 else ""} (dust, a bump?)'


def lobing_words(refit: SphereRefit) -> str:
    """Return whether all balls deviate alike by the direction of the probe, in words."""
    found = refit.lobing
    if float(found.p) >= UNLIKELY:
        return f'none that stands out of the noise ({text.P_VALUE}: {p_value(float(found.p))})'
    size, azimuth, elevation = found.largest
    return (f'{micrometres(float(found.systematic))} rms over the directions of the probe, largest '
            f'{text.signed(1e6 * size, 3)} µm at azimuth {azimuth:g}°, elevation about {text.signed(elevation, 0)}° '
            f'({text.P_VALUE}: {p_value(float(found.p))})')


def form_words(refit: SphereRefit) -> str:
    """Return which balls have a form, in words."""
    forms, p = refit.ball_forms, np.minimum(refit.ball_forms.p * refit.balls.size, 1.0)
    worst = np.argsort(-forms.systematic)
    found = [place for place in worst.tolist() if p[place] < UNLIKELY]
    if not found:
        return f'none that stands out of the noise (smallest {text.P_VALUE}: {p_value(float(p.min()))})'
    named = [f'ball {refit.balls[place]} {micrometres(float(forms.systematic[place]))}' for place in found]
    more = f' and {len(named) - 6} more' if len(named) > 6 else ''
    return f'rms over the surface: {", ".join(named[:6])}{more}; turns with the plate'


def _lengths(key: str, name: str, metres: Iterable[float]) -> Column:
    return column(key, name, [1e6 * value for value in metres], partial(text.at_least, places=MICRO_DECIMALS),
                  'µm')


def sphere_table(refit: SphereRefit) -> Table:
    """Return radius, form and systematic part of the residuals of each ball."""
    owner, forms = [np.flatnonzero(refit.touched.ball == ball) for ball in refit.balls], refit.ball_forms
    spread = [float(np.std(refit.radius[rows])) for rows in owner]
    p = np.minimum(forms.p * refit.balls.size, 1.0)
    return Table('spheres', 'Spheres through the touches, by ball', (
        column('ball', 'ball', refit.balls, str), column('readings', 'readings', map(len, owner), str),
        column('radius_mm', 'radius', [1e3 * refit.radius[rows].mean() for rows in owner],
               lambda value: fixed(value, 5), 'mm'),
        _lengths('radius_sd_um', 'its standard deviation', spread),
        _lengths('form_um', 'form error of a reading, mean', [refit.form[rows].mean() for rows in owner]),
        _lengths('largest_form_um', 'largest', [refit.form[rows].max() for rows in owner]),
        _lengths('systematic_um', 'form of the ball, rms', forms.systematic),
        column('p', text.P_VALUE, p, p_value),
        _lengths('moved_um', 'centre moved by at most', [refit.moved[rows].max() for rows in owner])),
        levels=tuple('doubtful' if value < UNLIKELY else '' for value in p),
        note='The form of a ball is the mean residual by direction on the plate, freed of what all balls show alike.')


def spheres_json(refit: SphereRefit) -> Json:
    """Return the fit of the spheres: of the run, of each ball, of each reading with the residual of each touch."""
    touched, forms = refit.touched, refit.ball_forms
    residuals = np.split(refit.residual, touched.first[1:])
    return plain_json({
        'fitted': refit.radius.size, 'touches': refit.residual.size, 'as_sent': dict(touched.left_out),
        'touch_sd_m': refit.sigma, 'moved_max_m': refit.moved.max(), 'radius_m': refit.radius.mean(),
        'outliers': [{'seq': touched.seq[row], 'touch': place - touched.first[row] + 1,
                      'residual_m': refit.residual[place]}
                     for place, row in zip(refit.outliers, touched.owner[refit.outliers], strict=True)],
        'lobing': {'systematic_m': refit.lobing.systematic, 'p': refit.lobing.p, 'text': lobing_words(refit)},
        'form_text': form_words(refit),
        'balls': [{'ball': ball, 'systematic_m': systematic, 'p': p}
                  for ball, systematic, p in zip(refit.balls, forms.systematic, forms.p, strict=True)],
        'readings': [{
            'seq': touched.seq[row], 'table_position': touched.table_position[row], 'ball': touched.ball[row],
            'centre_m': refit.centre[row], 'sent_m': touched.sent[row], 'moved_m': refit.moved[row],
            'radius_m': refit.radius[row], 'form_m': refit.form[row], 'touch_sd_m': refit.rms[row],
            'residual_m': residuals[row]} for row in range(refit.radius.size)]})

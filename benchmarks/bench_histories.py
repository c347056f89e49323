# SPDX-License-Identifier: Apache-2.0
"""Simulated three-year histories of a cell, with wear and seasons: changes by 3 U of one harmonic, and none.

Each history ends with the third run after its change. A change is found where it is the only one, at its run or next to
it, and of its owner: table, plate, CMM or an effect. HISTORIES (default 20) of each kind.
"""

import datetime
import os
import time
from collections import Counter

import numpy as np

from benchmarks.ageing import years
from rosette_ros.analysis import analyse
from rosette_ros.archive.run_row import evaluation_row, heading
from rosette_ros.archive.table_history import history_of
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.geometry import TWO_PI, rotate_z
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.table.trend import harmonics
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.io.identity_file import Identity

HISTORIES = int(os.environ.get('HISTORIES', '20'))
BALLS, DAYS, RUNS = 8, 14.0, 78
WITHIN = 3
EFFECT = 'frame_drift'
OWNERS = ('table', 'plate', 'CMM', EFFECT)
IN_U = 3.0
START = datetime.datetime(2024, 1, 1, tzinfo=datetime.UTC)


def changed(run, owner, fit, number):
    """Return a run whose centres are those after a change by IN_U of the owner; fit: of a run before; number: which."""
    n, order, axis = run.n, 2 + number % ((run.n - 1) // 2 - 1), number % 3
    factor = IN_U * COVERAGE_FACTOR
    centre = run.centre.copy()
    if owner == 'table':
        curve, motions = number % 6, fit.error_motions
        size = factor * harmonics(motions.angle, motions.values[:, curve], motions.u[:, curve])[1][order - 1, 0]
        wave = size * np.cos(order * run.table_angle)
        if CURVES[curve].startswith('ct'):
            centre[:, curve] += wave
        else:
            centre += np.cross(wave[:, None] * np.eye(3)[curve - 3], run.centre)
    elif owner in ('plate', 'CMM'):
        u = fit.deviation_u[owner == 'CMM'][:, axis]
        place = np.arange(n)
        shift = np.zeros((n, 3))
        size = factor * harmonics(TWO_PI * place / n, u, u)[1][order - 1, 0]
        shift[:, axis] = size * np.cos(order * TWO_PI * place / n)
        centre += (shift[run.cmm_position - 1] if owner == 'CMM' else
                   rotate_z(run.table_angle, shift[run.ball - 1]))
    else:
        column = fit.effects[0].parameters[axis].u
        span = run.time - run.time.mean()
        centre[:, axis] += factor * column * span
    return run.replace(centre=centre)


def history(seed, owner='', balls=BALLS, runs=RUNS):
    """Return a History and the index of its change, of `owner`; without one none changes."""
    at = runs // 3 + 7 * seed % (runs - WITHIN - runs // 3) if owner else runs
    model = Model().with_effect(EFFECT, {'axes': 'xyz'}) if owner == EFFECT else Model()
    rows, first = [], None

    def settings(day):
        return {'seed': seed + 1, 'plate': {'balls': balls}, 'table': {'rotation_urad': 0.3 + 0.15 * day / DAYS / RUNS}}

    for number, (day, run) in enumerate(years(settings, min(runs, at + WITHIN), DAYS, seasons=2.0)):
        fit = analyse(changed(run, owner, first, seed) if number >= at else run, model)
        first = first or fit
        rows.append({**heading(f'{number}', 'p', 's', model, START, run.run_id),
                     **evaluation_row(fit, identity=Identity({})),
                     'measured_at': START + datetime.timedelta(days=day)})
    return history_of(rows), at


def is_found(history, at, owner):
    """Return whether the change, and no other, is found, with run and owner."""
    events = history.events()
    return len(events) == 1 and abs(events[0].run - at) <= 1 and events[0].owners[0] == owner


def main():
    """Measure and print."""
    begin, found, missed = time.process_time(), Counter(), []
    for seed in range(HISTORIES):
        owner = OWNERS[seed % len(OWNERS)]
        made, at = history(seed, owner)
        if is_found(made, at, owner):
            found[owner] += 1
        else:
            missed.append((seed, owner, at, [(one.run, one.owners, one.steps[0].series.name)
                                             for one in made.events()]))
    print(f'{found.total()} of {HISTORIES} changes by {IN_U:g} U found within {WITHIN} runs, with date and owner: '
          f'{", ".join(f"{owner} {number}" for owner, number in found.items())}; '
          f'{time.process_time() - begin:.0f} CPU s')
    for one in missed:
        print('  not found:', *one)
    alarms = [(seed, [(one.run, one.owners) for one in events]) for seed in range(HISTORIES)
              if (events := history(100 + seed)[0].events())]
    print(f'{len(alarms)} of {HISTORIES} histories without a change show one; {time.process_time() - begin:.0f} CPU s')
    for one in alarms:
        print('  alarm:', *one)


if __name__ == '__main__':
    main()

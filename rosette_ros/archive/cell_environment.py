# SPDX-License-Identifier: Apache-2.0
"""What earlier runs of a table say of what may move in its cell: an environment for the uncertainty of its next run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.errors import InvalidData, counted
from rosette_ros.core.model.surroundings import at_ball, kind_of, size_per_rms
from rosette_ros.core.planning.advice import GOOD_SHARE
from rosette_ros.core.planning.visibility import visibility
from rosette_ros.core.records import Run
from rosette_ros.core.stated_environment import KINDS, Environment, Size
from rosette_ros.io.open_run import open_run

_ROWS = '''SELECT path, run_id, effects FROM runs WHERE problem = '' AND table_serial = ? AND missing IS NOT NULL
    QUALIFY row_number() OVER (PARTITION BY log_sha256, run_id ORDER BY added_at DESC) = 1
    ORDER BY measured_at, path, run_id'''


@dataclass(frozen=True)
class Shown:
    """What one run says: the size of each effect that was found, as displacement of a ball, and of each that it would
    have shown the size from which on it is found nearly always, m."""

    found: dict[str, float]
    bounds: dict[str, float]


def shown_by(run: Run, effects: Sequence[dict[str, Any]]) -> Shown:
    """Return what a run says; effects: that were found, as an archive keeps them."""
    per_rms, found = size_per_rms(run), dict[str, float]()
    for one in effects:
        if one['effect'] in per_rms:
            size = one['rms_m'] * per_rms[one['effect']]
            found[one['effect']] = float(np.hypot(found.get(one['effect'], 0.0), size))
    bounds = {one.name: one.detectable / 3**0.5 * per_rms[one.name]
              for one in visibility(run, run.repeatability or 1e-7)
              if one.name in per_rms and not one.reason and one.typical_share >= GOOD_SHARE}
    return Shown(found, bounds)


def environment_of_cell(archive: RunArchive, serial: str, otherwise: Environment) -> Environment:
    """Return the Environment that the runs of a table in an archive show; otherwise: of what none of them shows.

    The variance of an effect is the mean of the squares of its sizes over the runs that show it, and a found one has
    it by itself. One that was never found is taken as if one of these runs had had it, anywhere up to the size at which
    it would have been found: bound^2 / 3 / runs; these add up to the number to which it belongs.
    Raises InvalidData where no run of the table can be opened."""
    rows = archive.query(_ROWS, (serial,)).to_pylist()
    every = list[Shown]()
    for row in rows:
        try:
            run = open_run(row['path'], row['run_id'] or None)
        except InvalidData:
            continue  # a log that was moved shows nothing any more
        every.append(shown_by(run, row['effects']))
    if not every:
        raise InvalidData(f'{archive.folder}: wanted diagnosed runs of table {serial} whose logs are still there, got '
                          f'none of {counted(len(rows), "run")}')
    left, lever = at_ball(otherwise, run), run.radius
    effects, kinds = dict[str, Size](), {kind: [0.0, 0] for kind in KINDS}
    for name in left:
        kind = kind_of(EFFECTS[name])
        sizes = [one.found[name] for one in every if name in one.found]
        shown = sum(name in one.found or name in one.bounds for one in every)
        if sizes:
            effects[name] = Size(float(np.sqrt(np.sum(np.square(sizes)) / shown)),
                                 f'found in {len(sizes)} of {counted(shown, "run")} of table {serial}')
            continue
        bound = min((one.bounds[name] for one in every if name in one.bounds), default=None)
        kinds[kind][0] += left[name]**2 if bound is None else bound**2 / 3 / shown
        kinds[kind][1] += bound is None
    numbers = {}
    for kind, (square, unknown) in kinds.items():
        words = f'not found in {counted(len(every), "run")} of table {serial}' + (
            f'; {counted(int(unknown), "effect")} that none shows as {otherwise.name}' if unknown else '')
        numbers[kind] = Size(float(np.sqrt(square)) / (lever if KINDS[kind].si == 'rad' else 1.0), words)
    return Environment(f'table {serial}', numbers, effects)

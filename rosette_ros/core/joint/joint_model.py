# SPDX-License-Identifier: Apache-2.0
"""Several runs as one model: which unknowns they have, and how these are seen.

    p = F_r [ R(Theta(phi)) R_z(phi) C_c (b_j + P_j) + T(phi) + M(alpha) ]

with C the placement of the plate on the table (reference: the first clamping of a plate) and F the machine frame of a
run (reference: the first), exact as in core/model/kinematics.py. Gauss-Newton with the sparse columns at the nominal
places; the directions that no reading sees are fixed by the least curves, then the least frames, placements and CMM
deviations: the gauge of one run, continued to all.

Places of the CMM within SAME_PLACE have one deviation M. What is seen only by how they differ is beyond this model, and
in practice not determined: balls that are 10 to 40 um off would give the mean tilt of a table to +-600 urad, a thousand
times the U of an ordinary combination. So the columns stand where the places of the balls agree (see _agreed): a plate
has the rank of the plate without deviations, and no limit for small eigenvalues has to tell them from others. Balls
that are further off have CMM positions of their own and keep what they determine. `predicted` has the true places;
columns that are 1e-4 off change an estimate by 1e-4 of its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # which loads its parts where they are used

from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.joint.sharing import SEATS, Sharing
from rosette_ros.core.model.kinematics import moved, on_table
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.geometry import SAME_ANGLE, TWO_PI, Floats, Ints, rotate_z, wrap

SAME_PLACE = 1e-4
"""Nominal places of the CMM that are nearer to each other are one, m."""
ZERO = 1e-9
"""Eigenvalues of the normal equations below this share of the largest are 0."""
ROUNDING = 1e-12
"""Places that differ by no more are equal, m."""
MOST_UNKNOWNS = 3000


@dataclass(frozen=True)
class TableSet:
    """Table motions that are one curve.

    name: of the table; sense: of turning, 0 for any; angle: (m,) rad; place: among the unknowns; words: what it is
    called.
    """

    name: str
    sense: int
    angle: Floats
    place: slice | Ints
    words: str


class JointModel:
    """The unknowns of several runs: their places among all, and what of them is free.

    runs; sharing; phi: (N,) nominal table angles, rad; base: (N, 3) nominal ball centres on the table, m; agreed: (N,
    3) those of the columns, m; sets: the TableSets; lever: m, by which rotations are multiplied among the unknowns;
    free: (q,) which are unknown at all; of all q unknowns, `groups` has the slices of curves, plate, cmm, placement and
    frame; places: by 'plate' and 'cmm', for each deviation the number of its name in the sharing and, of a plate, the
    ball from 0; at: of each where it is, (k, 3), m.

    Raises NotDeterminable where too little joins the runs or there are too many unknowns.
    """

    def __init__(self, runs: Sequence[Readings], sharing: Sharing) -> None:
        if len(runs) != sharing.runs:
            raise InvalidData(f'sharing: expected names for {len(runs)} runs, found {sharing.runs}')
        self.runs, self.sharing = tuple(runs), sharing
        sizes = [run.size for run in runs]
        self.run: Ints = np.repeat(np.arange(len(runs)), sizes)
        self.phi: Floats = np.concatenate([run.angle[run.table_position - 1] for run in runs])
        turned = [run.turned(turn) for run, turn in zip(runs, sharing.turn, strict=True)]
        self.turn: Floats = np.repeat(sharing.turn, sizes)
        self.base: Floats = np.concatenate([base for _, base in turned])
        self.centre: Floats = np.concatenate([run.centre for run in runs])
        self.deviation: Floats = np.concatenate([run.angle_deviation for run in runs])
        self.lever = float(np.mean(np.hypot(self.base[:, 0], self.base[:, 1])))
        sense = np.where(np.concatenate([run.backwards for run in runs]), -1, 1) * sharing.by_sense
        table, plate, cmm, frame = (_numbers(getattr(sharing, part))[self.run] for part in
                                    ('table', 'plate', 'cmm', 'frame'))
        clamping = _numbers([f'{a}/{b}' for a, b in zip(sharing.plate, sharing.clamping)])[self.run]
        at = rotate_z(self.phi, self.base)
        azimuth, way = _in_turn(np.arctan2(at[:, 1], at[:, 0]), SAME_PLACE / self.lever), np.hypot(at[:, 0], at[:, 1])
        places = (_clusters(azimuth, SAME_PLACE / self.lever), _clusters(way, SAME_PLACE),
                  _clusters(at[:, 2], SAME_PLACE))
        tables, self.table = _labels(table, -sense, _clusters(_in_turn(self.phi, SAME_ANGLE), SAME_ANGLE))
        balls, self.ball = _labels(plate, np.concatenate([ball for ball, _ in turned]))
        cmms, self.cmm = _labels(cmm, *places)
        _, single = _labels(self.run, np.concatenate([run.ball for run in runs]))
        self.agreed = _agreed(self.base, self.phi, single, self.cmm)
        self.cmm_azimuth = _first(azimuth, self.cmm, len(cmms))
        self.places: dict[str, Ints] = {'plate': balls, 'cmm': cmms}
        self.at = {'cmm': _first(rotate_z(self.phi, self.agreed), self.cmm, len(cmms)),
                   'plate': _first(rotate_z(-self.turn, self.agreed), self.ball, len(balls))}
        self.placement, self.frame = clamping, frame
        counts = 6 * len(tables), 3 * len(balls), 3 * len(cmms), 6 * (1 + clamping.max()), 6 * (1 + frame.max())
        ends = np.cumsum(counts).tolist()
        self.groups = {name: slice(end - count, end) for name, end, count in
                       zip(('curves', 'plate', 'cmm', 'placement', 'frame'), ends, counts, strict=True)}
        angle = _first(_in_turn(self.phi, SAME_ANGLE), self.table, len(tables))
        self.sets = tuple(_sets(tables, angle, sharing))
        self.free = np.ones(ends[-1], dtype=bool)
        self._fix(balls)
        if self.unknowns > MOST_UNKNOWNS:
            raise NotDeterminable(f'expected at most {MOST_UNKNOWNS} unknowns in all runs together, found '
                                  f'{self.unknowns}; '
                                  'evaluate fewer runs or positions')
        self._refuse_unjoined_runs()

    def _fix(self, balls: Ints) -> None:
        """Mark what is known or is a reference as not free."""
        sharing = self.sharing
        calibrated = [run.plate.is_calibrated and sharing.trusts_plates for run in self.runs]
        known = np.isin(balls[:, 0], _numbers(sharing.plate)[calibrated])
        self.free[self.groups['plate']] = np.repeat(~known, 3)
        self.free[self.groups['cmm']] = not sharing.cmm_is_calibrated
        placement, frame = (self.free[self.groups[name]].reshape(-1, 6) for name in ('placement', 'frame'))
        placement[:], met = SEATS[sharing.seat], set[str]()
        for run, name in enumerate(sharing.plate):
            if name not in met:  # the first clamping is the reference, unless the plate is known in its own axes
                placement[self.placement[self.run == run][0]] = calibrated[run]
            met.add(name)
        frame[0] = False

    @property
    def unknowns(self) -> int:
        """How many unknowns there are."""
        return int(self.free.sum())

    @property
    def size(self) -> int:
        """N, readings of all runs."""
        return self.phi.size

    def _refuse_unjoined_runs(self) -> None:
        """Refuse runs that too few table angles, balls and CMM positions join."""
        kinds = {'table angles': (self.table, 2), 'balls': (self.ball, 3), 'CMM positions': (self.cmm, 3)}
        if self.sharing.cmm_is_calibrated:
            kinds['CMM positions'] = self.cmm, 1
        seen = {name: [{*label[self.run == run].tolist()} for run in range(len(self.runs))]
                for name, (label, _) in kinds.items()}
        joined, left = [0], list(range(1, len(self.runs)))
        for run in joined:
            near = [other for other in left if any(
                len(sets[run] & sets[other]) >= kinds[name][1] for name, sets in seen.items())]
            joined += near
            left = [other for other in left if other not in near]
        if left:
            common = ', '.join(f'{len(sets[0] & sets[left[0]])} {name}' for name, sets in seen.items())
            raise NotDeterminable(
                f'{self.runs[left[0]].name} ({_places(self.runs[left[0]])}) and {self.runs[0].name} '
                f'({_places(self.runs[0])}) have {common} in common, which does not join them; missing: two table '
                'angles of the same table, three balls of the same plate, or three CMM positions')

    @cached_property
    def design(self) -> Any:
        """The columns of all unknowns at the agreed places, sparse (3 N, q)."""
        one = np.broadcast_to(np.eye(3), (self.size, 3, 3))
        turn, tilt = _turns(self.phi), tilts(rotate_z(self.phi, self.agreed)) / self.lever
        starts = {name: place.start for name, place in self.groups.items()}
        blocks = [(one, 6 * self.table), (tilt, 6 * self.table + 3),
                  (_turns(self.phi + self.turn), starts['plate'] + 3 * self.ball), (one, starts['cmm'] + 3 * self.cmm),
                  (turn, starts['placement'] + 6 * self.placement),
                  (turn @ tilts(self.agreed) / self.lever, starts['placement'] + 6 * self.placement + 3),
                  (one, starts['frame'] + 6 * self.frame), (tilt, starts['frame'] + 6 * self.frame + 3)]
        values = np.stack([block for block, _ in blocks])
        columns = np.stack([first for _, first in blocks])[:, :, None, None] + np.arange(3)[None, None, None]
        rows = 3 * np.arange(self.size)[None, :, None, None] + np.arange(3)[None, None, :, None]
        rows, columns = np.broadcast_arrays(rows, columns)
        return scipy.sparse.csr_array((values.ravel(), (rows.ravel(), columns.ravel())),
                                      shape=(3 * self.size, self.free.size))

    def predicted(self, unknowns: Floats) -> Floats:
        """Return the ball centres (N, 3) that unknowns (q,) predict, rotations exact, m."""
        part = {name: unknowns[place].reshape(-1, 3 if name in ('plate', 'cmm') else 6)
                for name, place in self.groups.items()}
        curves, placement, frame = (part[name] / np.repeat([1.0, self.lever], 3)
                                    for name in ('curves', 'placement', 'frame'))
        clamped, framed = placement[self.placement], frame[self.frame]
        at = self.base + rotate_z(self.turn, part['plate'][self.ball])
        at = moved(at, clamped[:, 3:], clamped[:, :3])
        at = on_table(at, self.phi + self.deviation, curves[self.table]) + part['cmm'][self.cmm]
        return moved(at, framed[:, 3:], framed[:, :3])


def _agreed(base: Floats, phi: Floats, ball: Ints, cmm: Ints) -> Floats:
    """Return ball centres (N, 3), m, moved so little that readings at one CMM position have one place, if that can be.

    ball, cmm: (N,) labels. Of all moves that leave least differences the least ones, in azimuth, radius and height.
    """
    radius, azimuth = np.hypot(base[:, 0], base[:, 1]), np.arctan2(base[:, 1], base[:, 0])
    lever = float(radius.mean())
    first = _first(azimuth + phi, cmm, cmm.max() + 1)[cmm]
    places = np.stack([lever * wrap(azimuth + phi - first), radius, base[:, 2]], axis=-1)
    off = places - np.stack([np.bincount(cmm, one) for one in places.T], axis=-1)[cmm] / np.bincount(cmm)[cmm, None]
    if np.abs(off).max() <= ROUNDING:
        return base
    rows, balls = np.arange(ball.size), int(ball.max()) + 1
    of_both = scipy.sparse.csr_array((np.ones(2 * ball.size), (np.tile(rows, 2), np.append(ball, balls + cmm))))
    moves = scipy.linalg.lstsq((of_both.T @ of_both).toarray(), np.asarray(of_both.T @ off), cond=ZERO)[0][ball]
    azimuth, radius = azimuth - moves[:, 0] / lever, radius - moves[:, 1]
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), base[:, 2] - moves[:, 2]], axis=-1)


def _numbers(names: Sequence[str]) -> Ints:
    """Return the number of each name, from 0 in the order of appearance."""
    known = {name: number for number, name in enumerate(dict.fromkeys(names))}
    return np.array([known[name] for name in names])


def _in_turn(angle: Floats, tolerance: float) -> Floats:
    """Return angles in one turn; what is nearly a whole turn is 0."""
    return np.asarray(np.maximum((angle + tolerance) % TWO_PI - tolerance, 0.0))


def _clusters(values: Floats, tolerance: float) -> Ints:
    """Return the number of the cluster of each value, in rising order; values within a tolerance are one."""
    order = np.argsort(values, kind='stable')
    number = np.zeros(values.size, dtype=np.int64)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > tolerance)])
    return number


def _labels(*parts: Ints) -> tuple[Ints, Ints]:
    """Return the different rows of parts (k, p), and which of them each reading has, (N,)."""
    rows, which = np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)
    return rows, which.ravel()


def _first(values: Floats, label: Ints, count: int) -> Floats:
    """Return the value of the first reading of each label, (count, ...)."""
    out = np.empty((count, *values.shape[1:]))
    out[label[::-1]] = values[::-1]
    return out


def _sets(tables: Ints, angle: Floats, sharing: Sharing) -> Any:
    names = list(dict.fromkeys(sharing.table))
    for table, against in np.unique(tables[:, :2], axis=0).tolist():
        inside = np.flatnonzero((tables[:, 0] == table) & (tables[:, 1] == against))
        words = ['table', names[table] * (len(names) > 1), ('', 'clockwise', 'counter-clockwise')[against]]
        yield TableSet(names[table], -against, angle[inside], slice(6 * inside[0], 6 * (inside[-1] + 1)),
                       ' '.join(filter(None, words)))


def _turns(angle: Floats) -> Floats:
    """Return the rotation matrices about z (N, 3, 3)."""
    return np.asarray(np.stack([rotate_z(angle, axis) for axis in np.eye(3)], axis=-1))


def tilts(place: Floats) -> Floats:
    """Return the matrices (N, 3, 3) of the displacement of places (N, 3), m, by a small rotation, m per rad."""
    x, y, z = place.T
    zero = np.zeros_like(x)
    return np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(-1, 3, 3)


def _places(run: Readings) -> str:
    used = np.unique(run.table_position)
    angles = ', '.join(f'{angle:.4g}' for angle in np.rad2deg(run.angle[used[:3] - 1]))
    return f'{used.size} table angles {angles} ... deg and {run.plate.balls} balls'

# SPDX-License-Identifier: Apache-2.0
"""Several runs as one: what they determine, against a dense design written out here, and what they find."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.joint.joint_model import JointModel
from rosette_ros.core.joint.joint_solution import JointSolution
from rosette_ros.core.joint.knowledge import knowledge
from rosette_ros.core.joint.readings import Plate, Readings
from rosette_ros.core.joint.sharing import SEATS, Sharing
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.run.errors import InvalidData, NotDeterminable
from rosette_ros.core.run.geometry import Frame, rotate_z, rotation_matrix
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.words.joint_words import part_words

R = 0.1825
TWELVE = tuple(range(0, 360, 30))
FINE = tuple(range(0, 360, 10))
MOVED = (0, 30, 60, 90, 130, *range(150, 360, 30))
"""Twelve balls, the fifth 10 degrees off."""
SIX = (0, 10, 50, 120, 190, 290)
"""Six balls at irregular azimuths."""
HALF = (0, 1, 3, 5, 8, 9)
"""Six CMM positions of twelve that determine the curves."""


def run_of(angles=TWELVE, balls=TWELVE, sense=1, at=None, calibrated=False, radius=R):
    """Return (angle, ball, azimuth, sense) of each reading, whole degrees, and the Readings without any error.

    at: CMM positions of twelve that are measured, all if None.
    """
    pairs = [(i, j) for i in range(len(angles)) for j in range(len(balls))
             if at is None or (angles[i] + balls[j]) // 30 % 12 in at]
    i, j = np.array(pairs).T
    azimuth = np.deg2rad(balls)
    plate = Plate(azimuth, np.full(len(balls), radius), np.zeros(len(balls)), calibrated)
    phi = np.deg2rad(angles)
    centre = rotate_z(phi[i], plate.centres[j])
    return [(angles[a], b, balls[b], sense) for a, b in pairs], Readings(
        plate, phi, i + 1, j + 1, centre, np.zeros(i.size), np.full(i.size, sense))


def turned(readings, degrees):
    """Return readings of a plate that was turned by whole degrees."""
    listed, made = readings
    plate = made.plate
    centre = rotate_z(np.deg2rad(degrees), made.centre)
    return [(angle, ball, azimuth + degrees, sense) for angle, ball, azimuth, sense in listed], Readings(
        plate, made.angle, made.table_position, made.ball, centre, made.angle_deviation, made.approach)


def dense(runs, sharing):
    """Return the design of all unknowns as a dense matrix, reading by reading, and the names of its columns.

    Rotations are in units of 1/R.
    """
    rows, names = [], {}
    reference = {}
    for run, (listed, made) in enumerate(runs):
        plate = sharing.plate[run]
        clamping = sharing.clamping[run]
        reference.setdefault(plate, None if made.plate.is_calibrated else clamping)
        allowed = (True,) * 6 if made.plate.is_calibrated else SEATS[sharing.seat]
        for angle, ball, azimuth, sense in listed:
            phi, alpha = np.deg2rad(angle), np.deg2rad(angle + azimuth)
            c, s = np.cos(alpha), np.sin(alpha)
            tilt = np.array([[0, 0, -s], [0, 0, c], [s, -c, 0]])  # of crx, cry, crz
            entries = [(('T', sharing.table[run], sense * sharing.by_sense, angle % 360), np.hstack([np.eye(3), tilt]))]
            if not made.plate.is_calibrated:
                own = phi + sharing.turn[run]
                turn = np.array([[np.cos(own), -np.sin(own), 0], [np.sin(own), np.cos(own), 0], [0, 0, 1]])
                entries.append((('P', plate, ball), turn))
            if not sharing.cmm_is_calibrated:
                entries.append((('M', sharing.cmm[run], (angle + azimuth) % 360), np.eye(3)))
            if clamping != reference[plate]:
                cp, sp = np.cos(phi), np.sin(phi)
                back = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
                x, y = np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))
                whole = np.hstack([back, back @ np.array([[0, 0, -y], [0, 0, x], [y, -x, 0]])])
                entries.append((('C', plate, clamping), whole[:, list(allowed)]))
            if sharing.frame[run] != sharing.frame[0]:
                entries.append((('F', sharing.frame[run]), np.hstack([np.eye(3), tilt])))
            row = {}
            for name, block in entries:
                for place in range(block.shape[1]):
                    names.setdefault((*name, place), len(names))
                    row[names[(*name, place)]] = block[:, place]
            rows.append(row)
    matrix = np.zeros((3 * len(rows), len(names)))
    for number, row in enumerate(rows):
        for column, values in row.items():
            matrix[3 * number:3 * number + 3, column] = values
    return matrix, list(names)


def rank_and_null(matrix):
    """Return rank and null space (q, h) by singular values."""
    _, size, right = np.linalg.svd(matrix, full_matrices=False)
    rank = int(np.sum(size > 1e-9 * size[0]))
    return rank, right[rank:].T


def u_of(matrix, row):
    """Return the standard uncertainty of row @ unknowns for unit noise, that row being determined."""
    null = rank_and_null(matrix)[1]
    assert np.abs(row @ null).max(initial=0) < 1e-9
    return float(np.linalg.norm(np.linalg.pinv(matrix, rcond=1e-9).T @ row))


def plates(count, **rest):
    """Return a run with twelve balls and one with a plate of another count and other CMM positions."""
    angles = tuple(np.arange(count) * 360 // count)
    return [run_of(), run_of(angles, angles, **rest)]


TWICE = {'one': [run_of()], 'turned': [run_of(), turned(run_of(), 90)], 'both senses': [run_of(), run_of(sense=-1)],
         'there and back': [run_of(at=HALF), run_of(sense=-1, at=HALF)],
         'half pitches': [run_of(), run_of(tuple(a + 15 for a in TWELVE))],
         'all four': [turned(run_of(tuple(a + b for a in TWELVE)), t) for t in (0, 15) for b in (0, 15)]}
QUARTER = {'turn': (0.0, np.pi / 2)}
TABLE = [  # name, runs, sharing, unknowns, rank, hidden in the curves
    ('one run', TWICE['one'], Sharing.of(1), 144, 131, 10),
    ('plate turned, free', TWICE['turned'], Sharing.of(2, ['clamping'], **QUARTER), 150, 137, 10),
    ('plate turned, plane', TWICE['turned'], Sharing.of(2, ['clamping'], seat='plane', **QUARTER), 147, 136, 8),
    ('plate turned, pilot', TWICE['turned'], Sharing.of(2, ['clamping'], seat='pilot', **QUARTER), 147, 136, 8),
    ('plate turned, both', TWICE['turned'], Sharing.of(2, ['clamping'], seat='both', **QUARTER), 144, 135, 6),
    ('calibrated plate', [run_of(calibrated=True)], Sharing.of(1), 114, 102, 10),
    ('calibrated CMM', TWICE['one'], Sharing.of(1, cmm_is_calibrated=True), 108, 102, 6),
    ('both senses', TWICE['both senses'], Sharing.of(2, by_sense=True), 216, 203, 10),
    ('there and back', TWICE['there and back'], Sharing.of(2, by_sense=True), 198, 185, 10),
    ('half pitches', TWICE['half pitches'], Sharing.of(2), 252, 233, 16),
    ('half pitches and clampings', TWICE['all four'],
     Sharing.of(4, clamping=('1', '1', '2', '2'), turn=(0, 0, np.pi / 12, np.pi / 12)), 258, 245, 10),
    ('36 positions, equal pitch', [run_of(FINE)], Sharing.of(1), 360, 335, 22),
    ('36 positions, a ball moved', [run_of(FINE, MOVED)], Sharing.of(1), 360, 347, 10),
    ('36 positions, six balls', [run_of(FINE, SIX)], Sharing.of(1), 342, 329, 10),
    *((f'plates of 12 and {count}', plates(count), Sharing.of(2, ['plate', 'cmm']), unknowns, unknowns - 16, 10)
      for count, unknowns in ((8, 216), (9, 234), (10, 252)))]


@pytest.mark.parametrize(('runs', 'sharing', 'unknowns', 'rank', 'in_curves'), [row[1:] for row in TABLE],
                         ids=[row[0] for row in TABLE])
def test_rank_table(runs, sharing, unknowns, rank, in_curves):
    """Unknowns, rank and what is hidden, by a dense singular value decomposition and by the joint model."""
    matrix, names = dense(runs, sharing)
    assert matrix.shape[1] == unknowns
    dense_rank, null = rank_and_null(matrix)
    of_table = [place for place, name in enumerate(names) if name[0] == 'T']
    assert (dense_rank, np.linalg.matrix_rank(null[of_table], tol=1e-9)) == (rank, in_curves)
    solution = JointSolution(JointModel([made for _, made in runs], sharing))
    assert (solution.model.unknowns, solution.rank) == (unknowns, rank)
    assert (solution.hidden.shape[1], solution.hidden_in_curves) == (unknowns - rank, in_curves)
    assert np.abs(solution.model.design @ solution.hidden).max() < 1e-7


TURNS = 'once-per-turn part of (crx, cry): tilt', 'once-per-turn part of (ctx, cty): eccentricity'
SCALE = 'radial scale of plate and CMM'
LEARNT = {
    'plate turned, plane': {TURNS[0]}, 'plate turned, pilot': {TURNS[1]}, 'plate turned, both': {*TURNS},
    'calibrated plate': {SCALE}, 'calibrated CMM': {SCALE, 'mean of ctx and cty', 'mean of crx and cry'},
    'both senses': {'the reversal of all six curves, with its means'},
    'there and back': {'the reversal of all six curves, with its means'},
    'half pitches': {'harmonics up to 12 except 12, at 24 table angles'},
    'half pitches and clampings': {'harmonics up to 12, at 24 table angles'},
    '36 positions, equal pitch': {'harmonics up to 18 except 12, at 36 table angles'},
    '36 positions, a ball moved': {'harmonics up to 18, at 36 table angles'},
    '36 positions, six balls': {'harmonics up to 18, at 36 table angles'},
    'plates of 12 and 10': {'harmonics up to 10, at 20 table angles'}}


@pytest.mark.parametrize(
    ('name', 'runs', 'sharing'), [row[:3] for row in TABLE if row[0] in (*LEARNT, 'one run', 'plate turned, free')],
    ids=lambda value: value if isinstance(value, str) else '')
def test_what_became_known_is_said(name, runs, sharing):
    """The last column of the table; of the usual eight groups the others stay unknown."""
    found = knowledge(JointSolution(JointModel([made for _, made in runs], sharing)))
    learnt = LEARNT.get(name, set())
    assert {*part_words(found.known)} == learnt
    waves = [words for words in part_words(found.hidden) if words.startswith('harmonics')]
    assert waves == ['harmonics 12'] * ('except' in ''.join(learnt))
    assert len(found.hidden) == 8 + len(waves) - len([words for words in learnt if words[0] in 'om' or words == SCALE])


def with_deviations(runs, sharing, size=3e-5):
    """Return readings of the runs whose plates are as made, not as drawn: size, m, is the scatter of a coordinate."""
    out = []
    for (_, made), turn in zip(runs, sharing.turn, strict=True):
        plate = made.plate
        off = np.clip(np.random.default_rng(plate.balls).standard_normal((plate.balls, 3)), -1.5, 1.5)
        x, y, z = (plate.centres + size * (off - off[0] * [0, 1, 0])).T
        plate = replace(plate, azimuth=np.arctan2(y, x), radius=np.hypot(x, y), height=z)
        at = rotate_z(turn + made.angle[made.table_position - 1], plate.centres[made.ball - 1])
        out.append(replace(made, plate=plate, centre=at))
    return out


@pytest.mark.parametrize(('name', 'runs', 'sharing', 'unknowns', 'rank', 'in_curves'), TABLE,
                         ids=[row[0] for row in TABLE])
def test_deviations_of_the_plate_change_no_rank(name, runs, sharing, unknowns, rank, in_curves):
    """What only 30 um tell is not known: rank, words and uncertainties of the plate without deviations."""
    del name
    plain, real = (JointSolution(JointModel(made, sharing)) for made in (
        [made for _, made in runs], with_deviations(runs, sharing)))
    assert (real.model.unknowns, real.rank, real.hidden_in_curves) == (unknowns, rank, in_curves)
    assert knowledge(real) == knowledge(plain)
    u = [np.linalg.norm(one.mix[one.model.groups['curves']], axis=1) for one in (real, plain)]
    assert u[0] == pytest.approx(u[1], rel=5e-3)


def test_balls_on_two_circles_keep_what_they_determine():
    """Radii that differ by 2 mm have CMM positions of their own: as by 40 mm, and with deviations, too."""
    ranks = []
    for apart, size in ((0.04, 0), (2e-3, 0), (2e-3, 3e-5)):
        listed, made = run_of()
        plate = replace(made.plate, radius=R + apart * (np.arange(12) % 2))
        at = rotate_z(made.angle[made.table_position - 1], plate.centres[made.ball - 1])
        both = [(listed, replace(made, plate=plate, centre=at))]
        ranks.append(JointSolution(JointModel(with_deviations(both, Sharing.of(1), size), Sharing.of(1))).rank)
    assert ranks[0] == ranks[1] == ranks[2] > 131


def difference(names, angle, size):
    """Return the row of ctx clockwise less counter-clockwise at an angle."""
    row = np.zeros(size)
    row[names.index(('T', '1', -1, angle, 0))], row[names.index(('T', '1', 1, angle, 0))] = 1, -1
    return row


@pytest.mark.parametrize(('name', 'wanted'), [('both senses', 0.41), ('there and back', 0.58)])
def test_reversal_has_the_uncertainty_of_the_readings_behind_it(name, wanted):
    """With its mean, as everything else is the same in both senses: 0.41 and 0.58 sigma."""
    runs, sharing = TWICE[name], Sharing.of(2, by_sense=True)
    matrix, names = dense(runs, sharing)
    each = [u_of(matrix, difference(names, angle, len(names))) for angle in TWELVE]
    assert np.mean(each) == pytest.approx(wanted, abs=0.01)
    solution = JointSolution(JointModel([made for _, made in runs], sharing))
    forwards, back = (solution.mix[one.place][::6] for one in solution.model.sets)
    assert np.linalg.norm(back - forwards, axis=1) == pytest.approx(each, rel=1e-6)


@pytest.mark.parametrize(('balls', 'wanted'), [(MOVED, 0.31), (SIX, 0.44)])
def test_irregular_plates_know_each_position_of_a_fine_table(balls, wanted):
    """u(ctx) of 36 positions: 0.31 sigma with 12 balls, 0.44 with 6."""
    runs = [run_of(FINE, balls)]
    matrix, names = dense(runs, Sharing.of(1))
    phi = np.deg2rad(FINE)
    gauge = np.array([np.r_[np.ones(36), np.zeros(36)], np.r_[np.zeros(36), np.ones(36)],
                      np.r_[np.cos(phi), np.sin(phi)], np.r_[-np.sin(phi), np.cos(phi)]]).T
    removed = np.eye(72) - gauge @ np.linalg.pinv(gauge)
    places = [names.index(('T', '1', 0, angle, axis)) for axis in (0, 1) for angle in FINE]
    row = np.zeros(len(names))
    row[places] = removed[0]
    each = u_of(matrix, row)
    assert each == pytest.approx(wanted, abs=0.03)
    solution = JointSolution(JointModel([runs[0][1]], Sharing.of(1)))
    assert np.linalg.norm(solution.mix[solution.model.sets[0].place][0]) == pytest.approx(each, rel=1e-6)


def test_one_run_gives_what_it_gives_alone():
    """Curves, plate and CMM deviations, uncertainties and residual of the ordinary fit, for a run with a gap."""
    run = synthetic_run(8, 'random', seed=4, noise=1e-7)[0]
    run = run.take(np.arange(run.size) % 9 != 4)
    alone, solution = fit(run), JointSolution(JointModel([Readings.of(run)], Sharing.of(1)))
    curves = solution.unknowns[solution.model.sets[0].place].reshape(-1, 6) / [1, 1, 1, *[solution.model.lever] * 3]
    assert np.abs(curves - alone.error_motions.values).max() < 2e-10  # nominal instead of the mean radius: 1e-4
    assert solution.unknowns[solution.model.groups['plate']] == pytest.approx(alone.plate.ravel(), abs=1e-10)
    assert (solution.rank, solution.dof) == (alone.rank, alone.dof)
    assert solution.rss == pytest.approx(np.sum(alone.residual**2), rel=1e-4)


def test_large_displacements_of_plate_and_frame_are_exact():
    """A plate clamped 0.3 mm and 3 mrad off, turned, a frame 1 mrad off: the curves come back.

    A turn of the frame about z cannot be told from one of the plate and is taken as the latter.
    """
    rng = np.random.default_rng(3)
    curves, cmm = 1e-6 * remove_gauge(rng.standard_normal((12, 6))), 1e-6 * rng.standard_normal((12, 3))
    own = 2e-5 * rng.standard_normal((12, 3))
    (_, first), (_, second) = run_of(), turned(run_of(), 90)
    made = []
    for run, turn, put, frame in ((first, 0.0, np.zeros(6), np.zeros(6)), (
            second, np.pi / 2, np.array([2e-4, -3e-4, 1e-4, 1e-3, -2e-3, 3e-3]),
            np.array([1e-4, 2e-4, -1e-4, 1e-3, -1e-3, 0]))):
        at = rotate_z(turn, run.plate.centres + own) @ rotation_matrix(put[3:]).T + put[:3]
        at = rotate_z(run.angle[run.table_position - 1], at[run.ball - 1])
        motion = curves[run.table_position - 1]
        k = np.rint(np.rad2deg(np.arctan2(at[:, 1], at[:, 0])) / 30).astype(int) % 12
        at = at + motion[:, :3] + np.cross(motion[:, 3:], at) + cmm[k]
        made.append(Readings(run.plate, run.angle, run.table_position, run.ball,
                             at @ rotation_matrix(frame[3:]).T + frame[:3], run.angle_deviation, run.approach))
    solution = JointSolution(JointModel(made, Sharing.of(2, ['clamping', 'frame'], turn=(0.0, np.pi / 2))))
    assert np.sqrt(solution.rss / solution.dof) < 2e-10
    alone = JointSolution(JointModel(made[:1], Sharing.of(1)))
    place = solution.model.sets[0].place
    assert np.abs(solution.unknowns[place] - alone.unknowns[place]).max() < 1e-9


@pytest.mark.parametrize(('other', 'common'), [
    (run_of(tuple(a + 7 for a in TWELVE))[1], '0 table angles, 0 balls, 0 CMM positions'),
    (plates(7)[1][1], '1 table angles, 0 balls, 1 CMM positions')])
def test_runs_that_nothing_joins_are_refused(other, common):
    """They share a table, but not its positions, nor a plate or CMM positions: one line says what is missing."""
    with pytest.raises(NotDeterminable, match=rf'have {common} in common, which does not join them; missing: two table '
                                              'angles of the same table, three balls of the same plate, or three CMM'):
        JointModel([run_of()[1], other], Sharing.of(2, ['plate']))


def test_what_cannot_be_meant_is_refused():
    """A regular plate turned by half a pitch; names for another number of runs; a frame that is not known."""
    run = Readings.of(synthetic_run(6)[0])
    with pytest.raises(InvalidData, match=r'turned by 30 deg: expected whole pitches of 60 deg'):
        JointModel([run, run], Sharing.of(2, turn=(0.0, np.pi / 6)))
    with pytest.raises(InvalidData, match='expected names for 1 runs, found 2'):
        JointModel([run], Sharing.of(2))
    with pytest.raises(InvalidData, match='expected its table frame, found none'):
        run.seen_from(Frame.identity())


@pytest.mark.parametrize('name', ['one', 'turned', 'both senses', 'there and back'])
def test_normalised_errors_are_one(name):
    """Over 20 draws of noise the errors of the curves are as large as their uncertainties say: 0.8 to 1.2."""
    runs = [made for _, made in TWICE[name]]
    sharing = {'turned': Sharing.of(2, ['clamping'], **QUARTER)}.get(
        name, Sharing.of(len(runs), by_sense=len(runs) > 1))
    model = JointModel(runs, sharing)
    solution = JointSolution(model)
    rng, place = np.random.default_rng(5), slice(0, model.groups['curves'].stop)
    errors = []
    for _ in range(20):
        found = solution.solved(model.centre + 1e-7 * rng.standard_normal((model.size, 3)))
        errors.append(found[place] / (1e-7 * np.linalg.norm(solution.mix[place], axis=1)))
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2

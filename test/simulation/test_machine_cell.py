# SPDX-License-Identifier: Apache-2.0
"""The cell as a whole: exact where nothing is wrong, true to its truth, one reading or many."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_cell import ideal_cell

from rosette_ros.core.run.errors import InvalidPlan
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import ORDERS, plan, unwrap_travel
from rosette_ros.simulation import BallNotFound, Machine, MachineConfig

NOISELESS = {'probing': {'repeatability_um': 0.0}}
one_nanometre = 1e-9


def paper_curves(run):
    """Return (n, 6) curves by equations (1)-(16), as complex sums on the grid of a run."""
    n = run.n
    w, z = np.zeros((n, n), complex), np.zeros((n, n))
    w[run.table_position - 1, run.ball - 1] = run.centre[:, 0] + 1j * run.centre[:, 1]
    z[run.table_position - 1, run.ball - 1] = run.centre[:, 2]
    turn = np.exp(2j * np.pi * np.arange(n) / n)
    spoke = turn[:, None] * turn[None, :]
    radius = np.mean(w * spoke.conj()).real
    crz = np.mean((w * spoke.conj()).imag, axis=1) / radius
    shift = w.mean(axis=1) - w.mean()
    shift = shift - np.mean(shift * turn.conj()) * turn
    # crx sin - cry cos = z/R: rx + i ry = -2i mean(z e^{i alpha}) / R
    tilt = -2j * np.mean(z * spoke, axis=1) / radius
    tilt = tilt - tilt.mean()
    tilt = tilt - np.mean(tilt * turn.conj()) * turn
    return np.stack([shift.real, shift.imag, z.mean(axis=1) - z.mean(), tilt.real, tilt.imag,
                     crz - crz.mean()], axis=-1)


def base_residual(run):
    """Return the residual of the base model of physics by dense least squares, and its dof."""
    n, size = run.n, run.size
    rows = np.arange(size)
    phi, alpha = run.phi, run.alpha
    design = np.zeros((size, 3, 12 * n))
    c, s = np.cos(phi), np.sin(phi)
    ring = run.radius * np.stack([np.cos(alpha), np.sin(alpha), 0 * alpha], axis=-1)
    for axis in range(3):
        unit = np.eye(3)[axis]
        design[rows, axis, 3 * (run.table_position - 1) + axis] = 1
        design[rows, :, 3 * n + 3 * (run.table_position - 1) + axis] = np.cross(unit, ring)
        design[rows, axis, 9 * n + 3 * (run.cmm_position - 1) + axis] = 1
    plate = 6 * n + 3 * (run.ball - 1)
    design[rows, 0, plate], design[rows, 1, plate] = c, s
    design[rows, 0, plate + 1], design[rows, 1, plate + 1] = -s, c
    design[rows, 2, plate + 2] = 1
    matrix = design.reshape(3 * size, -1)
    right = (run.centre - ring).ravel()
    solution = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
    return right - matrix @ solution, 3 * n * n - 12 * n + 13


def same(first, second):
    """Tell whether two readings agree bit for bit."""
    return all(np.array_equal(getattr(first, field.name), getattr(second, field.name))
               for field in dataclasses.fields(first))


@pytest.mark.parametrize('order', ORDERS)
def test_ideal_cell_measures_nominal_centres(order):
    """With every error at zero the centres are nominal to rounding."""
    scheme = plan(12, order)
    run = Machine(ideal_cell()).run(scheme, repeats=0, align=False)
    assert np.abs(run.centre - scheme.centres(run.radius)).max() < 1e-15


def test_ideal_cell_finds_its_frame():
    """Alignment of an ideal cell far from the CMM's origin gives the true frame."""
    machine = Machine(ideal_cell(placement={'origin_mm': [350, 260, -300], 'axis_tilt_mrad': 0.5}))
    found = machine.align().frame
    assert np.abs(found.origin - machine.true_frame.origin).max() < 1e-14
    # x goes through ball 1, true x is only tilted with the axis: equal to second order.
    assert np.abs(found.rotation - machine.true_frame.rotation).max() < 0.5e-3**2


def test_closed_form_recovers_pure_table_errors():
    """A run with table errors alone gives the true curves to second order: error^2."""
    machine = Machine(ideal_cell(table={'translation_um': 0.05, 'rotation_urad': 0.3}))
    found = paper_curves(machine.run(plan(12), repeats=0, align=False))
    truth = remove_gauge(machine.table_truth())
    assert np.abs(truth).max() > 1e-7
    assert np.abs(found - truth)[:, :3].max() < 1e-13
    assert np.abs(found - truth)[:, 3:].max() < 1e-12


@pytest.mark.parametrize('align', [False, True])
@pytest.mark.parametrize('n', [6, 7, 12])
def test_closed_form_recovers_the_truth_of_a_whole_cell(n, align):
    """With plate, clamping and CMM as they are, a noise-free run is true within a nanometre.

    What is left is of second order: the gradient of the CMM's errors (1e-6) and the table's tilt
    (3e-7) times the eccentricity (0.2 mm).
    """
    machine = Machine(MachineConfig().changed(plate={'balls': n}, table={'harmonics': 2},
                                              **NOISELESS))
    run, alignment, _ = machine.calibrate(plan(n), align=align)
    truth = remove_gauge(machine.table_truth(frame=alignment.frame))
    error = np.abs(paper_curves(run) - truth)
    assert error[:, :3].max() < one_nanometre
    assert error[:, 3:].max() < 5 * one_nanometre  # radian


def test_truth_in_another_frame_is_the_same_motion():
    """A body point follows the curves of any frame: p = Rodrigues(Theta) R_z(phi) b + T."""
    machine = Machine(MachineConfig())
    frame = machine.align().frame
    body = np.array([0.1, -0.05, 0.03])
    angle = np.linspace(0, 6, 7)

    def path(frame_of):
        curves = machine.table_truth(angle, frame_of)
        start = frame_of.to_inner(machine.true_frame.to_outer(body))
        turned = np.stack([np.cos(angle) * start[0] - np.sin(angle) * start[1],
                           np.sin(angle) * start[0] + np.cos(angle) * start[1],
                           np.full(7, start[2])], axis=-1)
        # Tilt of the found frame against the axis is a few microradian: first order suffices.
        return frame_of.to_outer(turned + np.cross(curves[:, 3:], turned) + curves[:, :3])

    assert np.abs(path(frame) - path(machine.true_frame)).max() < 1e-11


def test_plate_and_cmm_truth_explain_the_run():
    """Measured = R_z (b + P) + T + Theta x R_z b + M with the machine's own truths, to 10 nm."""
    machine = Machine(MachineConfig().changed(**NOISELESS))
    run, alignment, _ = machine.calibrate(plan(12))
    curves = machine.table_truth(frame=alignment.frame)[run.table_position - 1]
    plate = machine.plate_truth(alignment.frame)[run.ball - 1]
    cmm = machine.cmm_truth(alignment.frame)[run.cmm_position - 1]
    c, s = np.cos(run.phi), np.sin(run.phi)
    turned = np.stack([c * plate[:, 0] - s * plate[:, 1], s * plate[:, 0] + c * plate[:, 1],
                       plate[:, 2]], axis=-1)
    ring = run.radius * np.stack([np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=-1)
    model = ring + turned + curves[:, :3] + np.cross(curves[:, 3:], ring) + cmm
    assert np.abs(run.centre - model).max() < 10 * one_nanometre


def test_default_cell_leaves_nothing_but_noise():
    """Reduced chi-square of the base model is 1 on clean runs: no hidden second-order error."""
    ratio = []
    for seed in range(12):
        run = Machine(MachineConfig(seed=seed)).run(plan(12))
        residual, dof = base_residual(run)
        ratio.append(residual @ residual / dof / 0.1e-6**2)
    # sd of the mean of 12 values is sqrt(2 / 301 / 12) = 0.024
    assert abs(np.mean(ratio) - 1) < 4 * 0.024


def test_curves_scatter_as_the_noise_transfer_says():
    """Normalised errors of the closed form have rms 1 (transfer factors of physics, section 8)."""
    factor = 1e-7 * np.array([0.264, 0.264, 0.276, 2.04, 2.04, 1.51])
    errors = []
    for seed in range(30):
        machine = Machine(MachineConfig(seed=seed))
        run, alignment, _ = machine.calibrate(plan(12))
        truth = remove_gauge(machine.table_truth(frame=alignment.frame))
        errors.append((paper_curves(run) - truth) / factor)
    rms = np.sqrt(np.mean(np.square(errors), axis=(0, 1)))
    # 30 * 12 values per curve, about ten in twelve independent: sd of rms 0.04
    assert np.abs(rms - 1).max() < 0.16


@settings(max_examples=15, deadline=None)
@given(n=st.integers(3, 9), order=st.sampled_from(sorted(ORDERS)), seed=st.integers(0, 99),
       turning=st.sampled_from(['forward', 'alternate']), cut=st.integers(1, 8))
def test_one_by_one_equals_all_at_once(n, order, seed, turning, cut):
    """Single calls, and batches of any size, give the same readings bit for bit."""
    scheme = plan(n, order, seed, turning)
    config = MachineConfig(seed=seed).changed(
        plate={'balls': n}, table={'positioning_urad': 1.0}, hidden=[
            {'kind': 'frame_cycle', 'cosine_um': [1, 2, 3], 'period_min': 7},
            {'kind': 'axis_tilt_drift', 'rate_urad_per_h': [2, 3]},
            {'kind': 'asynchronous_motion', 'order': 0.43, 'radial_um': 1, 'tilt_urad': 1},
            {'kind': 'ball_form', 'ball': 2, 'order': 3, 'centre_um': 1},
            {'kind': 'plate_slip', 'shift_um': [1, 0, 0], 'turn_urad': 2, 'at_h': 0.2},
            {'kind': 'cmm_reversal', 'value_um': [1, 1, 1]}])
    whole = Machine(config).measure_many(scheme.table_position, scheme.ball, scheme.approach)
    single, chunks = Machine(config), Machine(config)
    for place in range(0, n * n, cut):
        part = slice(place, place + cut)
        some = chunks.measure_many(scheme.table_position[part], scheme.ball[part],
                                   scheme.approach[part])
        for k in range(some.size):
            i = place + k
            one = single.measure(scheme.table_position[i], scheme.ball[i], scheme.approach[i])
            assert same(one, whole[i])
            assert same(some[k], whole[i])


def test_live_calls_repeat_a_whole_calibration():
    """A client that aims as the offline run does gets the offline run bit for bit."""
    scheme, live = plan(6), Machine(MachineConfig().changed(plate={'balls': 6}))
    _, alignment, offline = Machine(live.config).calibrate(scheme, repeats=3)
    for _ in range(3):
        live.measure(1, 1)
    for i in range(1, 7):
        live.measure(i, 1)
    for j in range(1, 7):
        live.measure(1, j)
    aim = alignment.frame.to_outer(scheme.centres(live.radius))
    for k in range(scheme.ball.size):
        reading = live.measure(scheme.table_position[k], scheme.ball[k], scheme.approach[k],
                               aim[k])
        assert same(reading, offline[k])


def test_a_machine_goes_on_from_a_kept_state():
    """A new machine with the state of an old one continues as the old one would."""
    old = Machine(MachineConfig())
    old.measure_many([1, 5, 3], [1, 2, 7], [1, 1, -1])
    new = Machine(old.config, old.state)
    assert same(old.measure(4, 4), new.measure(4, 4))


@pytest.mark.parametrize('turning', ['forward', 'alternate'])
@pytest.mark.parametrize('order', ORDERS)
def test_time_and_travel(order, turning):
    """Time grows by 20 to 60 s a ball; the travel is the unwrapped angle; senses are as asked."""
    scheme = plan(12, order, turning=turning)
    run = Machine(MachineConfig()).run(scheme, repeats=0, align=False)
    assert run.time[0] == 0
    assert np.all((np.diff(run.time) > 20) & (np.diff(run.time) < 80))
    turns = (run.table_travel - run.table_angle) / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-12
    moved = np.diff(run.table_travel, prepend=0) != 0
    assert np.array_equal(run.approach[moved], scheme.approach[moved])
    # A table that must turn back to where it stands turns not at all: no travel, no new sense.
    expected = unwrap_travel(run.table_angle, scheme.approach, 12)
    assert np.abs(run.table_travel - expected).max() < 1e-12


def test_a_place_is_approached_anew_from_the_other_side():
    """From one division before: there and back take the time of two divisions."""
    machine = Machine(MachineConfig().changed(plate={'balls': 6}))
    readings = [machine.measure(2, 1, approach) for approach in (1, -1, -1, 0)]
    assert [reading.approach for reading in readings] == [1, -1, -1, -1]
    assert machine.state.turned == 3 and machine.state.steps == 1
    assert readings[1].began + 2 * 60 / machine.config.timing.table_speed_deg_per_s < readings[1].time


def test_approach_is_zero_before_the_table_has_moved():
    """A cell just switched on does not know from which side its table came."""
    machine = Machine(MachineConfig())
    assert machine.measure(1, 1).approach == 0
    assert machine.measure(1, 2, approach=-1).approach == 0
    assert machine.measure(2, 2, approach=-1).approach == -1
    assert machine.state.steps == -11


def test_plate_turned_on_the_table():
    """A plate put on turned by three pitches shows the same table, and its balls counted on."""
    config = MachineConfig().changed(**NOISELESS)
    still = ideal_cell(plate={'deviation_um': 20.0})
    turned = still.changed(clamping={'plate_turn_deg': 90.0})
    first, second = Machine(still).plate_truth(), Machine(turned).plate_truth()
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.abs(np.roll(first @ quarter.T, 3, axis=0) - second).max() < 1e-16
    curves = [paper_curves(Machine(each).run(plan(12))) for each in
              (config, config.changed(clamping={'plate_turn_deg': 90.0}))]
    assert np.abs(curves[0] - curves[1]).max() < 2 * one_nanometre


def test_verification_runs_of_the_paper():
    """Runs (i)-(vi): same curves whatever plate and CMM do; switching off crz shows its table."""
    config = MachineConfig().changed(**NOISELESS)
    settings_of = [
        {}, {'clamping': {'plate_turn_deg': 90.0}}, {'cmm': {'correction': False}},
        {'cmm': {'correction': False},
         'table': {'axial_correction': False, 'angular_correction': False}}]
    first, second, third, fourth = (
        paper_curves(Machine(config.changed(**each)).run(plan(12))) for each in settings_of)
    assert np.abs(first[:, :3]).max() < 0.06e-6
    assert np.abs(first[:, 3:]).max() < 0.35e-6
    for other in (second, third):
        assert np.abs(other - first)[:, :3].max() < 0.02e-6
        assert np.abs(other - first)[:, 3:].max() < 0.2e-6
    maker = remove_gauge(Machine(config).maker_table())
    assert np.abs(fourth - first)[:, 5].max() > 1e-6
    assert np.abs(fourth - maker)[:, 5].max() < 0.4e-6
    assert np.abs(fourth - maker - first)[:, [2, 5]].max() < 0.01e-6


def test_fine_orders_are_folded_by_the_run():
    """Orders above n/2 look like lower ones: order 10 of the table shows at 12 positions as 2."""
    machine = Machine(ideal_cell(table={'translation_um': 0.05, 'fine_orders': [10],
                                   'fine_share': 1.0, 'harmonics': 1}))
    ctz = paper_curves(machine.run(plan(12), repeats=0, align=False))[:, 2]
    spectrum = np.abs(np.fft.rfft(ctz)) / 6
    assert spectrum[2] == pytest.approx(0.05e-6, rel=1e-6)
    assert machine.table_truth(np.array([0.3]))[0, 2] != pytest.approx(
        machine.table_truth(np.array([0.3 + np.pi / 6]))[0, 2], abs=1e-9)


def test_actual_angle_is_recorded_where_the_table_stops():
    """A table that stops off its division shows it: the balls lie where the encoder shows."""
    machine = Machine(ideal_cell(table={'positioning_urad': 5.0}))
    run = machine.run(plan(12), repeats=0, align=False)
    off = run.angle_deviation
    assert off.std() == pytest.approx(5e-6, rel=0.25)
    ring = run.radius * np.stack([np.cos(run.alpha + off), np.sin(run.alpha + off),
                                  0 * off], axis=-1)
    assert np.abs(run.centre - ring).max() < 1e-15


def test_temperature_is_what_the_thermometer_shows():
    """Drift, day and air conditioning act on the thermometer, plus its noise."""
    config = MachineConfig().changed(climate={'daily_K': 0, 'cycle_K': 0, 'drift_K_per_h': 0.5})
    _, _, readings = Machine(config).calibrate(plan(12))
    expected = 20 + 0.5 * readings.ended / 3600
    assert np.std(readings.temperature - expected) == pytest.approx(0.002, rel=0.3)


def test_wrong_targets_are_refused_in_words():
    """Indices out of range, a plate of another size and a lost ball are reported, nothing moves."""
    machine = Machine(MachineConfig())
    with pytest.raises(InvalidPlan, match=r'^table position: expected 1..12, found 13$'):
        machine.measure(13, 1)
    with pytest.raises(InvalidPlan, match=r'^ball: expected 1..12, found 0$'):
        machine.measure(1, 0)
    with pytest.raises(InvalidPlan, match=r'expected one for the 12 balls of this plate, found .* 6'):
        machine.run(plan(6))
    with pytest.raises(BallNotFound, match=r'table position 1, ball 4: expected a ball within 5 mm '
                                           r'of the aim, its centre is .* mm away; check the'):
        machine.measure(1, 4, aim=[0, 0, 0])
    assert machine.time == 0
    assert machine.state.readings == 0


def test_repeatability_is_measured_before_the_run():
    """Sigma comes from repeated readings, pooled over the axes; without noise there is none."""
    run, alignment, _ = Machine(MachineConfig()).calibrate(plan(12), repeats=40)
    assert run.repeatability == alignment.repeatability == pytest.approx(1e-7, rel=0.25)
    assert run.repeatability_dof == 117
    assert Machine(ideal_cell()).run(plan(12)).repeatability is None

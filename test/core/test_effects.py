# SPDX-License-Identifier: Apache-2.0
"""Laws over every effect of the library, and what each does to a ball."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import RADIUS, synthetic_run

from rosette_ros.core.diagnosis.effect_settings import choose_settings
from rosette_ros.core.effects.composed import LAWS, effect
from rosette_ros.core.effects.courses import Drift
from rosette_ros.core.effects.effect import PhysicalEffect, Quantity, Setting
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.effects.library import EFFECTS, effects_of
from rosette_ros.core.effects.motions import FrameAxes
from rosette_ros.core.effects.run_functions import around
from rosette_ros.core.model.least_squares import fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.axes import axis_rotation
from rosette_ros.core.run.errors import InvalidModel
from rosette_ros.core.run.geometry import rotate_z

EVERY = [*LAWS.values(), FREE]
FIXED_NAMES = {
    'frame_drift', 'frame_drift_onset', 'frame_drift_curved', 'frame_warmup', 'frame_temperature',
    'frame_temperature_lag', 'frame_cycle', 'frame_step', 'frame_pulse', 'frame_recovery',
    'table_zero_step', 'axis_tilt_step', 'table_zero_warmup', 'axis_tilt_warmup', 'table_zero_temperature',
    'axis_tilt_temperature', 'table_zero_lag', 'axis_tilt_lag',
    'table_zero_drift', 'axis_tilt_drift', 'table_backlash', 'table_backlash_angle', 'encoder_interpolation',
    'asynchronous_motion', 'table_warmup', 'plate_creep', 'plate_creep_settling', 'plate_slip', 'plate_tilt_step',
    'plate_tilt_settling', 'plate_expansion', 'plate_expansion_lag', 'plate_soaking', 'plate_warp', 'plate_support',
    'ball_slip', 'ball_creep', 'ball_rattle', 'ball_machine_offset', 'ball_sag', 'ball_form',
    'cmm_scale_drift', 'cmm_scale_temperature', 'cmm_scale_lag', 'cmm_squareness_drift', 'cmm_reversal',
    'cmm_reversal_position', 'probe_approach', 'outlier'}


def warm_run(n=6, order='random', turning='alternate', **rest):
    """Return a run with everything recorded: senses, travel, a temperature that is no line in time."""
    run, _, plate, _ = synthetic_run(n, order, 3, turning=turning, **rest)
    beside = 1e-4 * np.sin(run.time)  # the table stops a little beside the nominal angles
    ball = rotate_z(run.phi, rotate_z(run.beta, [RADIUS, 0, 0]) + plate[run.ball - 1])
    return run.replace(temperature=20 + 0.1 * np.sin(run.time / 700.0), table_angle=run.phi + beside,
                       centre=run.centre + rotate_z(beside, ball) - ball)


def few_settings(subject, run):
    """Return the first, the middle and the last setting of each number of columns."""
    every = subject.settings(run)
    return [every[k] for k in sorted({0, len(every) // 2, len(every) - 1})]


def test_names_are_the_fixed_ones():
    """The names that files, messages and the screen rely on are all there."""
    assert set(EFFECTS) == FIXED_NAMES
    assert all(name == subject.name for name, subject in LAWS.items())


def test_every_effect_explains_itself():
    """Each effect says what it means, where to look, its form and where it comes from."""
    for subject in LAWS.values():
        for text in (subject.meaning, subject.look, subject.formula, subject.source):
            assert len(text) > 2
        assert subject.meaning.endswith('.')


def test_columns_and_blocks_agree():
    """Columns have shape (N, 3, q) with q amplitudes, are finite, and blocks give the same."""
    run = warm_run()
    for subject in EVERY:
        for setting in few_settings(subject, run):
            columns = subject.columns(run, setting)
            assert columns.shape == (run.size, 3, len(subject.amplitudes(run, setting)))
            assert np.all(np.isfinite(columns)) and np.any(columns)
            assert np.array_equal(subject.blocks(run, [setting])[0], np.moveaxis(columns, -1, 0))


def test_factors_are_the_columns():
    """Functions times directions, beside the readings of a single ball zero, are the columns in some order."""
    run = warm_run()
    for subject in EVERY:
        chosen = few_settings(subject, run)
        found = subject.factors(run, chosen)
        assert sorted(map(id, chosen)) == sorted(id(setting) for one in found for setting in one.settings)
        for one in found:
            for setting, (wave, which) in zip(one.settings, one.of_setting):
                functions = np.zeros((one.waves.shape[1], run.size))
                functions[:, slice(None) if one.at is None else one.at] = one.waves[wave]
                made = np.einsum('mn,dnc->mdnc', functions, one.directions[list(which)]).reshape(-1, 3 * run.size)
                columns = subject.columns(run, setting).reshape(3 * run.size, -1).T
                assert sorted(map(tuple, made.round(9))) == sorted(map(tuple, columns.round(9) + 0.0))


def test_every_effect_says_what_moves_and_by_what():
    """A body and variables of a reading, as the diagnosis compares causes by them."""
    for subject in LAWS.values():
        assert subject.body in {'frame', 'table axis', 'plate', 'ball', 'CMM', 'reading'}
        assert subject.variables and set(subject.variables) <= {
            'time', 'temperature', 'ball', 'table angle', 'CMM position', 'travel', 'table sense', 'cmm sense',
            'cmm direction', 'reading', 'encoder', 'table memory'}


@pytest.mark.parametrize('subject', EFFECTS.values(), ids=lambda e: e.name)
def test_a_moment_lies_between_two_readings(subject):
    """The columns of any moment between them are proportional, those of a moment beyond them are not."""
    run = warm_run()
    time = run.time - run.time[0]
    wanted = {one.name for one in subject.searched if (one.kind, one.unit) == ('instant', 's')}
    for setting in few_settings(subject, run):
        found = subject.moments(run, setting)
        assert set(found) == wanted & set(setting)
        for name, times in found.items():
            low, high = around(times, setting[name])
            assert low <= setting[name] < high and {low, high} <= set(time.tolist())
            columns = subject.columns(run, setting)
            for moment, same in ((low, True), (0.5 * (low + high), True), (low - 1e-3, False), (high, False)):
                other = subject.columns(run, Setting({**setting, name: moment}))
                size = np.linalg.norm(other) / np.linalg.norm(columns)
                assert (size > 0 and np.allclose(other, size * columns, rtol=1e-9, atol=1e-12)) == same


def test_the_moment_of_a_ball_lies_between_its_own_readings():
    """Readings of other balls place it no better."""
    run = warm_run()
    own = run.time[run.ball == 3] - run.time[0]
    times = EFFECTS['ball_slip'].moments(run, Setting(ball=3, t0=float(own[2] + 1)))['t0']
    assert times.tolist() == own.tolist() and around(times, float(own[2] + 1)) == (own[2], own[3])
    assert EFFECTS['ball_slip'].moments(run, Setting(ball=3, t0=-1.0)) == {}


OF_A_BALL = [one for one in EVERY if any(searched.name == 'ball' for searched in one.searched)]


def test_settings_name_balls_that_the_run_has():
    """A ball that was not measured shows nothing, and no setting is spent on it; 0 stands for all."""
    run = warm_run(8)
    part = run.take(np.isin(run.ball, [1, 2, 4, 7, 8]))
    for subject in OF_A_BALL:
        assert {setting['ball'] for setting in subject.settings(run)} - {0} == set(range(1, 9))
        assert {setting['ball'] for setting in subject.settings(part)} - {0} == {1, 2, 4, 7, 8}
        assert len(subject.settings(part)) < len(subject.settings(run))


def test_known_truth_is_recovered():
    """An effect with known amplitudes, added to a run, comes back with them, and takes its error away."""
    for subject in LAWS.values():
        run = warm_run(6, rotation=axis_rotation([0, 1, 0]) if subject.needs_tilt else None)
        setting = few_settings(subject, run)[0]
        columns = subject.columns(run, setting)
        rng = np.random.default_rng(1)
        size = 1e-6 / np.maximum(np.abs(columns).max(axis=(0, 1)), 1e-12)
        truth = size * (1 + rng.random(columns.shape[-1]))
        moved = run.replace(centre=run.centre + columns @ truth)
        model = Model().with_effect(subject.name, setting)
        result = fit(moved, model, (setting,))
        assert result.rms < 1e-10  # less than a thousandth of what was added
        assert fit(moved).rms > 1e-8
        found = np.array([p.value for p in result.effects[0].parameters[:truth.size]])
        seen = ~result.joint.undetermined[:truth.size]
        assert seen.any()
        assert np.allclose(found[seen], truth[seen], rtol=1e-3)
        assert np.allclose(result.error_motions.values, fit(run).error_motions.values, atol=1e-9)


def test_columns_do_not_depend_on_the_ball_centres():
    """The physics of an effect knows times, angles and senses, never the measured values."""
    run = warm_run()
    other = run.replace(centre=run.centre + 1e-3)
    for subject in LAWS.values():
        setting = few_settings(subject, run)[0]
        assert np.array_equal(subject.columns(run, setting), subject.columns(other, setting))


def test_fixed_values_hold():
    """A fixed parameter stays as it was given, while what is searched beside it is what this order shows."""
    run = warm_run(6, noise=1e-7)
    for subject in effects_of(run).values():
        for name, value in subject.settings(run)[-1].items():
            setting, = choose_settings(run, Model().with_effect(subject.name, {name: value}))
            assert setting[name] == value, subject.name


def test_sag_is_gravity_in_the_plate():
    """A stem that bends by what gravity pulls across it: c cos + s sin in the axes of the plate, at any place."""
    run = warm_run(6, rotation=axis_rotation([1, 0, 0]))
    stiff = np.random.default_rng(1).standard_normal((3, 3))  # displacement per g, axes of the plate, ball 3
    down = run.rotation.T @ [0, 0, -1.0]
    pull = rotate_z(-run.phi, down)
    wanted = (run.ball == 3)[:, None] * rotate_z(run.phi, pull @ stiff.T)
    c, s = stiff @ down, stiff @ [down[1], -down[0], 0.0]
    columns = EFFECTS['ball_sag'].columns(run, Setting(ball=3))
    assert columns @ np.concatenate([c, s]) == pytest.approx(wanted, abs=1e-14)
    every = EFFECTS['ball_sag'].columns(run, Setting(ball=0)).reshape(run.size, 3, 6, 6)
    assert np.array_equal(every[:, :, 2], columns)
    assert np.array_equal(every.sum(axis=2)[run.ball == 3], columns[run.ball == 3])


def test_an_effect_of_gravity_needs_an_axis_that_is_not_vertical():
    """Such a table has it; another one, up or down, cannot, and a run that does not know says so."""
    sag, run = EFFECTS['ball_sag'], warm_run(6)
    assert 'does not say how the table axis stands' in sag.unavailable(run)
    for axis in ([0, 0, 1], [0, 0, -1], [0.01, 0, 1]):
        upright = run.replace(rotation=axis_rotation(axis))
        assert sag.unavailable(upright) == 'the table axis is vertical: gravity does not turn in the plate'
        assert list(effects_of(upright)) == [name for name in EFFECTS if name != 'ball_sag']
    for axis in ([1, 0, 0], [0.1, 0, 1], [0, 1, -1]):
        assert effects_of(run.replace(rotation=axis_rotation(axis))) == EFFECTS
    assert effects_of(run).keys() == EFFECTS.keys() - {'ball_sag'}


def test_directions_of_the_forms():
    """The forms of the page, at readings worked out by hand (n = 6, ball 1 at table position 2)."""
    run = warm_run(6, 'row', 'forward')
    at = int(np.flatnonzero((run.table_position == 2) & (run.ball == 1))[0])
    c, s, t = 0.5, np.sqrt(3) / 2, run.time[at] - run.time[0]
    expected = {
        'table_zero_drift': RADIUS * t * np.array([[-s], [c], [0]]),
        'table_backlash': 0.5 * RADIUS * np.array([[-s], [c], [0]]),
        'axis_tilt_drift': RADIUS * t * np.array([[0, 0], [0, 0], [s, -c]]),
        'plate_creep': t * np.array([[c, -s], [s, c], [0, 0]]),
    }
    for name, columns in expected.items():
        assert np.allclose(EFFECTS[name].columns(run, Setting())[at], columns, atol=1e-12), name
    body = EFFECTS['plate_tilt_step'].columns(run, Setting(height=0.05, t0=run.time[at] - 1))[at]
    assert np.allclose(body, [[0, 0.05 * s, 0.05 * c], [0, -0.05 * c, 0.05 * s], [1, 0, -RADIUS]], atol=1e-12)
    assert not np.any(EFFECTS['plate_tilt_step'].columns(run, Setting(height=0.05, t0=run.time[at] + 1))[at])
    growth = EFFECTS['plate_expansion'].columns(run, Setting(driver='time'))[at]
    assert np.allclose(growth, RADIUS * t * np.array([[c], [s], [0]]), atol=1e-12)
    form = EFFECTS['ball_form'].columns(run, Setting(ball=1, harmonic=2))[at]
    c2, s2 = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    assert np.allclose(form, [[c2, -s2, 0, 0], [-s2, -c2, 0, 0], [0, 0, c2, s2]], atol=1e-12)
    warp = EFFECTS['plate_warp'].columns(run, Setting(order=2))[at]
    assert np.allclose(warp, t * np.array([[0, 0], [0, 0], [1, 0]]), atol=1e-12)


def test_a_rigid_motion_begins_with_the_columns():
    """To first order its rotation, growth and shift are what the columns say, also where temperatures are missing."""
    run = warm_run(8)
    run = run.replace(temperature=np.where((run.time > 700) & (run.time < 1300), np.nan, run.temperature))
    arm = RADIUS * np.stack([np.cos(run.alpha), np.sin(run.alpha), 0 * run.alpha], axis=1)
    for subject in [one for one in LAWS.values() if one.moves_plate]:
        tilts = [one for one in subject.settings(run) if one.get('motion') == 'tilt']
        for setting in (*few_settings(subject, run), *tilts[:3]):
            columns = subject.columns(run, setting)
            amplitudes = np.random.default_rng(1).standard_normal(columns.shape[2])
            motion = subject.body_motion(run, setting, amplitudes)
            # an axis that moves sideways, too, shifts the plate in the machine: that is linear
            if motion is not None and not (subject.name == 'asynchronous_motion' and setting['motion'] == 'all'):
                found = np.cross(motion.rotation, arm) + motion.growth[:, None] * arm + rotate_z(run.phi, motion.shift)
                assert found == pytest.approx(columns @ amplitudes, abs=1e-12 * np.abs(columns).max())


def test_records_that_are_missing():
    """Without temperatures or senses an effect says that it cannot be judged."""
    run, *_ = synthetic_run(6)
    assert EFFECTS['frame_temperature'].unavailable(run) == 'the run has no temperatures'
    silent = run.replace(approach=np.zeros(36))
    assert 'sense the table moved' in EFFECTS['table_backlash'].unavailable(silent)


def test_an_unknown_name_is_refused_with_the_nearest():
    """A misspelt effect, and a misspelt setting."""
    with pytest.raises(InvalidModel, match="Unknown effect 'frame_drit'. Did you mean frame_drift"):
        effect('frame_drit')
    with pytest.raises(InvalidModel, match="expected settings among axes, tau, found 'tua'"):
        Model().with_effect('frame_warmup', {'tua': 3.0})


@given(order=st.sampled_from(['row', 'diagonal', 'column', 'random']), n=st.integers(4, 9))
@settings(max_examples=15)


def test_effects_are_what_the_run_says(order, n):
    """In every order each effect has settings and columns of the right size."""
    run = warm_run(n, order)
    for subject in LAWS.values():
        for setting in few_settings(subject, run):
            assert subject.columns(run, setting).shape[:2] == (n * n, 3)


def test_whole_numbers_may_be_written_with_a_point():
    """A model file that says `reading: 3.0` means the third reading, and `ball: 2.0` the second ball."""
    run = warm_run()
    for name, whole in (('outlier', {'reading': 3}), ('ball_slip', {'ball': 2, 't0': 500.0}),
                        ('ball_form', {'ball': 2, 'harmonic': 3, 'part': 'xy'})):
        pointed = Setting({key: float(value) if isinstance(value, int) else value for key, value in whole.items()})
        assert np.array_equal(EFFECTS[name].columns(run, pointed), EFFECTS[name].columns(run, Setting(whole))), name
        assert EFFECTS[name].amplitudes(run, pointed) == EFFECTS[name].amplitudes(run, Setting(whole))


@pytest.mark.parametrize('value', [0, -1.0, float('nan'), float('inf'), 10**400, True, 'long'])


def test_what_a_scale_cannot_be(value):
    """A time constant is a positive number that a float can hold."""
    with pytest.raises(InvalidModel, match=r'effect frame_warmup: tau: expected a positive number \(s\), found'):
        Model().with_effect('frame_warmup', {'tau': value})


def test_a_fact_that_no_effect_has_is_refused():
    """A misspelt word of a declaration is not kept beside the right one."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'meanning'"):
        PhysicalEffect('my_drift', FrameAxes(), Drift(), Quantity('d', 'm/s', 'rate along'), meanning='It drifts.')


def test_every_amplitude_has_a_prior_variance():
    """One for each column: 1 of named effects, of motions without a name that of its function along each direction; at
    one place functions are zero beside it and free of its constant deviation."""
    run = synthetic_run(6, 'random', 0)[0]
    for one in effects_of(run).values():
        for setting in one.settings(run)[:1]:
            np.testing.assert_array_equal(one.variances(run, setting), np.ones(one.width(run, setting)))
    for setting in FREE.settings(run):
        functions, variance = FREE.course(run, setting)
        count = FREE.columns(run, setting).shape[2] // len(functions)
        assert FREE.variances(run, setting).tolist() == [each for each in variance for _ in range(count)]
        number = setting.word('of').removeprefix('ball ').split()[0]
        if number.isdigit():
            own = run.ball == int(number)
            assert not functions[:, ~own].any() and np.abs(functions.sum(axis=1)).max() < 1e-12


@pytest.mark.parametrize(('name', 'constants'), [
    ('frame_warmup', ['tau']), ('frame_cycle', ['period']), ('plate_warp', ['order']), ('probe_approach', ['lobes']),
    ('plate_slip', []), ('frame_recovery', []), ('ball_slip', [])])
def test_constants_are_what_a_machine_has_in_each_run(name, constants):
    """Time constants, periods and harmonics; no axes, moments and phases, and nothing of an event."""
    assert [one.name for one in LAWS[name].constants] == constants

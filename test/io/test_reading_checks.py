# SPDX-License-Identifier: Apache-2.0
"""What a CMM's node does wrong is found from its answers, and said in the verdict."""

import inspect
import re
import warnings

import numpy as np
import pytest

from rosette_ros.analysis import judge
from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.core.diagnosis.diagnosis import diagnose
from rosette_ros.core.diagnosis.verdict import Level, Outcome
from rosette_ros.core.effects.library import EFFECTS
from rosette_ros.core.run.records import resolution_of, steps_of
from rosette_ros.core.run.remarks import RemarkKind, remark
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.io.messages import MACHINE_FRAME, STATUS_OK, Answer, TableFrame
from rosette_ros.io.open_run import open_run
from rosette_ros.io.reading_checks import (
    check_answers,
    is_in_seconds,
    known_temperatures,
    remarks_on_run,
    remarks_on_table,
)
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words import reading_words
from rosette_ros.words.reading_words import fact_words, remark_words
from rosette_ros.words.verdict_words import verdict_text

N = 6
BEGIN = 1_700_000_000 * 10**9


def measured(turning='alternate', **changes):
    """Return the answers of the simulated machine to a whole calibration, in the machine frame; changes: by field, what
    a mistaken node makes of (target, answer)."""
    machine = Machine(MachineConfig().changed(seed=2, plate={'balls': N}))
    calibration = plan_calibration(plan(N, 'diagonal', 0, turning), machine.radius, machine.rough_frame)
    run, frame = RunAnswers('run'), machine.true_frame
    for index in range(calibration.total):
        target = calibration.target(index)
        x, y, z = frame.to_outer(target.centre).tolist()
        target = target._replace(run_id='run', attempt=1, session=1, centre=(x, y, z), frame_id=MACHINE_FRAME,
                                 stamp_ns=BEGIN + round(1e9 * machine.time))
        got = machine.measure(target.table_position, target.ball, target.approach)
        answer = Answer(
            'run', target.seq, target.table_position, target.ball, target.cmm_position, STATUS_OK, '', got.table_angle,
            got.table_travel, int(got.approach), tuple(got.centre.tolist()), got.form_error, got.temperature,
            MACHINE_FRAME, BEGIN + round(1e9 * got.time))
        run.add_target(target)
        run.add_answer(answer._replace(**{name: change(target, answer) for name, change in changes.items()}))
    run.frames.append(TableFrame(BEGIN, frame))
    return run


def rounded(step):
    """Return what rounds centres to steps of so many m."""
    return lambda _, answer: tuple((np.rint(np.array(answer.centre) / step) * step).tolist())


def said(run):
    """Return the remarks on a run that is written as a table, in words."""
    return [remark_words(one) for one in parse_csv(format_csv(run).encode()).remarks]


MISTAKES = {
    'zero stamps': ('stamps', {'stamp_ns': lambda _, a: 0}, 'header.stamp is 0 in 59 of 59 answers'),
    'one stamp': ('stamps', {'stamp_ns': lambda _, a: BEGIN}, 'header.stamp is the same as another in 58 of 59'),
    'clock set back': ('stamps', {'stamp_ns': lambda t, a: a.stamp_ns - (600 * 10**9 if t.seq > 30 else 0)},
                       'the clock was set back by '),
    'constant travel': ('travel', {'table_travel': lambda _, a: 0.0}, 'table_travel stays the same in 42 moves'),
    'travel within one turn': ('travel', {'table_travel': lambda _, a: a.table_angle},
                               'table_travel is not cumulative: it jumps by whole turns in'),
    'travel in degrees': ('travel', {'table_travel': lambda _, a: float(np.rad2deg(a.table_travel))},
                          'where the table was asked to turn by 1.0472 rad'),
    'no approach': ('approach', {'approach': lambda _, a: 0}, 'approach is always 0 after 42 of 42 moves'),
    'other approach': ('approach', {'approach': lambda _, a: 1}, 'approach is not the asked sense after'),
    'rounded': ('resolution', {'centre': rounded(1e-6)}, 'readings are rounded to 1 µm; give every digit'),
    'echo': ('places', {'centre': lambda target, _: target.centre},
             '59 of 59 answers are exactly the place where the ball was expected'),
}


@pytest.mark.parametrize('turning', ['forward', 'alternate'])
def test_a_sound_cmm_is_not_remarked_on(turning):
    """Neither the answers nor the run."""
    run = measured(turning)
    assert not any(check_answers(run.counting()).values())
    assert RunAssembly(run).run().remarks == ()


@pytest.mark.parametrize('mistake', MISTAKES)
def test_a_mistake_is_named(mistake):
    """By its check alone, in the remarks of the run."""
    check, changes, words = MISTAKES[mistake]
    run = measured(**changes)
    found = {name: remark for name, remark in check_answers(run.counting()).items() if remark}
    assert list(found) == [check]
    assert words in remark_words(found[check])
    assert found[check] in RunAssembly(run).run().remarks


@pytest.mark.parametrize('mistake', {check: mistake for mistake, (check, *_) in MISTAKES.items()}.values())
def test_the_verdict_on_a_mistake_is_not_good(mistake):
    """It has the remark; one mistake of each check."""
    _, changes, words = MISTAKES[mistake]
    verdict = judge(RunAssembly(measured(**changes)).run())
    assert any(words in remark_words(one) for one in verdict.remarks)
    assert verdict.level != Level.GOOD


@pytest.mark.parametrize('unmeasured', [lambda *_: 0.0, lambda target, one: one.temperature * (target.seq > 30)])
def test_a_temperature_that_was_not_measured_is_a_doubt(unmeasured):
    """A field that no node sets is 0; so is what a thermometer gives before it is there."""
    verdict = judge(RunAssembly(measured(temperature=unmeasured)).run())
    [words] = map(remark_words, verdict.remarks)
    assert re.match(r'the temperature is 0 °C in \d+ of 36 readings; was it measured\? ', words)
    assert verdict.level != Level.GOOD


def test_a_gap_of_an_hour_is_said():
    """A clock that is set to summer time, or a run that was interrupted: where, and how long; a stated pause is none,
    nor is a slow CMM."""
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': N})).run(plan(N, 'random'))
    later = np.arange(run.size) >= 20
    for hours, also in ((1, 0), (2, 0), (1, 1)):
        gone = run.replace(time=run.time + 3600.0 * hours * later + 3600.0 * also * (np.arange(run.size) >= 30))
        [words] = map(remark_words, remarks_on_run(gone))
        minutes = (gone.time[20] - gone.time[19]) / 60
        assert words.startswith(f'much time lies between readings 20 and 21 ({minutes:.0f} min)')
        assert (', 30 and 31 (' in words) == bool(also) and 'was the clock changed' in words
        table = parse_csv(format_csv(gone).encode())
        assert tuple(map(remark_words, table.remarks)) == (words,)
    assert judge(table).level != Level.GOOD
    assert remarks_on_run(run.replace(time=run.time + 3600.0 * later, session=1 + later)) == ()
    assert remarks_on_run(run.replace(time=3000.0 * np.arange(run.size))) == ()
    again = run.replace(repeats=True).take([*range(run.size), 3, 7])
    waited = again.replace(time=30.0 * np.arange(again.size) + 4200.0 * (np.arange(again.size) >= run.size))
    assert remarks_on_run(waited) == ()  # a cell that measures on waits for what it wants to see


@pytest.mark.parametrize(('pace', 'factor', 'unit'), [
    (31.0, 10.0, '1/10 s'), (31.0, 100.0, '1/100 s'), (31.0, 0.5, ''), (120.0, 1.0, ''), (8.0, 1.0, ''),
    (90.0, 1 / 60, 'minutes')])
def test_a_time_is_doubted_that_no_machine_needs(pace, factor, unit):
    """By what it takes to touch a ball, turn the table and move the CMM: 310 s a ball are ticks of 1/10 s, 1.5 s are
    minutes of a slow machine; 2 minutes, or 8 s, may be."""
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': N})).run(plan(N, 'sensitive'))
    timed = run.replace(time=factor * pace * np.arange(run.size))
    found = [one for one in remarks_on_table(timed, 0.0, True) if one.kind is RemarkKind.UNIT_OF_TIME]
    assert bool(found) == bool(unit)
    for one in found:
        words = remark_words(one)
        assert f'is time_s in {unit}, which would be {pace:g} s? give seconds' in words
        assert ('effects in time cannot be found' in words) == (not is_in_seconds(timed.time))


def warming_in(tmp_path, factor):
    """Return the run of a table whose times are in another unit; the machine warms up."""
    warm = {'kind': 'frame_warmup', 'amplitude_um': [1.6, 1.0, -0.7], 'time_constant_h': 0.1}
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': N}, hidden=[warm])).run(plan(N, 'sensitive'))
    (tmp_path / 'table.csv').write_text(format_csv(run.replace(time=1e4 + factor * run.time)))
    return open_run(tmp_path / 'table.csv')


@pytest.mark.parametrize(('factor', 'unit'), [(1e9, 'ns'), (1e6, 'µs'), (1e3, 'ms'), (1 / 3600, 'hours')])
def test_the_unit_of_a_time_is_doubted(tmp_path, factor, unit):
    """By its own name, and what it is without."""
    [words] = map(remark_words, warming_in(tmp_path, factor).remarks)
    assert f'is time_s in {unit}, which would be 3' in words
    assert words.endswith(' s? give seconds; until then effects in time cannot be found')


@pytest.mark.parametrize('factor', [1e9, 1 / 3600])
def test_a_time_in_another_unit_says_nothing_of_effects_in_time(tmp_path, factor):
    """A warm-up is found as what moves with the number of readings, without a time constant of a million years."""
    table = warming_in(tmp_path, factor)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = diagnose(table)
    assert found.verdict.level != Level.GOOD
    assert not any('time' in EFFECTS[name].variables for name in found.missing)
    text = verdict_text(found.verdict)
    assert not re.search(r'\d (min|h)\b', f'{text.sentence} {text.action}')


def test_a_model_that_fits_doubtful_readings_is_an_outcome():
    """A zero travel changes no curve: the model fits, but the verdict is not good."""
    run = RunAssembly(measured(table_travel=lambda _, answer: 0.0)).run()
    verdict = judge(run)
    assert verdict.outcome == Outcome.DOUBTFUL_READINGS
    assert re.fullmatch(r'The model fits: .*\. The readings themselves are in doubt\.', verdict_text(verdict).sentence)
    assert not verdict.model_fails


@pytest.mark.parametrize('step', [1e-3, 5e-5, 1e-6, 5e-7, 1e-8])
def test_the_step_is_found_from_the_digits(step):
    """Of coordinates about a metre from the origin, whose last bit is 0.1 fm; unrounded ones have none."""
    values = np.random.default_rng(1).uniform(-1, 1, 60)
    assert resolution_of(np.rint(values / step) * step) == step
    assert resolution_of(values) == 0


@pytest.mark.parametrize('digits', [3, 4, 5])
def test_the_step_of_few_significant_digits_differs_with_the_size(digits):
    """A unit of the last digit of each number; the largest one is what readings are said to be rounded to."""
    sizes = np.array([182.526253, 0.0313795, -91.2345678, 7.7318, -0.000119380875, 0.30452655, 0.0])
    written = np.array([float(f'{one:.{digits - 1}e}') for one in sizes]) / 1e3
    tenths = np.array([2, -2, 1, 0, -4, -1])
    np.testing.assert_allclose(steps_of(written)[:6], 10.0**(tenths + 1 - digits) / 1e3, rtol=1e-12)
    assert steps_of(written)[6] == 0 and resolution_of(written) == pytest.approx(10.0**(-digits))
    assert not steps_of(sizes / 3e3).any()


def test_a_thermometer_that_stands_still_tells_no_temperature():
    """In 12 readings of more than 10 minutes; short runs and coarse steps of one that moves are nothing."""
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': N})).run(plan(N, 'diagonal'))
    still = run.replace(temperature=np.full(run.size, 19.973))
    [words] = [remark_words(one) for one in remarks_on_run(still)]
    assert words.startswith('the temperature is 19.973 °C in all 36 readings of ') and 'was it measured?' in words
    assert not known_temperatures(still).size
    for temperature, time in ((np.round(run.temperature, 2), run.time), (still.temperature, run.time / 10)):
        other = run.replace(temperature=temperature, time=time)
        assert not remarks_on_run(other) and known_temperatures(other).size == run.size


def test_rounding_below_the_repeatability_is_no_mistake():
    """The machine repeats to 0.1 µm: steps of 50 nm add 1 % to its noise."""
    assert RunAssembly(measured(centre=rounded(5e-8))).run().remarks == ()


def test_a_table_is_checked_too():
    """Rounded coordinates, a constant time, another radius than stated."""
    run = Machine(MachineConfig().changed(seed=2, plate={'balls': N})).run(plan(N, 'random'))
    assert parse_csv(format_csv(run).encode()).remarks == ()
    [remark] = said(run.replace(centre=np.round(run.centre, 6)))
    assert remark.startswith('readings are rounded to 1 µm')
    [remark] = said(run.replace(time=np.zeros(run.size)))
    assert remark.startswith('the time is the same in all 36 readings')
    for changed, words in (({'time': run.time / 3600}, 'measures and the table turns; is time_s in hours'),
                           ({'temperature': 32 + 1.8 * run.temperature}, '°C; is it in °F or K? give °C'),
                           ({'temperature': run.temperature + 273.15}, 'the temperature is 293.'),
                           ({'temperature': np.zeros(run.size)}, 'the temperature is 0 °C in 36 of 36 readings; was it '
                            'measured? Leave it empty (in messages NaN) where it was not'),
                           ({'temperature': np.where(np.arange(run.size) < 1, 0, run.temperature)}, '0 °C in 1 of 36'),
                           ({'repeatability': 2e-3}, 'the stated repeatability is 2000 µm; is it in mm or m? give µm'),
                           ({'repeatability': 1e-13}, 'repeatability is 0.000000100 µm; is it in mm or m? give µm')):
        assert any(words in one for one in said(run.replace(**changed))), words
    [remark] = said(run.replace(radius=0.2))
    assert 'lie on a circle of R = 182.5' in remark and 'not of 200 mm as stated' in remark


NUMBERS = {'target': 'target 7', 'frames': ('machine', 'table'), 'centre': (1.0, 2.0, 3.0), 'reason': 'no ball',
           'unit': 'hours', 'problem': 'log_0.mcap: cut short', 'likely': {'inch': 0.1825},
           'after': ((20, 3700.0),), 'repeatability': 1e-7}


@pytest.mark.parametrize('kind', RemarkKind)
def test_every_kind_of_remark_is_said(kind):
    """What is wrong, and where something can be done, what."""
    names = inspect.signature(reading_words._SAYS[kind]).parameters
    one = remark(kind, **{name: NUMBERS.get(name, 1) for name in names})
    assert remark_words(one).startswith(fact_words(one)) and fact_words(one)

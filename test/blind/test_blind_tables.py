# SPDX-License-Identifier: Apache-2.0
"""The command of the blind tests: its tables, what it writes, and how answers on noise are judged."""

import json

import pytest

from benchmarks.blind.answers import Answer, Claim
from benchmarks.blind.command import main
from benchmarks.blind.library_effects import hide, visible_part
from benchmarks.blind.library_table import is_named
from benchmarks.blind.noise_kinds import EVERY, chosen
from benchmarks.blind.noise_table import is_told, judged
from benchmarks.blind.power_table import median
from benchmarks.blind.proportion import interval
from benchmarks.blind.runs import SIGMA, Plan


def answer(*claims, unexplained=False):
    """Return an answer of claims, each a name or a name and the reading of an outlier."""
    made = [Claim(one, {}, ()) if isinstance(one, str) else Claim(one[0], {'reading': one[1]}, ()) for one in claims]
    return Answer(tuple(made), unexplained, '', '', '', 0.0, 0.0)


@pytest.mark.parametrize(('given', 'outliers', 'wanted'), [
    (answer(), (), 'nothing'),
    (answer(unexplained=True), (), 'unexplained'),
    (answer('frame_drift'), (), 'false'),
    (answer(('outlier', 5.0)), (), 'false outlier'),
    (answer(('outlier', 5.0), ('outlier', 9.0)), (5, 9), 'right'),
    (answer(('outlier', 5.0), ('outlier', 8.0)), (5, 9), 'false outlier'),
    (answer(('outlier', 5.0), 'ball_slip'), (5, 9), 'false'),
])
def test_names_on_noise_are_judged(given, outliers, wanted):
    """Any name is false, but an outlier that is one."""
    assert judged(given, outliers)[0] == wanted


@pytest.mark.parametrize(('kind', 'sentence', 'wanted'), [
    ('white', 'The model fits.', True),
    ('white', 'The model fits. The noise is not white and equal: z repeats 1.5 times worse than x and y.', False),
    ('z_2', 'The noise is not white and equal: z repeats 1.5 times worse than x and y.', True),
    ('z_2', 'The model fits.', False),
    ('ar_0.6_z', 'The noise is not white and equal: the readings are rounded to 0.500 µm.', False)])
def test_what_a_verdict_tells_of_the_noise_is_judged(kind, sentence, wanted):
    """Its kind, or nothing where it is white."""
    assert is_told(kind, sentence) == wanted


@pytest.mark.parametrize('kind', EVERY)
def test_every_kind_has_words(kind):
    """A verdict that tells all kinds at once tells each, but white noise."""
    everything = ('The noise is not white: z repeats, radial, Student, ball 3, table position, CMM position, '
                  'correlated, part of the run scatters, rounded, wanders')
    assert is_told(kind, everything) == (kind != 'white')


def test_the_interval_is_exact():
    """Clopper-Pearson: none of 100 gives 0 to 1 − 0.025^(1/100); all of 10 mirror that."""
    assert interval(0, 100) == pytest.approx((0, 1 - 0.025**0.01))
    assert interval(10, 10) == pytest.approx((0.025**0.1, 1))


def test_the_median_has_an_interval_for_any_distribution():
    """Of 20 numbers the 6th and the 15th bound the median at 95 % (binomial tables)."""
    assert median([float(one) for one in range(1, 21)]) == (10.5, 6.0, 15.0)


@pytest.mark.parametrize('sigma', [(1, 1, 1), (1, 1, 2)])
def test_library_effects_have_the_stated_weighted_norm(sigma):
    """Weighted by the noise of each axis the norm is 12."""
    hidden = hide(Plan(12, 'random', 1), ['frame_drift'], 12.0, sigma)
    assert ((visible_part(hidden.clean, hidden.shifts[0]) / sigma / SIGMA)**2).sum() == pytest.approx(144)


def test_an_effect_that_the_order_hides_is_not_observable():
    """Row order does not show a drift of the frame."""
    assert hide(Plan(12, 'row', 1), ['frame_drift'], 12.0).shifts is None


def test_a_set_of_names_is_right_with_look_alikes():
    """Every hidden effect once, in any order, itself or as a look-alike."""
    claims = (Claim('frame_step', {}, ('plate_slip',)), Claim('frame_drift', {}, ()))
    assert is_named(claims, ['frame_drift', 'plate_slip'])
    assert not is_named(claims, ['frame_drift']) and not is_named(claims[:1], ['frame_drift'])


def test_tables_are_printed_written_and_compared(tmp_path, capsys):
    """One run of each table; the second time it is compared with the first."""
    file = tmp_path / 'blind.json'
    few = ['--orders', 'random', '--seeds', '1', '--jobs', '1', '--strength', '16', '--balls', '8']
    asked = ['--noise', 'white', '--causes', 'drift_quadratic', '--library', 'frame_drift', '--coverage', 'z_2']
    assert main([*asked, *few, '--stated', 'yes', '--json', str(file)]) == 0
    text = capsys.readouterr().out
    assert '| white | stated | 1 | 0 (0 %) | 0.0–97.5 % |' in text
    assert '| drift_quadratic | 16 | 1 |' in text and '| random | frame_drift | 1 | 1 | 1 |' in text
    written = json.loads(file.read_text())
    assert written['noise']['white, stated'][0]['judged'] == 'nothing'
    assert len(written['coverage']['z_2'][0]['clean']) == 6
    assert main(['--noise', 'white', '--power', 'frame_drift', *few, '--compare', str(file)]) == 0
    text = capsys.readouterr().out
    assert 'right before 1, now 1 of 1 same runs; mended 0, broken 0' in text
    assert '| frame_drift | 1 | 1 (100 %) |' in text


@pytest.mark.parametrize(('option', 'kind', 'words'), [
    ('--noise', 'pink', 'wanted beyond, or some of white, z_1.5'),
    ('--causes', 'ghost', 'wanted beyond, or some of plate_on_three_feet'),
    ('--library', 'ghost', 'wanted some of frame_drift'), ('--power', 'ghost', 'wanted some of frame_drift'),
    ('--coverage', 'pink', 'wanted beyond, or some of white')])
def test_unknown_kinds_are_refused(option, kind, words, capsys):
    """The message lists the known ones."""
    with pytest.raises(SystemExit):
        main([option, kind])
    said = capsys.readouterr().err
    assert f'{option}: {words}' in said and f'got {kind}' in said


def test_beyond_stands_for_the_further_kinds():
    """Nothing asked for is the usual kinds, the word beyond all of the others, among names."""
    assert chosen(None, ['a', 'b'], ['c', 'd']) == ['a', 'b'] == chosen([], ['a', 'b'], ['c', 'd'])
    assert chosen(['b', 'beyond'], ['a', 'b'], ['c', 'd']) == ['b', 'c', 'd']

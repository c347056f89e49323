# SPDX-License-Identifier: Apache-2.0
"""rosette trend: a simulated year with a known change, as a user sees it."""

import datetime
import json
import re

import numpy as np
import pytest

from benchmarks.ageing import years
from rosette_ros.analysis import analyse
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_row import evaluation_row, heading
from rosette_ros.archive.table_history import history_of, trend_of
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.presentation.trend_results import events_table, residual_words

pytestmark = pytest.mark.long

IDENTITY = 'schema: rosette-identity/1\ntable: {serial: RT-7}\ntolerances: {crz: 20 µrad, ctz: 5 µm}\n'
START = datetime.datetime(2024, 1, 1, tzinfo=datetime.UTC)


def rows_of(settings, runs, **options):
    """Return the rows of years of a machine whose settings are a function of the day."""
    identity = parse_identity(IDENTITY.encode())
    return [{**heading(f'{day}', 'here', '', Model(), START, run.run_id),
             **evaluation_row(analyse(run), identity=identity), 'measured_at': START + datetime.timedelta(days=day)}
            for day, run in years(settings, runs, **options)]


def history_from(settings, runs):
    """Return the history of such years."""
    return history_of(rows_of(settings, runs), 'RT-7')


def plate(balls, **settings):
    """Return settings of a machine with a plate of so many balls."""
    return {'plate': {'balls': balls}, **settings}


def wave(error, per_turn, amplitude):
    """Return settings of a table with a further harmonic."""
    return {'added_errors': [{'error': error, 'per_turn': per_turn, 'amplitude': amplitude}]}


def hit(day):
    """Return settings with wear from the beginning on and a collision at day 300."""
    table = {'translation_um': 0.05 + 0.05 * min(1.0, day / 480)} | (wave('crz', 2, 3.0) if day >= 300 else {})
    return plate(5, probing={'repeatability_um': 0.1}, table=table)


def hit_rows(runs):
    """Return the rows of so many runs, one in 30 days, with seasons."""
    return rows_of(hit, runs, every_days=30.0, seasons=2.0)


@pytest.fixture(scope='module')
def archive(tmp_path_factory):
    """Return the folder of an archive of 16 runs."""
    made = RunArchive(tmp_path_factory.mktemp('years') / 'plant', make=True)
    made.add(hit_rows(16))
    return made.folder


def test_a_change_is_found_with_its_date_and_owner(archive, rosette, refused, tmp_path):
    """crz twice per turn by 3 µrad between the tenth and the eleventh run; wear and seasons are none."""
    found = json.loads(rosette('trend', archive, '--table', 'RT-7', '--json').out)
    assert found['schema'] == 'rosette-trend/1'
    assert len(found['runs']) == 16
    [event] = found['events']
    assert event['run_id'] == 'day_0300.0'
    assert event['owners'] == ['table']
    step = event['steps'][0]
    assert (step['quantity'], step['unit']) == ('crz, 2 per turn', 'rad')
    off = np.abs(np.array(step['size']) - [3e-6, 0.0])
    assert np.all(off < 1.5 * np.array(step['U'])), 'three standard uncertainties'
    assert set(found['forecasts']) == {'crz_rad', 'ctz_m'}
    page = tmp_path / 'trend.html'
    text = rosette('trend', archive, '--table', 'RT-7', '--figures', tmp_path, '-o', page).out
    assert 'crz, 2 per turn' in text
    assert 'When tolerances are reached' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'trend.html', 'trend_changes.png', 'trend_ranges.png']
    written = page.read_text(encoding='utf-8')
    assert all(words in written for words in ('Trend of rotary table RT-7', 'SIMULATED', 'id="table-events"',
                                              'id="table-forecast"', '<svg', 'What changed of the error motions',
                                              '2024-09-27 and 2024-10-27, with U (k = 2)'))
    assert 'exists already' in refused('trend', archive, '--table', 'RT-7', '-o', page)


def test_runs_are_found_by_their_paths():
    """Logs of several cells may have the same run_id."""
    rows = [{**row, 'run_id': 'same', 'path': f'/logs/{place}'} for place, row in enumerate(hit_rows(8))]
    assert history_of(rows[::-1], 'RT-7').paths == tuple(f'/logs/{place}' for place in range(8))


def test_a_curve_that_changed_lately_is_named(rosette, tmp_path):
    """Two runs after its change there is no forecast of crz, and there is one of ctz."""
    RunArchive(tmp_path / 'plant', make=True).add(hit_rows(12))
    found = json.loads(rosette('trend', tmp_path / 'plant', '--table', 'RT-7', '--json').out)
    assert (found['too_few_runs'], list(found['forecasts'])) == ({'crz_rad': 2}, ['ctz_m'])
    assert found['level'] == 'doubtful'
    assert found['sentence'].startswith('12 runs: table changed between 2024-09-27 and 2024-10-27: crz, 2 per turn by ')
    words = rosette('trend', tmp_path / 'plant', '--table', 'RT-7', '-o', tmp_path / 'trend.html').out
    said = 'crz: 2 runs since its last change, 3 at different times wanted for a forecast.'
    assert ' '.join(f'{found["sentence"]}.'.split()) in ' '.join(words.split())
    assert said in words and said in (tmp_path / 'trend.html').read_text(encoding='utf-8')


def test_noise_that_grows_is_told_as_noise():
    """From 0.1 µm to 0.8 µm in 16 runs: the residual, and no error."""
    history = history_from(lambda day: plate(5, probing={'repeatability_um': 0.1 + 0.7 * min(1.0, day / 105)}), 16)
    events = history.events()
    first, last = history.residual_course(events)
    assert events == () and first < 0.25e-6 and 0.5e-6 < last < 1.2e-6
    assert all(abs(one.slope) < 3 * one.slope_u for one in history.slopes(events).values())
    assert residual_words((first, last)).startswith('The residual grew from 0.')


def test_an_unknown_table_is_one_line(archive, refused):
    """With those that there are."""
    assert refused('trend', archive, '--table', 'RT-8') == (
        f"rosette: {archive}: expected dated runs of table 'RT-8', found none; it has tables 'RT-7'\n")
    assert refused('trend', archive) == (
        f"rosette: {archive}: expected --table, as every run states one, found none; it has tables 'RT-7'\n")
    assert refused('trend', archive, '--table', 'RT-7', '--model', 'zzz') == (
        f"rosette: {archive}: expected runs of table 'RT-7' under a model 'zzz', found none; it has models "
        f'{Model().hash[:12]}\n')


def test_runs_without_a_date_are_named(refused, tmp_path):
    """With what to state."""
    archive = RunArchive(tmp_path / 'plant', make=True)
    archive.add([{**row, 'measured_at': None} for row in rows_of(lambda day: plate(3), 2)])
    assert ("expected dated runs of table 'RT-7', found 2 runs without a date; state measured.begin in the identity"
            in refused('trend', archive.folder, '--table', 'RT-7'))


def test_runs_of_another_number_of_balls_are_named(rosette, tmp_path):
    """In text, page and JSON; they count for the harmonics that they have."""
    archive = RunArchive(tmp_path / 'plant', make=True)
    archive.add(rows_of(lambda day: plate(6 if day >= 14 else 5), 10))
    told = rosette('trend', archive.folder, '--table', 'RT-7', '-o', tmp_path / 'trend.html').out
    words = 'as they have another number of balls than the last run: day_0000.0, day_0007.0.'
    assert words in told and words in (tmp_path / 'trend.html').read_text(encoding='utf-8')
    found = json.loads(rosette('trend', archive.folder, '--table', 'RT-7', '--json').out)
    assert found['other_balls'] == ['day_0000.0', 'day_0007.0']


def test_few_runs_have_no_trend():
    """In words."""
    with pytest.raises(InvalidData, match="trend of table 'a': expected at least 8 dated runs, found 3"):
        history_of(rows_of(lambda day: plate(3), 3), 'a')


def test_the_last_tolerances_count_whatever_else_is_stated():
    """The newest run states none, but speaks of them in a remark."""
    rows = rows_of(lambda day: plate(3), 8)
    rows[-1]['identity'] = 'schema: rosette-identity/1\ncertificate: {remarks: tolerances as agreed}\n'
    assert history_of(rows, 'a').tolerances == pytest.approx({'crz': 2e-5, 'ctz': 5e-6})
    rows[-1]['identity'] = 'schema: rosette-identity/1\ntolerances: {crz: 0.01 arcsec}\n'
    assert trend_of(history_of(rows, 'a')).warnings[0].endswith(' to its tolerance of 0.01 arcsec')


def test_runs_between_the_steps_are_left_out():
    """They have other CMM positions; the rest is judged."""
    rows = rows_of(lambda day: plate(3), 9)
    rows[4]['angle_rad'] = [angle + np.deg2rad(15) for angle in rows[4]['angle_rad']]
    history = history_of(rows, 'a')
    assert history.left_out == (rows[4]['run_id'],)
    assert len(history.runs) == 8
    with pytest.raises(InvalidData, match='at least 8 dated runs, found 7, and 1 run between the steps of the table'):
        history_of(rows[1:], 'a')


@pytest.mark.parametrize('balls', [3, 8])
def test_another_plate_is_a_change_of_the_plate(balls):
    """Its balls and how it lies, and not the table; one change."""
    [event] = history_from(lambda day: {'plate': {'balls': balls, 'number': 2 if day >= 56 else 1}}, 14).events()
    assert (event.run, event.owners[0], event.steps[0].series.owner) == (8, 'plate', 'plate')
    assert set(event.owners) <= {'plate', 'clamping', 'size'}


def test_a_scale_of_the_cmm_is_no_other_plate():
    """A plate that grows evenly and a scale of the CMM are the same to rosettes: 100 ppm are told as size alone."""
    [event] = history_from(lambda day: plate(6, cmm={'scale_ppm': 100.0} if day >= 56 else {}), 14).events()
    assert (event.run, event.owners, [step.series.name for step in event.steps]) == (
        8, ('size',), ['size of the plate, or scale of the CMM'])
    table = events_table([event], [START] * 14, ['run'] * 14, [{}])
    assert re.search(r'size of the plate, or scale of the CMM \+0\.\d+ ± 0\.0\d+ µm', table.csv())


def test_a_wave_has_its_size_in_micrometres_with_u():
    """A wave of 3 per turn with an amplitude of 0.8 µm, which is there from a day on."""
    [event] = history_from(lambda day: plate(8, table=wave('ctz', 3, 0.8) if day >= 56 else {}), 14).events()
    assert re.search(r'ctz, 3 per turn 0\.[78]\d* ± 0\.\d+ µm', events_table(
        [event], [START] * 14, ['run'] * 14, [{}]).csv())


def test_a_table_whose_zero_moves_is_a_change_of_the_table():
    """The plate lies turned since then, and is the same one."""
    [event] = history_from(lambda day: plate(8, table=wave('crz', 3, 8.0) if day >= 140 else {}), 40).events()
    assert (event.run, event.owners[0]) == (20, 'table')
    assert set(event.owners) <= {'table', 'clamping'}


def test_a_plate_that_was_clamped_anew_is_no_other_plate():
    """All balls have turned by 20 µrad together: told as an angle."""
    rows = rows_of(lambda day: plate(5), 14)
    angle = np.array(rows[0]['angle_rad'])
    for row in rows[8:]:
        for name, direction in (('plate_x_m', -np.sin(angle)), ('plate_y_m', np.cos(angle))):
            row[name] = (np.array(row[name]) + 20e-6 * row['radius_m'] * direction).tolist()
    [event] = history_of(rows, 'RT-7').events()
    assert (event.run, event.owners, [step.series.name for step in event.steps]) == (
        8, ('clamping',), ['balls in the frame, rotation'])
    (step,) = event.steps
    assert step.size == pytest.approx([20e-6], abs=4 * step.u[0]) and step.u[0] < 1e-6
    assert re.search(r'balls in the frame, rotation \+(19|2[01])\.\d ± \d+\.\d+ µrad',
                     events_table([event], [START] * 14, ['run'] * 14, [{}]).csv())

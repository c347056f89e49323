# SPDX-License-Identifier: Apache-2.0
"""The tab of an archive in a real browser: filter, curves over each other, differences, trend, a click opens a run."""

import re

import numpy as np
import pytest
from plain_loop import PlainLoop
from playwright.sync_api import expect

from rosette_ros.archive.run_adding import add_logs, find_logs
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_question import Question
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.identity_file import Identity
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.archive_view import causes_of, less_earliest, list_runs

pytestmark = pytest.mark.long

BALLS, RUNS = 4, 9
DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [4.0, 0.0, 2.0]}


@pytest.fixture
def archive(tmp_path):
    """Return the folder of an archive of nine dated runs of one table."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    machine = Machine(MachineConfig().changed(plate={'balls': BALLS}))
    for number in range(RUNS):
        path = tmp_path / f'run{number}.csv'
        write_csv(machine.run(plan(BALLS, 'diagonal'), run_id=f'run{number}'), path)
        stated = Identity({'table.serial': 'RT-7', 'measured.begin': f'2026-0{number + 1}-01'})
        add_logs(archive, find_logs([str(path)]), PlainLoop(), identity=stated)
    return archive.folder


def test_an_archive_in_the_studio(page, archive, tmp_path, start_studio):
    """As a person goes through it."""
    with start_studio(tmp_path, '--archive', archive) as studio:
        page.goto(studio.address)
        expect(page.get_by_test_id('archive-words')).to_contain_text(f'{RUNS} of {RUNS} runs')
        expect(page.get_by_test_id('archive-plant-table')).to_contain_text('not stated')
        page.get_by_test_id('archive-trend').click()
        expect(page.get_by_test_id('archive-sentence')).to_contain_text('9 runs: no step in the last 8 runs')
        for words in ('No step beyond the scatter of the runs', 'No tolerances are stated'):
            expect(page.get_by_text(words)).to_be_visible()  # as `rosette trend` says it
        expect(page.get_by_test_id('archive-figure').locator('.errorbar').first).to_be_attached()
        page.get_by_test_id('archive-figure').locator('.points .point').nth(4).click(force=True)
        expect(page.get_by_test_id('run')).to_have_value('run4.csv')
        page.get_by_test_id('tab-archive').click()

        page.get_by_test_id('archive-since').fill('2026-03-01')
        expect(page.get_by_test_id('archive-words')).to_contain_text(f'7 of {RUNS} runs')
        page.get_by_test_id('archive-overlay').click()
        expect(page.get_by_test_id('archive-error')).to_contain_text('expected 1 to 12 runs to be chosen')
        boxes = page.get_by_test_id('archive-runs').locator('tbody .q-checkbox')
        boxes.nth(0).click()
        boxes.nth(1).click()
        page.get_by_test_id('archive-overlay').click()
        expect(page.get_by_test_id('archive-title')).to_have_text('Six error motions, with U (k = 2)')
        expect(page.get_by_test_id('archive-figure')).to_contain_text('run7')
        page.get_by_test_id('archive-differences').click()
        expect(page.get_by_test_id('archive-figure')).to_contain_text('run8 2026-09-01 less run7 2026-08-01')

        page.get_by_test_id('archive-folder').fill(str(tmp_path))
        page.get_by_test_id('archive-open').click()
        expect(page.get_by_test_id('archive-error')).to_contain_text('expected an archive, found a folder')
        page.get_by_test_id('archive-folder').fill(str(archive))
        page.get_by_test_id('archive-open').click()
        page.get_by_test_id('archive-runs').get_by_text('run8').click()
        expect(page.get_by_test_id('verdict')).to_be_visible()
        page.close()


def test_causes_stand_against_runs(page, tmp_path, start_studio):
    """The list has ranges and conformity; what is due stands below; a drift that two of three runs have is a line of
    dots, a click on one opens its run."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    for number, hidden in enumerate(([DRIFT], [], [DRIFT])):
        path = tmp_path / f'run{number}.csv'
        machine = Machine(MachineConfig().changed(seed=number + 1, plate={'balls': 6}, hidden=hidden))
        write_csv(machine.run(plan(6, 'random', number), run_id=f'run{number}'), path)
        stated = Identity({'table.serial': 'RT-7', 'measured.begin': f'2026-0{number + 1}-01'}, {'EXC': '5 µm'})
        add_logs(archive, find_logs([str(path)]), PlainLoop(), identity=stated)
    found = list_runs(str(archive.folder), Question({}))
    assert [one['tolerances'] for one in found.lines] == ['not decidable', 'conforms', 'not decidable']
    assert all(0 < one['ctx'] < 5 for one in found.lines)
    causes, places = causes_of(str(archive.folder), [one['key'] for one in found.lines], found.model)
    assert [run for _, run in places] == ['run0', 'run1', 'run2']
    likely = {(causes.causes[one.cause], one.run) for one in causes.dots if one.probability > 0.5}
    assert {run for _, run in likely} == {0, 2} and 'linear probe drift' in {cause for cause, _ in likely}
    with start_studio(tmp_path, '--archive', archive.folder) as studio:
        page.goto(studio.address)
        expect(page.get_by_test_id('archive-plant-table')).to_contain_text('RT-7')  # what is due, unasked
        expect(page.get_by_test_id('archive-runs').locator('.state.good', has_text='conforms')).to_have_count(1)
        page.get_by_test_id('archive-causes').click()
        figure = page.get_by_test_id('archive-figure')
        expect(figure).to_contain_text('linear probe drift')
        figure.locator('.points .point').first.click(force=True)
        expect(page.get_by_test_id('run')).to_have_value(re.compile('run[02].csv'))
        page.close()


def test_differences_want_the_same_table_angles():
    """Each run less the first, u of both; a run between the steps of the other is refused."""
    one, other = (ErrorMotions(nominal_angles(4), np.full((4, 6), value), np.full((4, 6), u))
                  for value, u in ((1e-6, 3e-7), (3e-6, 4e-7)))
    [(name, less)] = less_earliest([('a', one), ('b', other)])
    assert name == 'b less a'
    np.testing.assert_allclose(less.values, 2e-6, rtol=1e-12)
    np.testing.assert_allclose(less.u, 5e-7, rtol=1e-12)
    turned = ErrorMotions(other.angle + np.deg2rad(15), other.values, other.u)
    with pytest.raises(InvalidData, match=(
            '^expected runs at the same table angles, found b with 4 from 15° and a with 4 from 0°$')):
        less_earliest([('a', one), ('b', turned)])

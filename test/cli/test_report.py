# SPDX-License-Identifier: Apache-2.0
"""rosette report: files that it writes, what it refuses, and that a table says what evaluate says."""

import csv
import json

import numpy as np
import pytest
from simulated import simulated_table

from rosette_ros.analysis import curves_over
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.run.scheme import plan
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.simulation import Machine, MachineConfig

pytestmark = pytest.mark.long

N = 8


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of one's own to write in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_page_figures_and_tables_of_a_run(rosette, here):
    """One command; the verdict on the screen, the same on the page; curves as of evaluate --json."""
    path = simulated_table('drift', N)
    model = here / 'model.yaml'
    model.write_text('schema: rosette-model/1\nbase: [table_motions, plate_deviations, cmm_deviations]\n'
                     'effects: [frame_drift]\n')
    answer = rosette('report', path, '--model', model, '-o', 'page.html', '--overlay', simulated_table('clean', N),
                     '--figures', 'figures', '--format', 'png', '--tables', 'tables')
    assert (answer.code, answer.err) == (0, '')
    assert 'The model fits: ' in answer.out and 'page.html' in answer.out
    page = (here / 'page.html').read_text(encoding='utf-8')
    assert 'The model fits: ' in page
    assert 'Drawn over it: clean_1' in page
    assert f'rosette report {path} --model {model} -o page.html --overlay' in page
    figures = sorted(file.name for file in (here / 'figures').iterdir())
    assert {'curves.png', 'differences.png', 'residual_maps.png'} <= {*figures}
    assert (here / 'figures' / 'curves.png').read_bytes().startswith(b'\x89PNG')
    wanted = json.loads(rosette('evaluate', path, '--model', model, '--json').out)
    with open(here / 'tables' / 'curves.csv', encoding='utf-8', newline='') as stream:
        found = list(csv.DictReader(stream))
    for key, unit in (('ctx_m', 'ctx_um'), ('ctz_m', 'ctz_um'), ('crz_rad', 'crz_urad')):
        assert [float(row[unit]) for row in found] == pytest.approx([1e6 * value for value in wanted[key]], rel=1e-14)
        assert [float(row[f'u_{unit}']) for row in found] == pytest.approx(
            [1e6 * value for value in wanted['u'][key]], rel=1e-14)


def test_the_page_is_named_after_the_run_and_never_overwritten(rosette, refused, here):
    """In this folder; the refusal comes before the work and leaves the file as it is."""
    path = simulated_table('clean', N)
    page = here / f'{path.stem}.html'
    page.write_text('precious')
    assert refused('report', path) == (f'rosette: {page.name}: exists already; take another name or use --force\n')
    assert page.read_text() == 'precious'
    assert rosette('report', path, '--force').code == 0
    assert page.read_text(encoding='utf-8').startswith('<!DOCTYPE html>')


@pytest.mark.parametrize(('verb', 'ending'), [('report', 'html'), ('certificate', 'xml')])
def test_a_folder_keeps_what_stands_behind_a_dot(refused, here, verb, ending):
    """Logs run.1 and run.2 go to files of their own; of a file its suffix is cut."""
    (here / 'run.1').mkdir()
    (here / 'run.2.csv').write_bytes(simulated_table('clean', 6).read_bytes())
    for path, name in (('run.1', f'run.1.{ending}'), ('run.2.csv', f'run.2.{ending}')):
        (here / name).write_text('precious')
        assert refused(verb, path) == f'rosette: {name}: exists already; take another name or use --force\n'


def test_several_runs_as_one(rosette, here):
    """A page, its figures and its tables; what the runs share is declared in a file, which the page names."""
    paths = simulated_table(n=N, order='there_and_back'), simulated_table(n=N, order='diagonal')
    (here / 'share.yaml').write_text('schema: rosette-sharing/1\nframe: separate\n')
    answer = rosette('report', *paths, '--share', 'share.yaml', '--figures', 'figures', '--tables', 'tables')
    assert (answer.code, answer.err) == (0, '')
    assert 'The 2 runs fit one model' in answer.out and 'joint.html' in answer.out
    page = (here / 'joint.html').read_text(encoding='utf-8')
    assert all(words in page for words in ('share.yaml', paths[0].name, 'Reversal of the table', 'Causes against runs',
                                           'Nothing that these 2 runs can show comes again.'))
    assert {file.name for file in (here / 'figures').iterdir()} == {'curves.svg', 'reversal.svg'}
    assert 'table_clockwise.csv' in {file.name for file in (here / 'tables').iterdir()}


@pytest.mark.parametrize(('names', 'files'), [
    ('[A/1, A_1]', ['table_A_1.csv', 'table_A_1_2.csv']), ('[../../evil, B]', ['table_.._.._evil.csv', 'table_B.csv']),
    (f'[{"ä" * 300}, B]', [f'table_{"ä" * 44}.csv', 'table_B.csv'])])
def test_tables_are_files_of_their_folder(rosette, here, names, files):
    """Whatever the sharing file calls what they are of; none takes the place of another one."""
    (here / 'share.yaml').write_text(f'schema: rosette-sharing/1\ntable: {names}\n')
    answer = rosette('report', simulated_table('clean', 6, 'diagonal'), simulated_table('clean', 6, 'row'), '--share',
                     'share.yaml', '--tables', 'tables')
    assert (answer.code, answer.err) == (0, '')
    assert sorted(file.name for file in here.iterdir()) == ['joint.html', 'share.yaml', 'tables']
    assert {file.name for file in (here / 'tables').glob('table*')} == {*files}


@pytest.mark.parametrize(('words', 'said'), [
    (('RUN', 'RUN'), 'expected one RUN, found 2; --joint evaluates several as one'),
    (('RUN', '--joint', '--overlay', 'RUN'), 'report: --overlay does not go with --joint; leave it out'),
    ((), 'expected either RUN or --compare RUN RUN RUN RUN'),
    (('RUN', '--compare', 'RUN', 'RUN', 'RUN', 'RUN'), 'expected either RUN or --compare'),
    (('--compare', 'RUN', 'RUN'), r'expected four runs or six, found 2: (i) all corrected, (ii) plate turned'),
    (('--compare', 'RUN', 'RUN', 'RUN', 'RUN', '--overlay', 'RUN'), '--overlay does not go with --compare'),
    (('--compare', 'RUN', 'RUN', 'RUN', 'RUN', '--run-id', 'x'), '--run-id does not go with --compare'),
    (('--compare', 'RUN', 'RUN', 'RUN', 'RUN', '--joint'), '--joint does not go with --compare; leave it out'),
    (('--compare', 'RUN', 'RUN', 'RUN', 'RUN', '--share', 'RUN'), '--share does not go with --compare; leave it out'),
    (('RUN', '--maker', 'RUN'), '--maker goes with --compare only'),
    (('RUN', '--run-id', 'other'), "expected run 'other', found 'clean_1'"),
    (('RUN', '--format', 'gif'), 'Unknown value'),
    (('RUN', '--format', 'png'), '--format goes with --figures only; leave it out'),
    (('nowhere.csv',), 'nowhere.csv: expected a log directory, an .mcap file or a CSV table'),
    (('RUN', '-o', 'nowhere/page.html'),
     'nowhere/page.html: expected a name in a folder that exists, found none; make nowhere first'),
])
def test_what_cannot_be_reported(refused, here, words, said):
    """One line; no file is left behind."""
    path = simulated_table('clean', 6)
    assert said in refused('report', *(path if word == 'RUN' else word for word in words))
    assert list(here.iterdir()) == []


def test_a_run_between_the_steps_is_laid_over_along_the_same_axes(rosette, here):
    """Its own x and y are turned by half a step; at other angles there are no differences, and the page says so."""
    config = MachineConfig().changed(seed=1, plate={'balls': N}, table={'translation_um': 2.0, 'harmonics': 2})
    machine, paths = Machine(config), [here / 'zero.csv', here / 'half.csv']
    runs = [machine.run(plan(N, 'diagonal').shifted(degrees), run_id=path.stem)
            for degrees, path in zip((0.0, 22.5), paths, strict=True)]
    for one, path in zip(runs, paths, strict=True):
        write_csv(one, path)
    assert rosette('report', *paths[:1], '-o', 'page.html', '--annex', '--overlay', paths[1]).code == 0
    page = (here / 'page.html').read_text(encoding='utf-8')
    assert 'half: measured at other table angles; no differences.' in page
    zero, half = (curves_over(runs[0], one) for one in runs)
    between = Correction(zero, zero).errors(half.angle)
    for curve in ('ctx', 'cty'):
        place = CURVES.index(curve)
        less = half.values[:, place] - between[:, place]
        assert np.ptp(less) < 0.3 * np.ptp(half.values[:, place]), curve


def test_a_table_about_another_axis_is_not_laid_over(refused, here):
    """Its curves have the same names, and are others."""
    upright, lying = simulated_table('clean', 6), here / 'lying.csv'
    config = MachineConfig().changed(plate={'balls': 6}, placement={'axis': (1.0, 0.0, 0.0)})
    write_csv(Machine(config).run(plan(6, 'diagonal'), run_id='lying'), lying)
    said = refused('report', upright, '-o', 'page.html', '--overlay', lying)
    assert 'expected runs of a table about one axis, found (' in said and ' in lying; evaluate them apart' in said
    assert not (here / 'page.html').exists()


def test_runs_beside_one_another(rosette, here):
    """Four runs of one machine: the numbers of the paper are on the page; tables, too."""
    runs = [simulated_table('clean', N, 'diagonal', seed) for seed in (1, 1, 1, 1)]
    answer = rosette('report', '--compare', *runs, '--tables', 'tables', '--figures', 'figures')
    assert (answer.code, answer.err) == (0, '')
    page = (here / 'verification.html').read_text(encoding='utf-8').replace('\u00a0', ' ')
    assert 'the paper: 0.02 µm and 0.2 µrad' in page
    assert sorted(file.name for file in (here / 'tables').iterdir()) == [
        'reproducibility.csv', 'run_spans.csv', 'runs.csv', 'verification_curves.csv']
    assert (here / 'figures' / 'differences.svg').read_text(encoding='utf-8').startswith('<?xml')

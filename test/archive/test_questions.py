# SPDX-License-Identifier: Apache-2.0
"""Questions to an archive, by words and by SQL; all runs under two models; what the verb prints."""

import datetime
import json
import os
import re
from collections import Counter

import numpy as np
import pytest

from rosette_ros.archive.archive_questions import ask, ask_for
from rosette_ros.archive.reanalysis import (
    conclusion,
    logs_of,
    not_evaluated,
    side_by_side,
    trend_conclusion,
    trends_side_by_side,
)
from rosette_ros.archive.run_archive import RunArchive
from rosette_ros.archive.run_question import Question
from rosette_ros.archive.run_row import SCHEMA, heading
from rosette_ros.cli.main import main
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.geometry import nominal_angles
from rosette_ros.core.run.records import CURVES
from rosette_ros.invocation import command
from rosette_ros.presentation.json_output import CURVE_KEYS

BASE, CREEP = Model(), Model().with_effect('plate_creep')
START = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
N, MICROMETRE, U = 4, 1e-6, 0.1e-6


def made_row(number, model=BASE, rms=MICROMETRE, move=0.0, creep=None):
    """Return the row of a run of table T0 or T1, a week after the last one; creep: of the effect, in units of U."""
    parameters = [{'name': 'd_x', 'value': (creep or 0) * U, 'U': U, 'unit': 'm/s'}]
    effects = [] if creep is None else [{'effect': 'plate_creep', 'in_model': model is CREEP, 'rms_m': rms,
                                         'setting': '{}', 'parameters': parameters}]
    head = heading(f'{number:064}', f'/logs/{number}', 's', model, START, f'r{number}')
    return {**dict.fromkeys(SCHEMA.names), **head,
            'measured_at': START + datetime.timedelta(weeks=number), 'table_serial': f'T{number % 2}', 'cell': 'c',
            'n': N, 'rms_m': rms, 'outcome': 'fits', 'missing': [], 'effects': effects,
            **{f'U_{key}': [U] * N for key in CURVE_KEYS}, **{key: [0.0, move, 0.0, 0.0] for key in CURVE_KEYS}}


@pytest.fixture
def archive(tmp_path):
    """Return an archive of six runs, of which the diagnosis named an effect in the last, and one problem."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    archive.add([*(made_row(number) for number in range(5)), {**made_row(5, creep=9), 'missing': ['plate_creep']},
                 heading('f' * 64, '/logs/bad', 's', BASE, START, problem='is empty')])
    return archive


@pytest.mark.parametrize(('question', 'runs'), [
    (Question({}), ['r0', 'r2', 'r4', 'r1', 'r3', 'r5']),
    (Question({'table': 'T1'}), ['r1', 'r3', 'r5']),
    (Question({'table': 'T1'}, since='2026-01-08', until='2026-01-22'), ['r1']),
    (Question({'cell': 'other'}), []),
    (Question({}, effect='plate_creep'), ['r5'])])
def test_ready_questions(archive, question, runs):
    """By table, time and effect, sorted by table and time."""
    assert ask_for(archive, question).column('run').to_pylist() == runs


def test_an_effect_is_shown_with_its_parameters(archive):
    """Value and U."""
    assert ask_for(archive, Question({}, effect='plate_creep')).column('parameters').to_pylist() == [
        ['d_x = 9e-07, U = 1e-07 m/s']]


def test_the_model_of_each_row_is_named(archive):
    """By its effects and the beginning of its hash, by which it can be asked for."""
    archive.add([made_row(number, CREEP, creep=9) for number in range(2)])
    names = {f'base ({BASE.hash[:12]})': 6, f'plate_creep ({CREEP.hash[:12]})': 2}
    assert Counter(ask_for(archive, Question({})).column('model').to_pylist()) == names
    for model in (BASE, CREEP):
        found = ask_for(archive, Question({}, model=model.hash[:12])).column('model').to_pylist()
        assert {name: len(found) for name in found} == {
            name: number for name, number in names.items() if model.hash[:12] in name}


def test_views_unfold_what_a_row_holds(archive):
    """A row for each parameter, each angle, each ball."""
    assert ask(archive, 'SELECT run_id, parameter, value / U AS size FROM effects').to_pylist() == [
        {'run_id': 'r5', 'parameter': 'd_x', 'size': pytest.approx(9)}]
    assert ask(archive, 'SELECT count(*), max(position), max(U_ctz_m) FROM curves').to_pydict() == {
        'count_star()': [6 * N], 'max("position")': [N], 'max(U_ctz_m)': [U]}


@pytest.mark.parametrize('question', [Question({}, since='yesterday'), Question({}, until='2026-13-01')])
def test_what_is_no_time_is_refused(archive, question):
    """In one line."""
    with pytest.raises(InvalidData, match='expected a day or a time such as 2026-04-12, found'):
        ask_for(archive, question)


@pytest.mark.parametrize(('question', 'words'), [
    (Question({'level': 'god'}), "Unknown level 'god'. Did you mean good?"),
    (Question({}, effect='plate_crep'), "Unknown effect 'plate_crep'. Did you mean plate_creep?")])
def test_a_misspelt_word_is_refused(archive, question, words):
    """It is no question that nothing answers."""
    with pytest.raises(RosetteError, match=re.escape(words)):
        ask_for(archive, question)


def test_two_models_side_by_side(archive):
    """The residual falls, and the curve moves, in the run that had the effect all along, and in no other."""
    archive.add([made_row(number, CREEP, rms=MICROMETRE / (1 + 9 * (number == 3)), move=3 * U * (number == 3),
                          creep=5 if number == 3 else 1) for number in range(6)])
    changes = side_by_side(archive, BASE, CREEP)
    assert [one.run_id for one in changes] == ['r0', 'r2', 'r4', 'r1', 'r3', 'r5']
    assert [(one.run_id, one.had) for one in changes if one.had] == [('r3', ('plate_creep',))]
    found = changes[4]
    assert (found.before, found.after) == (MICROMETRE, MICROMETRE / 10)
    assert np.allclose(found.change, 3 * U, rtol=1e-12) and np.allclose(found.of_u, 3, rtol=1e-12)
    assert conclusion(changes, CREEP.terms, archive) == (
        'The residual falls by more than 10 % in 1 of 6 runs, most in r3.',
        'The curves move by more than U (k = 2), the larger one of both models, in 1 of 6 runs.',
        'plate_creep is there for certain (a parameter of 4 standard uncertainties) in 1 of 6 runs, measured on '
        '2026-01-22.')
    searched = Model().with_effect('frame_pulse')
    assert conclusion(changes, searched.terms, archive, 2)[2:] == (
        'frame_pulse has a parameter of 4 standard uncertainties in 0 of 6 runs; whether it is there is told by '
        'rosette diagnose, which counts that its place was searched.',
        f'2 runs could not be evaluated under both models: {command("archive", "query", archive.folder, "--problems")}')
    assert conclusion([], [], archive) == ('No run was evaluated under both models.',)
    assert not_evaluated(archive, BASE, CREEP) == 1
    assert logs_of(archive) == ([], [f'/logs/{number}' for number in (0, 2, 4, 1, 3, 5)] + ['/logs/bad'])


def test_trends_side_by_side(tmp_path):
    """A step of crz by 6 standard uncertainties that the model after explains is a change under the first alone."""
    archive = RunArchive(tmp_path / 'archive', make=True)
    angle, noise = nominal_angles(N).tolist(), np.random.default_rng(1)

    def row(number, model):
        wave = np.array([1.0, 0.0, -1.0, 0.0])
        step = 12 * U * (number >= 10 and model is BASE)
        curves = {key: (0.05 * U * noise.standard_normal(N) + step * wave * (key == 'crz_rad')).tolist()
                  for key in CURVE_KEYS}
        zero = {f'{prefix}{what}_{axis}_m': [U if prefix else 0.0] * N for prefix in ('', 'U_')
                for what in ('plate', 'cmm') for axis in 'xyz'}
        ranges = {f'range_{key}': float(np.ptp(curves[key])) for key in CURVE_KEYS}
        return {**made_row(number, model), **curves, **zero, **ranges, 'table_serial': 'T', 'angle_rad': angle,
                'dof': 9, 'identity': '', **{f'{one}_serial': '' for one in ('plate', 'cmm', 'probe')},
                **{f'U_range_{key}': U for key in CURVE_KEYS}}
    archive.add([row(number, model) for number in range(20) for model in (BASE, CREEP)])
    [found] = trends_side_by_side(archive, BASE, CREEP)
    [(before, after)] = found.events
    assert (before.run, before.owners, after) == (10, ('table',), None)
    assert set(found.slopes) == set(CURVES)
    assert max(map(found.altered, CURVES)) < 3
    assert trend_conclusion([found])[0] == (
        'Of the trends of 1 table: 0 changes under both models, 1 under the first alone, 0 under the second alone.')
    assert trend_conclusion([]) == ('No table has 8 dated runs under both models: trends are not compared.',)


def test_the_verb_answers_in_three_forms(archive, capsys):
    """Table, CSV and JSON; SQL and words; errors in one line."""
    words = ['archive', 'query', str(archive.folder)]
    assert main([*words, '--table', 'T1', '--since', '2026-01-20']) == 0
    out = capsys.readouterr().out
    assert 'r3' in out and 'r5' in out and 'r1' not in out
    assert main([*words, 'SELECT run_id, measured_at FROM runs WHERE n = 4 ORDER BY ALL LIMIT 1', '--csv']) == 0
    assert capsys.readouterr().out == 'run_id,measured_at\nr0,2026-01-01 00:00:00\n'
    assert main([*words, 'SELECT ctx_m FROM runs LIMIT 1', '--json']) == 0
    assert json.loads(capsys.readouterr().out) == {
        'schema': 'rosette-archive-query/1', 'columns': ['ctx_m'], 'rows': [{'ctx_m': [0.0] * N}]}
    assert main([*words, '--problems', '--csv']) == 0
    assert capsys.readouterr().out == 'path,problem\n/logs/bad,is empty\n'
    for wrong, said in ((['SELECT'], 'Parser Error'), (['SELECT 1', '--table', 'T1'], 'expected SQL or a ready '
                                                                                      'question'),
                        ([' '], 'expected a question (SELECT ...)')):
        assert main([*words, *wrong]) == 2
        err = capsys.readouterr().err
        assert said in err and err.count('\n') == 1


@pytest.mark.parametrize('sql', [
    "SELECT * FROM read_csv('{}')", "SELECT * FROM read_text('{}')", "SELECT * FROM glob('{}')",
    "SELECT * FROM runs JOIN read_csv('{}') ON true", "SELECT * FROM read_text('{archive}/parts/../../{}')",
    "SELECT * FROM sniff_csv('{}')"])
def test_a_question_reads_the_archive_alone(archive, tmp_path, capsys, sql):
    """Who may ask an archive, by a page or a script, does not get the files of the user who runs it."""
    other = tmp_path / 'other.csv'
    other.write_text('secret,b\n1,2\n')
    name = os.path.relpath(other, archive.folder.parent) if '{archive}' in sql else other
    assert main(['archive', 'query', str(archive.folder), sql.format(name, archive=archive.folder)]) == 2
    assert capsys.readouterr().err == (
        f'rosette: {archive.folder}: expected a question about the archive alone, found one that reads other files; '
        'join them with the answer (--csv, --json) in the program that has them\n')


def test_a_question_takes_no_table_of_the_program_and_no_setting(archive, monkeypatch):
    """DuckDB would find variables of Python by their names, and give back what was taken."""
    with pytest.raises(InvalidData, match='Table with name paths does not exist'):
        ask(archive, 'SELECT * FROM paths')
    with pytest.raises(InvalidData, match='expected a question'):
        ask(archive, 'SET enable_external_access = true')
    assert ask(archive, 'SELECT count(*) AS n FROM runs')['n'].to_pylist() != [0]

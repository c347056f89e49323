# SPDX-License-Identifier: Apache-2.0
"""One run, one verdict: every interface states the same outcome in the same sentence."""

import asyncio
import functools
import json
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html import unescape
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nicegui import Client
from nicegui.page import page as page_of

from rosette_ros.analysis import Verdict, analyse, diagnose, judge, summarise
from rosette_ros.cli.main import main
from rosette_ros.core.diagnosis.verdict import Level, Outcome
from rosette_ros.core.run.errors import NotDeterminable
from rosette_ros.core.run.records import SI_UNITS
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.open_run import open_run
from rosette_ros.nodes.conversions import diagnosis_message
from rosette_ros.presentation.error_results import errors_of
from rosette_ros.presentation.report.run_page import report_html
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels.figures_panel import FiguresPanel
from rosette_ros.studio.panels.widgets import Figure
from rosette_ros.words.verdict_words import HEADLINES, NOTHING_TO_DO, verdict_text

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}
BALLS, SEED = 6, 1
MISSING = Outcome.NAMED, Outcome.SUSPECTED, Outcome.UNNAMED
"""Outcomes in which something is missing."""
MARKS = {Level.GOOD: '✓', Level.DOUBTFUL: '?', Level.BAD: '✗'}


def clean(*hidden, n=BALLS):
    """Return a run of the simulated machine, and the repeatability as known as sigma itself."""
    config = MachineConfig().changed(seed=SEED, plate={'balls': n}, hidden=list(hidden))
    run = Machine(config).run(plan(n, 'random', SEED), run_id='run')
    return run.replace(repeatability=1e-7, repeatability_dof=None)


def rounded():
    """Return a clean run with coordinates in whole micrometres."""
    run = clean()
    return run.replace(centre=np.round(run.centre, 6))


def drawn_anew():
    """Return white noise of 0.1 µm around the fitted model of a run, and a stated repeatability of half of it."""
    run = clean()
    noise = np.random.default_rng(SEED).normal(0, 1e-7, run.centre.shape)
    return run.replace(centre=run.centre - analyse(run).residual + noise, repeatability=5e-8)


KINDS = {
    'clean': (clean, {Outcome.FITS}),
    'hidden effect': (lambda: clean(DRIFT), {Outcome.NAMED}),
    'repeatability of half the noise': (drawn_anew, {Outcome.SCATTERS}),
    'rounded': (rounded, {Outcome.DOUBTFUL_READINGS}),
    'incomplete': (lambda: clean().take(slice(0, BALLS**2 - BALLS)), {Outcome.FITS}),
    'no repeatability': (lambda: clean().replace(repeatability=None), {Outcome.NO_REPEATABILITY}),
    'hidden effect, no repeatability': (lambda: clean(DRIFT).replace(repeatability=None), {Outcome.NAMED}),
}
_FOLDER = tempfile.TemporaryDirectory(prefix='rosette_kinds_')


@functools.cache
def table_of(kind):
    """Return the path of the table of a run of a kind."""
    path = Path(_FOLDER.name) / f'{kind}.csv'
    write_csv(KINDS[kind][0](), path)
    return path


def verbs(path, capsys):
    """Yield (verb, JSON) and (verb, text on one line) of those that judge."""
    for verb in ('evaluate', 'compare', 'diagnose'):
        for option in (['--json'], []):
            assert main([verb, str(path), *option]) == 0
            out = capsys.readouterr().out
            yield verb, json.loads(out) if option else ' '.join(out.split())


def studio(run):
    """Return the verdict that the studio shows of a run."""
    with ThreadPoolExecutor(1) as threads:
        controller = Controller()
        controller.act(controller.session.open, run, 'run.csv')
        threads.submit(asyncio.run, controller.refresh()).result()
        return controller.session.results.verdict


@pytest.mark.parametrize('kind', KINDS)
def test_every_interface_states_one_verdict(kind, capsys):
    """Verbs, JSON, message and studio; the levels follow from the outcome."""
    path = table_of(kind)
    run = open_run(path)
    verdict = judge(run)
    text = verdict_text(verdict)
    assert verdict.outcome in KINDS[kind][1]
    assert (verdict.level == Level.GOOD) == (verdict.outcome == Outcome.FITS)
    for verb, found in verbs(path, capsys):
        if isinstance(found, str):
            names = verb == 'compare' and verdict.outcome in MISSING  # left to diagnose
            assert ('The model does not fit' if names else text.sentence) in found, verb
            assert names or text.action in found or text.action == NOTHING_TO_DO, verb
            continue
        assert (found['outcome'], found['level'], found['verdict'], found['action']) == (
            verdict.outcome, verdict.level, text.sentence, text.action), verb
        assert found.get('failing', verdict.model_fails) == verdict.model_fails
    diagnosis = diagnose(run)
    message = diagnosis_message(run, diagnosis, Time())
    assert (message.verdict, message.unexplained) == (text.sentence, diagnosis.unexplained)
    assert studio(run) == verdict


@pytest.mark.usefixtures('sketched')
@pytest.mark.parametrize('kind', ['hidden effect', 'repeatability of half the noise', 'no repeatability'])
def test_the_report_states_the_verdict(kind):
    """Its mark shows the level, its sentence and action are those of the summary."""
    run = open_run(table_of(kind))
    summary, verdict = summarise(run, has_ladder=False), judge(run)
    assert summary.verdict == verdict
    page = report_html(summary).replace('\u00a0', ' ')
    text = verdict_text(verdict)
    assert text.sentence in unescape(page) and text.action in page
    assert f'>{MARKS[verdict.level]}</span> {HEADLINES[verdict.outcome]}' in page


@pytest.mark.usefixtures('sketched')
@pytest.mark.parametrize('kind', ['hidden effect', 'incomplete'])
def test_every_interface_shows_the_same_numbers(kind, capsys):
    """Six errors and curves with U as modelled and, where a cause is missing, of the result: verbs, report, studio."""
    path = table_of(kind)
    summary = summarise(open_run(path), has_ladder=False)
    result, every = summary.result, errors_of(summary.result)
    fits = {'': result.modelled, 'result': result.curves}
    fits |= {'with_cause_found': result.curves} if result.beside else {}
    assert len(every) == (2 if kind == 'hidden effect' else 1)
    shown = [row for table in every for row in table.select('error', 'range_in_unit', 'U_range_in_unit').rows]
    for verb, found in verbs(path, capsys):
        if verb != 'compare' and isinstance(found, str):
            assert all(f' {" ".join(row)} ' in found for row in shown), verb
        elif verb != 'compare':
            assert (found['with_cause_found'] is None) == (result.beside is None), verb
            for name, one in fits.items():
                curves = found[name] if name else found
                for place, (curve, unit) in enumerate(SI_UNITS.items()):
                    key = f'{curve}_{unit}'
                    np.testing.assert_allclose(curves[key], one.motions.values[:, place], atol=1e-15)
                    np.testing.assert_allclose(curves['U'][key], 2 * one.motions.u[:, place], rtol=1e-9)
    page = ' '.join(re.sub(r'<[^>]*>', ' ', unescape(report_html(summary))).split())
    labels = ' '.join(' '.join(studio_words(open_run(path))).split())
    assert all(' '.join(row) in page and ' '.join(row) in labels for row in shown)


def studio_words(run):
    """Return the texts of the studio's panel of figures, in order."""
    controller = Controller()
    controller.act(controller.session.open, run, 'run.csv')
    with ThreadPoolExecutor(1) as threads:
        threads.submit(asyncio.run, controller.refresh()).result()
    with Client(page_of('/numbers')) as client, mock.patch.object(Figure, 'draw'):
        FiguresPanel(controller, print, print).show(controller.session.current)
    return [element.text for element in client.elements.values() if getattr(element, 'text', '')]


def test_what_cannot_be_determined_is_refused_in_one_sentence(tmp_path, capsys):
    """Exit 2 and the same line on stderr from all verbs; the studio shows it as its verdict."""
    run = clean().take(slice(0, 14))
    path = tmp_path / 'run.csv'
    write_csv(run, path)
    with pytest.raises(NotDeterminable) as refusal:
        judge(open_run(path))
    for verb in (['evaluate'], ['compare'], ['diagnose'], ['report', '-o', str(tmp_path / 'page.html')]):
        assert main([verb[0], str(path), *verb[1:]]) == 2
        captured = capsys.readouterr()
        assert (captured.out, captured.err) == ('', f'rosette: {refusal.value}\n')
    stated = studio(open_run(path))
    assert (stated.outcome, verdict_text(stated).sentence) == (Outcome.NOT_DETERMINABLE, str(refusal.value))


def test_a_combination_and_what_is_left_stand_in_the_sentence():
    """Two effects under a stated repeatability of half the noise: both are named, and the scatter beside them."""
    warp = {'kind': 'plate_warp', 'rate_um_per_h': 6.0}
    run = clean(DRIFT, warp, n=8).replace(repeatability=5e-8)
    verdict = judge(run)
    assert verdict.outcome == Outcome.NAMED
    assert {one.name for one in verdict.missing} == {'frame_drift', 'plate_warp'} and verdict.unexplained
    text = verdict_text(verdict)
    for words in ('linear probe drift', '; the plate warps with time (', 'warping of the plate', 'With them',
                  ' µm, still 2.0', ' times the repeatability (p <1e'):
        assert words in text.sentence
    assert text.action.startswith('Eliminate the causes and repeat the measurement, or include them in the evaluation '
                                  'model') and 'rosette' not in text.action


def test_an_unknown_repeatability_is_said_where_an_effect_is_named():
    """The name rests on the structure of the residual."""
    sentence = verdict_text(judge(open_run(table_of('hidden effect, no repeatability')))).sentence
    assert 'most likely linear probe drift (' in sentence
    assert 'rests on the structure of the residual alone' in sentence


def test_every_outcome_has_a_level_and_words():
    """No outcome is left out where levels are given."""
    assert {Verdict(outcome).level for outcome in Outcome} == set(Level) and set(HEADLINES) == set(Outcome)
    assert replace(Verdict(Outcome.FITS), outcome=Outcome.SCATTERS).model_fails

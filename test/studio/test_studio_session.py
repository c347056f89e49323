# SPDX-License-Identifier: Apache-2.0
"""The session and its controller without a page: runs, model with undo, results by ticket, preview, calculations."""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from rosette_ros.analysis import MOST_BALLS_JUDGED, STEPS, analyse, summarise
from rosette_ros.core.diagnosis.verdict import Level, Outcome
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, InvalidModel
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.presentation.report import open_source
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.studio_session import MOST_KEPT, KeptResults, Session
from rosette_ros.studio.worker import PRELOADED, Superseded, Worker, WorkerFailed
from rosette_ros.words.verdict_words import verdict_text

HIDDEN = {'kind': 'frame_drift', 'rate_um_per_h': [3.0, 0.0, 1.5]}


def in_loop(coroutine):
    """Return the result of a coroutine; Playwright has a running loop in the thread of the tests."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, coroutine).result()


@pytest.fixture(scope='module')
def run():
    """Return a run in which the frame drifts."""
    config = MachineConfig().changed(seed=3, plate={'balls': 5}, hidden=[HIDDEN])
    return Machine(config).run(plan(5, 'random'))


@pytest.fixture
def session(run):
    """Return a session with that run open."""
    made = Session()
    made.open(run, 'a.csv')
    return made


@pytest.fixture
def controller():
    """Yield a controller with nothing open."""
    made = Controller()
    yield made
    made.close()


def test_an_empty_session_shows_nothing():
    """No ticket, no results, nothing to undo."""
    session = Session()
    assert (session.ticket, session.current, session.undo_words, session.redo_words) == (None, None, '', '')
    assert (session.results.summary, session.results.verdict) == (None, None)
    assert not session.is_current(None)


def test_undo_and_redo_go_through_the_models(session):
    """Words name the actions; a new change drops what was undone."""
    base = session.model
    session.undo()
    session.redo()
    assert session.model == base
    session.add('frame_drift')
    session.add('plate_creep')
    assert session.model.names[3:] == ('frame_drift', 'plate_creep')
    assert session.undo_words == 'add plate_creep'
    session.undo()
    assert (session.undo_words, session.redo_words) == ('add frame_drift', 'add plate_creep')
    session.undo()
    assert session.model == base
    assert session.undo_words == ''
    session.redo()
    session.add('axis_tilt_drift')
    assert session.redo_words == ''
    assert session.model.names[3:] == ('frame_drift', 'axis_tilt_drift')


def test_removing_takes_the_part_at_a_place(session):
    """Base terms and effects by their place; of two terms with one name the one at that place."""
    session.add('frame_warmup')
    session.add('frame_warmup', {'tau': 600.0})
    assert session.model_parts[3:] == ('frame_warmup', 'frame_warmup(tau=600)')
    session.remove(3)
    assert session.model_parts[3:] == ('frame_warmup(tau=600)',)
    session.remove(1)
    assert session.model.base == ('table_motions', 'cmm_deviations')
    assert session.undo_words == 'remove plate_deviations'


def test_bad_entries_are_refused_and_change_nothing(session):
    """In the words of the core."""
    with pytest.raises(InvalidModel, match='expected names among'):
        session.add_entry({'own': 'mine', 'direction': 'z', 'expression': 'gamma'})
    with pytest.raises(InvalidModel, match='is in the model already'):
        session.add('table_motions')
    session.add('frame_drift')
    with pytest.raises(InvalidModel, match='effect frame_drift is in it twice; remove one'):
        session.add('frame_drift')
    assert session.undo_words == 'add frame_drift'


def test_a_late_result_is_kept_but_not_shown(session, run):
    """A result belongs to its run and model; with these it is shown again."""
    ticket = session.ticket
    session.add('frame_drift')
    assert not session.keep(ticket, fit=analyse(run))
    assert session.results.fit is None
    session.undo()
    assert session.is_current(ticket)
    assert session.results.fit.model == Model()


def test_runs_keep_apart(session, run):
    """Names do not repeat; each run has results of its own; the model stays."""
    session.add('frame_drift')
    first = session.ticket
    second = session.open(run, 'a.csv')
    assert second.name == 'a.csv (2)'
    assert session.current is second
    assert session.ticket == first  # the same readings have the same results
    session.open(run.replace(source='b.csv'), 'b.csv')
    assert session.ticket != first
    assert session.model.names[-1] == 'frame_drift'
    session.select(0)
    assert session.ticket == first


def test_memory_is_bounded(session, run):
    """Of many models the oldest results are dropped."""
    first, fit = session.ticket, analyse(run)
    session.keep(first, fit=fit)
    for k in range(MOST_KEPT):
        session.add_entry({'own': f'own_{k}', 'direction': 'z', 'expression': f'{k}*t'})
        session.keep(session.ticket, fit=fit)
    for _ in range(MOST_KEPT):
        session.undo()
    assert session.ticket == first
    assert session.results.fit is None


def test_a_large_run_waits_for_a_request(session, run, monkeypatch):
    """Its diagnosis would take long."""
    assert run.n < MOST_BALLS_JUDGED
    assert not session.current.is_large
    monkeypatch.setattr('rosette_ros.studio.studio_session.MOST_BALLS_JUDGED', run.n - 1)
    assert session.current.is_large


# The controller


def test_the_verdict_is_that_of_all_interfaces(controller, run):
    """Quick results first, then the summary; every step is shown; the views see each change."""
    shown = []
    controller.changed.subscribe(lambda: shown.append((controller.step, controller.session.results)))
    controller.act(controller.session.open, run, 'a.csv')
    in_loop(controller.refresh())
    expected, results = summarise(run), controller.session.results
    assert results.verdict == expected.verdict
    assert (results.verdict.level, results.verdict.outcome) == (Level.BAD, Outcome.NAMED)
    assert [step.added for step in results.summary.ladder] == [step.added for step in expected.ladder]
    assert list(dict.fromkeys(step for step, _ in shown)) == ['', *STEPS]
    assert next(one for _, one in shown if one.fit).ladder is None
    assert in_loop(controller.report()).lower().lstrip().startswith('<!doctype html')


def test_what_is_known_is_not_calculated_again(run, monkeypatch):
    """Results of another browser are shown at once; a model that was previewed takes its steps from there."""
    kept = KeptResults()
    first, second = Controller(kept), Controller(kept)
    for controller in (first, second):
        controller.act(controller.session.open, run, 'a.csv')
    in_loop(first.refresh())
    assert second.session.results is first.session.results
    model = first.session.model_with('frame_drift')
    in_loop(first.preview('frame_drift', lambda: model))
    known = kept.known(run, model)
    assert [step.added for step in known.steps] == ['', 'frame_drift'] and known.advice is not None
    assert [step.added for step in kept.known(run, Model().with_effect('plate_creep')).steps] == ['']
    monkeypatch.setattr('rosette_ros.analysis.analyse', None)
    monkeypatch.setattr('rosette_ros.analysis.advise_run', None)
    found, expected = summarise(run, model, known=known), first.session.preview.change
    assert (found.fit, found.ladder[-1].cross_validation) == (expected.after, expected.cross_validation_after)
    assert found.advice is known.advice
    for controller in (first, second):
        controller.close()


def test_a_large_run_is_only_fitted(controller, run, monkeypatch):
    """Until the diagnosis is requested."""
    monkeypatch.setattr('rosette_ros.studio.studio_session.MOST_BALLS_JUDGED', run.n - 1)
    controller.act(controller.session.open, run, 'a.csv')
    in_loop(controller.refresh())
    results = controller.session.results
    assert (results.fit is None, results.ladder, results.summary, controller.step) == (False, None, None, '')
    in_loop(controller.refresh(unasked=False))
    assert controller.session.results.verdict.outcome == Outcome.NAMED


def test_a_model_that_the_run_cannot_determine_has_a_verdict(controller, run):
    """In the words of all interfaces."""
    controller.act(controller.session.open, run.take(np.arange(6)), 'a.csv')
    in_loop(controller.refresh())
    verdict = controller.session.results.verdict
    assert (verdict.outcome, verdict.level) == (Outcome.NOT_DETERMINABLE, Level.BAD)
    assert verdict_text(verdict).action == 'Measure the missing balls.'
    controller.act(controller.session.add, 'frame_drift')
    in_loop(controller.refresh())
    assert verdict_text(controller.session.results.verdict).action == (
        'Measure the missing balls, or remove linear probe drift from the model.')


def test_a_mistake_of_the_program_is_shown(controller, run, monkeypatch):
    """No step is left running, and the traceback goes to the console."""
    monkeypatch.setattr('rosette_ros.studio.controller.summarise', stumble)
    controller.act(controller.session.open, run, 'a.csv')
    in_loop(controller.refresh())
    assert controller.step == ''
    assert controller.session.results.problem == 'a program error, reported on the console: cannot reshape'


def stumble(*_, **__):
    """Be a mistake of the program."""
    raise ValueError('cannot reshape')


def test_all_base_terms_can_be_removed(controller, run):
    """The verdict says what is missing."""
    controller.act(controller.session.open, run, 'a.csv')
    for _ in range(3):
        controller.act(controller.session.remove, 0)
    in_loop(controller.refresh())
    assert (controller.step, controller.session.results.problem) == ('', '')
    sentence = verdict_text(controller.session.results.verdict).sentence
    assert sentence.startswith('Error motions of the table; ') and 'With them the residual' in sentence


def test_what_was_asked_before_ends(controller, run):
    """The results of the second model are there; nothing is left running."""
    controller.act(controller.session.open, run, 'a.csv')

    async def change_quickly():
        first = asyncio.create_task(controller.refresh())
        await asyncio.sleep(0)
        controller.act(controller.session.add, 'frame_drift')
        await asyncio.gather(first, controller.refresh())

    in_loop(change_quickly())
    assert controller.session.results.verdict.outcome == Outcome.FITS
    assert controller.step == ''


def test_a_preview_is_dropped_with_the_model_it_was_made_for(controller, run):
    """It is shown only with the same run and model."""
    session = controller.session
    controller.act(controller.session.open, run, 'a.csv')
    other = session.model_with('frame_drift')
    in_loop(controller.preview('frame_drift', lambda: other))
    assert (session.preview.name, session.preview.change.after.model) == ('frame_drift', other)
    assert session.preview.change.helps
    controller.act(session.add, 'plate_creep')
    assert session.preview is None

    async def preview_late():
        late = asyncio.create_task(controller.preview('frame_drift', lambda: other))
        await asyncio.sleep(0)
        controller.act(session.undo)
        with contextlib.suppress(Superseded):
            await late

    in_loop(preview_late())
    assert session.preview is None

    async def dropped_early():
        late = asyncio.create_task(controller.preview('frame_drift', lambda: other))
        while not controller.previewing:
            await asyncio.sleep(0)
        controller.drop_preview()
        assert not controller.previewing
        await late

    in_loop(dropped_early())
    assert session.preview is None


def test_a_second_run_is_checked(controller, run, tmp_path):
    """What is found in one is confirmed in the other, which is opened by its path."""
    write_csv(Machine(MachineConfig().changed(seed=4, plate={'balls': 5}, hidden=[HIDDEN])).run(plan(5, 'random', 1)),
              tmp_path / 'second.csv')
    in_loop(controller.open(open_source, tmp_path / 'second.csv'))
    controller.act(controller.session.open, run, 'a.csv')
    in_loop(controller.refresh())
    in_loop(controller.cross_check(0))
    name, check = controller.check
    assert (name, check.confirmed) == ('second.csv', True)


@pytest.mark.parametrize('is_running', [True, False])
def test_a_check_that_is_asked_for_early_waits_for_the_diagnosis(controller, run, is_running):
    """The button may be pressed as another run is being opened: nothing may be lost."""
    other = Machine(MachineConfig().changed(seed=4, plate={'balls': 5}, hidden=[HIDDEN])).run(plan(5, 'random', 1))
    controller.act(controller.session.open, other, 'second.csv')
    controller.act(controller.session.open, run, 'a.csv')

    async def pressed_early():
        calculated = [controller.refresh()] if is_running else []
        await asyncio.gather(*calculated, controller.cross_check(0))

    in_loop(pressed_early())
    assert controller.check is not None and controller.check[1].confirmed


def read_for_ever(path):
    """Read what never ends."""
    while path:
        pass


def test_who_reads_long_delays_nobody(controller, run, tmp_path):
    """Another user opens a run and sees its results meanwhile; opening another file ends the first."""
    write_csv(run, tmp_path / 'a.csv')
    other = Controller()

    async def use():
        slow = asyncio.create_task(controller.open(read_for_ever, tmp_path))
        await asyncio.sleep(0)
        await other.open(open_source, tmp_path / 'a.csv')
        await other.refresh()
        assert not slow.done()
        await controller.open(open_source, tmp_path / 'a.csv')
        with pytest.raises(Superseded):
            await slow

    in_loop(use())
    other.close()
    assert other.session.results.verdict.outcome == Outcome.NAMED
    assert controller.session.current.name == 'a.csv'


# The worker


def take_memory(size):
    """Use so many bytes."""
    return len(bytearray(size))


def test_work_is_bounded():
    """In time and in memory, in words."""
    with pytest.raises(WorkerFailed, match='expected a result within 0.1 s, found none'):
        in_loop(Worker().run(time.sleep, 600, within=0.1))
    with pytest.raises(WorkerFailed, match='expected at most 2048 MB of memory, found more'):
        in_loop(Worker().run(take_memory, 4 << 30, memory=2 << 30))
    assert in_loop(Worker().run(take_memory, 1 << 20, within=60.0, memory=2 << 30)) == 1 << 20


def refuse(words):
    """Raise an error of the project."""
    raise InvalidData(words)


def test_a_worker_passes_errors_on():
    """As if the function were called here."""
    with pytest.raises(InvalidData, match='expected this, found that'):
        in_loop(Worker().run(refuse, 'expected this, found that'))


def test_a_worker_loads_nothing_of_the_page():
    """It calculates at once; loading the page took longer than most calculations."""
    loaded = in_loop(Worker().run(eval, "[*__import__('sys').modules]"))
    assert set(PRELOADED) <= set(loaded)
    assert [name for name in loaded if name.partition('.')[0] in ('nicegui', 'fastapi', 'plotly')] == []


def test_stopped_work_is_superseded():
    """By `stop`, and by other work."""
    async def stop():
        worker = Worker()
        first = asyncio.create_task(worker.run(time.sleep, 600))
        await asyncio.sleep(0)
        second = asyncio.create_task(worker.run(time.sleep, 600))
        with pytest.raises(Superseded):
            await first
        worker.stop()
        with pytest.raises(Superseded):
            await second

    in_loop(stop())


def test_a_killed_process_is_an_error():
    """As where memory runs out."""
    with pytest.raises(WorkerFailed, match='kill_itself: its process ended without a result'):
        in_loop(Worker().run(kill_itself))


@pytest.mark.parametrize('after', [0.5])
def test_a_signal_to_all_processes_leaves_no_traceback(after):
    """As of a service manager, or a terminal that is closed, while a run is opening: it ended in an EOFError."""
    script = f"""
import asyncio, os, signal, threading, time
from rosette_ros.studio.worker import Superseded, Worker, WorkerFailed, prepare
signal.signal(signal.SIGTERM, lambda *_: worker.stop())
worker = Worker()
os.setsid()
prepare()
threading.Timer({after}, os.killpg, (0, signal.SIGTERM)).start()
try:
    asyncio.run(worker.run(time.sleep, 60))
except (Superseded, WorkerFailed):
    print('ended')
"""
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, check=False, timeout=300)
    assert (done.stdout, done.stderr, done.returncode) == ('ended\n', '', 0)


def kill_itself():
    """End at once, without a word."""
    os.kill(os.getpid(), signal.SIGKILL)

# SPDX-License-Identifier: Apache-2.0
"""The desk without a page: runs, model with undo, findings by ticket, preview."""

import pytest

from rosette_ros.analysis import analyse, change, claimed_model, compare, diagnose, ladder
from rosette_ros.core.errors import InvalidModel
from rosette_ros.core.model import Model
from rosette_ros.core.scheme import plan
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.story import BAD, tell
from rosette_ros.web.session import MOST_KEPT, MOST_READINGS, Session

HIDDEN = {'kind': 'frame_drift', 'rate_um_per_h': [3.0, 0.0, 1.5]}


@pytest.fixture(scope='module')
def run():
    """Return a run in which the frame drifts."""
    config = MachineConfig().changed(seed=3, plate={'balls': 5}, hidden=[HIDDEN])
    return Machine(config).run(plan(5, 'random'))


@pytest.fixture
def session(run):
    """Return a desk with that run on it."""
    made = Session()
    made.open(run, 'a.csv')
    return made


def test_an_empty_desk_asks_nothing():
    """No ticket, no verdict, no story, nothing to undo."""
    session = Session()
    assert session.ticket is None
    assert (session.story, session.verdict, session.undo_words, session.redo_words) == (None, None, '', '')
    assert not session.is_current(None)


def test_undo_and_redo_walk_along_the_models(session):
    """Words say what; a new change forgets what was undone."""
    base = session.model
    session.add('frame_drift')
    session.add('plate_creep')
    assert session.model.names[3:] == ('frame_drift', 'plate_creep')
    assert session.undo_words == 'add plate_creep'
    assert session.undo() == 'add plate_creep'
    assert session.redo_words == 'add plate_creep'
    assert session.undo() == 'add frame_drift'
    assert session.model == base
    assert session.undo() == ''
    assert session.redo() == 'add frame_drift'
    session.add('axis_tilt_drift')
    assert session.redo_words == ''
    assert session.model.names[3:] == ('frame_drift', 'axis_tilt_drift')


def test_removing_takes_the_part_that_was_meant(session):
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
    with pytest.raises(InvalidModel, match='wanted names among'):
        session.add_entry({'own': 'mine', 'direction': 'z', 'expression': 'gamma'})
    with pytest.raises(InvalidModel, match='is in the model already'):
        session.add('table_motions')
    session.add('frame_drift')
    with pytest.raises(InvalidModel, match='frame_drift is in the model already'):
        session.add('frame_drift')
    assert session.undo_words == 'add frame_drift'


def test_what_comes_too_late_is_kept_but_not_shown(session, run):
    """A result belongs to what it was asked about; coming back to that shows it."""
    asked = session.ticket
    session.add('frame_drift')
    assert not session.keep(asked, report=analyse(run))
    assert session.found.report is None
    session.undo()
    assert session.is_current(asked)
    assert session.found.report.model == Model()


def test_a_preview_is_dropped_with_the_model_it_was_made_for(session, run):
    """It shows only where the desk still asks the same."""
    other = session.model_with('frame_drift')
    ticket, done = session.ticket, change(run, session.model, other)
    assert session.keep_preview(ticket, 'frame_drift', other, done)
    assert session.preview.change.after.fit.rms < session.preview.change.before.fit.rms
    session.add('plate_creep')
    assert session.preview is None
    assert not session.keep_preview(ticket, 'frame_drift', other, done)


def test_the_story_is_that_of_all_doors(session, run):
    """Put together from its parts it says what `tell` says."""
    ticket, told = session.ticket, tell(run)
    diagnosis = diagnose(run)
    session.keep(ticket, report=analyse(run), comparison=compare(run), diagnosis=diagnosis)
    assert session.story is None
    session.keep(ticket, rungs=ladder(run, claimed_model(diagnosis)))
    session.keep_advice(ticket.run_key, told.advice)
    assert session.story.verdict == told.verdict
    assert session.story.verdict.level == BAD
    assert [rung.added for rung in session.story.rungs] == [rung.added for rung in told.rungs]


def test_runs_keep_apart(session, run):
    """Names do not repeat; each run has findings of its own; the model stays."""
    session.add('frame_drift')
    first = session.ticket
    second = session.open(run, 'a.csv')
    assert second.name == 'a.csv (2)'
    assert session.ticket != first
    assert session.model.names[-1] == 'frame_drift'
    session.select(1)
    assert session.ticket == first


def test_memory_is_bounded(session, run):
    """Of many models the oldest findings are forgotten."""
    first, report = session.ticket, analyse(run)
    session.keep(first, report=report)
    for k in range(MOST_KEPT):
        session.add_entry({'own': f'own_{k}', 'direction': 'z', 'expression': f'{k}*t'})
        session.keep(session.ticket, report=report)
    for _ in range(MOST_KEPT):
        session.undo()
    assert session.ticket == first
    assert session.found.report is None


def test_a_large_run_waits_to_be_asked(run):
    """Where the diagnosis would take long."""
    session = Session()
    session.open(run, 'small')
    assert not session.is_large
    assert run.size < MOST_READINGS

# SPDX-License-Identifier: Apache-2.0
"""Questions to the evaluator over DDS: diagnosis, add, remove, what is published and recorded."""

import time

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import Block, Diagnosis, ErrorMotions
from rosette_msgs.srv import AddEffect, Diagnose, EvaluateJointly, NextReadings, RemoveEffect

from rosette_ros.analysis import Which, analyse, diagnose, evaluate_jointly, result
from rosette_ros.cell.client import CellClient
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.next_readings import next_readings
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.messages import verdict_of
from rosette_ros.io.open_run import open_readings
from rosette_ros.nodes.conversions import block_message
from rosette_ros.words.joint_words import part_words
from rosette_ros.words.settling_words import block_words, standing_words
from rosette_ros.words.verdict_words import verdict_text

N = 6
HIDDEN = [{'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}]
TYPES = {'diagnose': Diagnose, 'add_effect': AddEffect, 'remove_effect': RemoveEffect,
         'evaluate_jointly': EvaluateJointly, 'next_readings': NextReadings}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return the folder of the shared cell."""
    return tmp_path_factory.mktemp('cell')


@pytest.fixture(scope='module')
def cell(module_domain_id, folder, make_cell):
    """Yield a running cell whose machine hides a drift."""
    with make_cell(module_domain_id, folder, N, groups={'hidden': HIDDEN}) as running:
        yield running


@pytest.fixture(scope='module')
def ask(cell, module_domain_id, make_peer):
    """Yield a function that calls a service of the evaluator; it also has what a peer heard."""
    peer = make_peer(module_domain_id)
    clients = {name: peer.node.create_client(kind, f'evaluator/{name}')
               for name, kind in TYPES.items()}
    for topic, kind in (('diagnosis', 'Diagnosis'), ('model', 'Model'),
                        ('error_motions', 'ErrorMotions'), ('joint_evaluation', 'JointEvaluation')):
        peer.listen(topic, f'rosette_msgs/msg/{kind}')
    peer.start()

    def call(name, **request):
        assert clients[name].wait_for_service(20.0)
        future = clients[name].call_async(TYPES[name].Request(**request))
        deadline = time.monotonic() + 60.0
        while not future.done():
            assert time.monotonic() < deadline, f'expected an answer of {name} within 60 s'
            time.sleep(0.02)
        return future.result()

    call.heard = peer.heard
    yield call
    peer.stop()


@pytest.fixture(scope='module')
def unasked(ask):
    """Return the answers of an evaluator that has no run yet."""
    return {'diagnose': ask('diagnose'), 'add_effect': ask('add_effect', effect='frame_drift'),
            'remove_effect': ask('remove_effect', effect='frame_drift'),
            'evaluate_jointly': ask('evaluate_jointly'), 'next_readings': ask('next_readings')}


@pytest.fixture(scope='module')
def calibrated(unasked, cell, module_domain_id):
    """Return the Outcome of one calibration."""
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate('random', 1, check=cell.check)
    assert outcome.success, outcome.message
    return outcome


@pytest.fixture(scope='module')
def answers(calibrated, ask):
    """Return the answers to diagnose, add, diagnose, wrong add, remove, in this order."""
    return [ask('diagnose'), ask('add_effect', run_id=calibrated.run_id, effect='frame_drift'),
            ask('diagnose'), ask('add_effect', effect='table_backlash'),
            ask('add_effect', effect='wave',
                definition='{own: wave, direction: z, expression: t*cos(3*alpha)}'),
            ask('remove_effect', effect='wave'), ask('diagnose', run_id='another')]


def messages_of(log, topic):
    return [entry.data for entry in iter_log(log) if entry.topic == f'/rosette/{topic}']


@pytest.mark.parametrize('name', TYPES)
def test_without_a_run_there_is_no_answer(unasked, name):
    """In words."""
    assert not unasked[name].success
    assert unasked[name].message == 'expected a run, found none yet: calibrate first'


def test_the_log_of_a_run_holds_its_diagnosis(calibrated):
    """Published before the error motions, which end the run and carry its verdict; equal to the one made offline."""
    data, = messages_of(calibrated.log, 'diagnosis')
    message = deserialize_message(data, Diagnosis)
    motions = deserialize_message(messages_of(calibrated.log, 'error_motions')[0], ErrorMotions)
    assert motions.diagnosed
    assert verdict_of(motions) == verdict_of(message) == calibrated.verdict
    run = read_log(calibrated.log).to_run()
    found = result(run)
    assert motions.which == calibrated.which == found.curves.which == Which.AVERAGED
    assert np.array_equal(calibrated.error_motions.values, found.curves.motions.values)
    assert np.array_equal(calibrated.error_motions.u, found.curves.motions.u)
    assert list(motions.range) == [line.range for line in found.curves.lines()]
    assert np.array_equal(motions.modelled.ctx, analyse(run).error_motions['ctx'])
    offline = diagnose(run)
    assert offline.missing == ('frame_drift',)
    assert message.run_id == calibrated.run_id
    assert message.missing == ['frame_drift']
    assert message.verdict == verdict_text(offline.verdict).sentence
    assert message.invisible == list(offline.invisible)
    top, wanted = message.candidates[0], offline.candidates[0]
    assert (top.effect, top.p, top.rms_before, top.rms_after) == (
        'frame_drift', wanted.p, wanted.before, wanted.after)
    assert top.parameters.value.tolist() == [one.value for one in wanted.parameters]
    assert yaml.safe_load(top.parameters.definition) == {'axes': 'xyz'}


def test_a_joint_evaluation_is_answered_and_published(calibrated, ask, wait_until):
    """As offline, bit for bit; a declaration that does not fit the runs is refused in a line."""
    answer = ask('evaluate_jointly', run_ids=[calibrated.run_id], by_sense=EvaluateJointly.Request.NO)
    assert answer.success, answer.message
    got = answer.evaluation
    offline = evaluate_jointly([open_readings(calibrated.log)], {'by_sense': False})
    ((_, motions),) = offline.curves
    assert np.array_equal(got.curves[0].ctx, motions['ctx'])
    assert np.array_equal(got.curves[0].u_crz, motions.uncertainty('crz'))
    assert (list(got.run_ids), got.rank, got.hidden_in_curves) == (
        [calibrated.run_id], 12 * N - 13 + 3, 10), 'the drift that the run shows has a rate along each axis'
    assert list(got.not_known) == list(part_words(offline.knowledge.hidden))
    assert (got.level, answer.message) == ('good', got.verdict), 'with the drift the model fits'
    wait_until(lambda: ask.heard['joint_evaluation'])
    refused = [ask('evaluate_jointly', **request).message for request in (
        {'table': ['a', 'b']}, {'seat': 'flat'}, {'run_ids': ['another']}, {'run_ids': [calibrated.run_id] * 2})]
    assert refused[0] == 'table: expected a name for each of 1 runs, or none, found 2'
    assert refused[1] == "seat: expected one of free, plane, pilot, both, or nothing, found 'flat'"
    assert refused[2].startswith(f'run_id: expected one of {calibrated.run_id}')
    assert 'expected different runs, found the same ball centres in both' in refused[3]


def test_next_readings_are_those_of_the_log(calibrated, ask):
    """As offline, bit for bit, however often; other readings, and other blocks than the refused ones."""
    wanted = {'readings': 5, 'until_probability': 0.6, 'until_uncertainty': 1e-9}
    answer = ask('next_readings', run_id=calibrated.run_id, **wanted)
    assert answer.success and not answer.settled, answer.message
    offline = next_readings(read_log(calibrated.log).to_run(), readings=5, until=0.6, uncertainty=1e-9)
    assert answer.block == block_message(offline.targets) and 0 < len(answer.block.ball) <= 5
    assert (answer.text, answer.message) == (standing_words(offline), block_words(offline))
    assert ask('next_readings', **wanted) == answer
    assert ask('next_readings', refused=[answer.block], **wanted).block not in (answer.block, Block())
    enough = ask('next_readings', until_uncertainty=1.0)
    assert enough.settled and enough.block == Block()
    assert ask('next_readings', readings_hash='other').message.startswith(
        f"run {calibrated.run_id}: expected readings with the hash 'other', found '")


def test_diagnose_answers_as_the_log_says(answers, calibrated):
    """The service gives the diagnosis that was published after the run."""
    answer = answers[0]
    assert answer.success
    assert answer.diagnosis.missing == ['frame_drift']
    assert answer.message == answer.diagnosis.verdict
    published = deserialize_message(messages_of(calibrated.log, 'diagnosis')[0], Diagnosis)
    assert [c.p for c in answer.diagnosis.candidates] == [c.p for c in published.candidates]


def test_adding_the_effect_changes_model_and_curves(answers, calibrated):
    """The answer holds both models and the new curves: those of an offline evaluation, bit for bit."""
    answer = answers[1]
    assert answer.success, answer.message
    model = Model().with_effect('frame_drift')
    offline = result(read_log(calibrated.log).to_run(), model)
    assert answer.before.effects == []
    assert [effect.name for effect in answer.after.effects] == ['frame_drift']
    assert answer.after.hash == model.hash
    assert answer.after.residual_rms == offline.fit.rms < 0.5 * answer.before.residual_rms
    assert answer.error_motions.which == offline.curves.which == Which.MODELLED
    assert np.array_equal(answer.error_motions.ctx, offline.curves.motions['ctx'])
    assert np.array_equal(answer.error_motions.u_crz, offline.curves.motions.uncertainty('crz'))
    assert answers[2].diagnosis.missing == []
    assert verdict_of(answer.error_motions) == verdict_of(answers[2].diagnosis), 'the curves carry their verdict'
    assert answers[2].diagnosis.model_hash == model.hash


@pytest.mark.parametrize(('place', 'words'), [
    (3, 'table_backlash cannot be seen in this order of measurement'),
    (6, "run_id: expected one of rosette_"),
])
def test_what_cannot_be_is_refused_in_words(answers, place, words):
    """And nothing changes."""
    assert not answers[place].success
    assert words in answers[place].message


def test_an_own_term_comes_and_goes(answers):
    """Its definition travels with the model; after its removal the model is as before."""
    added, removed = answers[4], answers[5]
    assert added.success, added.message
    definition = yaml.safe_load(added.after.effects[-1].definition)
    assert definition == {'own': 'wave', 'direction': 'z', 'expression': 't*cos(3*alpha)',
                          'per': 'all'}
    assert removed.success
    assert removed.after.hash == answers[1].after.hash


def test_every_change_is_published(answers, ask, wait_until):
    """Model, diagnosis and error motions, three times after the run and once with it."""
    wait_until(lambda: len(ask.heard['diagnosis']) == 1 + 2 + 3)
    assert len(ask.heard['error_motions']) == 1 + 3
    assert len(ask.heard['model']) >= 1 + 3  # and the one of the start, if it was heard


@pytest.mark.parametrize(('wanted', 'words'), [
    ({'until_probability': float('nan')}, 'until.probability: expected a number in 0 .. 1 '),
    ({'until_probability': -5.0}, 'until.probability: expected a number in 0 .. 1 '),
    ({'until_probability': 0.3}, 'until.probability: expected a number above 0.5 and below 1, or 0 for none, found '
                                 '0.3'),
    ({'until_uncertainty': float('nan')}, 'until.uncertainty_m: expected a number in 0 .. 1 '),
    ({'until_probability': 0.95, 'until_uncertainty': -1.0}, 'until.uncertainty_m: expected a number in 0 .. 1 ')])
def test_next_readings_of_no_probability_are_refused(calibrated, ask, wanted, words):
    """By the service itself, whoever asks: a probability of nan was settled."""
    answer = ask('next_readings', run_id=calibrated.run_id, **wanted)
    assert not answer.success and words in answer.message and not answer.settled

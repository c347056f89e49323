# SPDX-License-Identifier: Apache-2.0
"""The evaluator's model and runs, what is asked about them, and the log that follows a run."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time

from rosette_ros.analysis import analyse
from rosette_ros.core.errors import InvalidData, InvalidModel, NotDeterminable
from rosette_ros.core.model import Model
from rosette_ros.core.scheme import plan
from rosette_ros.machine import Machine, MachineConfig
from rosette_ros.nodes import convert
from rosette_ros.nodes.analyst import Analyst, extended
from rosette_ros.nodes.follow_up import LONGEST_ANSWER, FollowUp, free_name

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}


def machine_run(run_id, *hidden):
    """Return a run of six balls in shuffled order, the table always turning one way."""
    config = MachineConfig().changed(seed=2, plate={'balls': 6}, hidden=list(hidden))
    return Machine(config).run(plan(6, 'random', 2), run_id=run_id)


@pytest.fixture(scope='module')
def drifting():
    """Return a run of a machine that drifts."""
    return machine_run('drifting', DRIFT)


@pytest.fixture
def analyst(drifting):
    """Return an Analyst with the base model and one run."""
    made = Analyst(Model())
    made.evaluate(drifting)
    return made


def test_evaluation_is_that_of_offline(drifting):
    """Under the model in use."""
    model = Model().with_effect('frame_drift')
    report = Analyst(model).evaluate(drifting)
    offline = analyse(drifting, model)
    assert np.array_equal(report.error_motions.values, offline.error_motions.values)


def test_the_last_four_runs_are_kept(drifting):
    """By name; none named is the last."""
    analyst = Analyst(Model())
    with pytest.raises(InvalidData, match='wanted a run, got none yet: calibrate first'):
        analyst.run()
    for number in range(6):
        analyst.evaluate(drifting.replace(run_id=f'run_{number}'))
    analyst.evaluate(drifting.replace(run_id='run_3'))
    assert analyst.run().run_id == 'run_3'
    assert analyst.run('run_2').run_id == 'run_2'
    with pytest.raises(InvalidData, match=r'run_id: wanted one of run_2, run_4, run_5, run_3 '):
        analyst.run('run_1')


def test_an_effect_comes_and_goes(analyst, drifting):
    """The model in use changes, and the exchange holds both fits."""
    exchange = analyst.add('', 'frame_drift', '{axes: xyz}')
    assert str(analyst.model).endswith('+ frame_drift(axes=xyz)')
    assert exchange.after.fit.rms < 0.6 * exchange.before.fit.rms
    assert exchange.words.startswith('run drifting: model table_motions + ')
    back = analyst.remove('drifting', 'frame_drift')
    assert analyst.model == Model()
    assert back.after.fit.rms == exchange.before.fit.rms
    assert back.run is drifting


def test_what_cannot_be_leaves_the_model_alone(analyst):
    """An effect that the order hides, an unknown one, one that is not there."""
    with pytest.raises(NotDeterminable, match='table_backlash cannot be seen'):
        analyst.add('', 'table_backlash')
    with pytest.raises(InvalidModel, match='effect: wanted one of frame_drift, '):
        analyst.add('', 'drift')
    with pytest.raises(InvalidModel, match="to remove, got 'frame_drift'"):
        analyst.remove('', 'frame_drift')
    assert analyst.model == Model()


def test_an_effect_that_does_not_fit_can_be_removed(analyst):
    """It is the reason why there is no fit before."""
    analyst.model = Model().with_effect('table_backlash')
    exchange = analyst.remove('', 'table_backlash')
    assert exchange.before is None
    assert 'residual undetermined -> ' in exchange.words
    assert analyst.model == Model()


@pytest.mark.parametrize(('effect', 'definition', 'words'), [
    ('frame_warmup', 'tau: [1, 2]', 'tau: wanted a positive number'),
    ('frame_warmup', '- tau', 'definition: wanted a YAML mapping such as "tau: 600.0"'),
    ('frame_warmup', 'tau: {', 'definition: wanted YAML, got text that is none'),
    ('frame_warmup', 'a: &x 1\ntau: *x', 'definition: line 2: wanted plain YAML, got an alias'),
    ('frame_warmup', 'name: frame_drift', "definition: name: wanted 'frame_warmup'"),
    ('wave', '{own: ripple, direction: z, expression: t}', "effect: wanted 'ripple'"),
    ('cmm_deviations', 'a: 1', 'definition: wanted none, cmm_deviations has no settings'),
    ('wave', '{own: wave, direction: z, expression: "().__class__"}', 'expression: wanted'),
])
def test_definitions_are_refused_in_words(effect, definition, words):
    """They come over the wire from anyone."""
    with pytest.raises(InvalidModel, match=words):
        extended(Model(('table_motions',)), effect, definition)


def test_a_definition_that_came_with_a_model_goes_back_in(analyst):
    """The message of a model holds what is needed to make it again."""
    model = extended(extended(Model(), 'frame_warmup', 'tau: 600.0'), '',
                     '{own: wave, direction: z, expression: t*cos(3*alpha)}')
    message = convert.model_message(model, Time())
    again = Model(tuple(message.base))
    for effect in message.effects:
        again = extended(again, effect.name, effect.definition)
    assert again == model
    assert again.hash == message.hash


def test_diagnosis_becomes_a_message(analyst, drifting):
    """Every field, float64 as it is, settings as YAML."""
    run, found = analyst.diagnose('drifting')
    message = convert.diagnosis_message(run, found, Time(sec=5))
    assert (message.header.stamp.sec, message.run_id) == (5, 'drifting')
    assert (message.model_name, message.model_hash) == (str(Model()), Model().hash)
    assert message.missing == list(found.missing) == ['frame_drift']
    assert (message.verdict, message.unexplained) == (found.verdict, False)
    for sent, entry in zip(message.candidates, found.candidates, strict=True):
        assert (sent.effect, sent.p, sent.delta_bic) == (entry.effect, entry.p, entry.delta_bic)
        assert (sent.held_out_rms_before, sent.held_out_rms_after) == (
            entry.held_out_before, entry.held_out_after)
        assert sent.parameters.u.tolist() == [one.u for one in entry.parameters]
        assert sent.look_alikes == list(entry.look_alikes)


def test_a_question_after_a_run_asks_for_a_log_until_it_is_answered():
    """And for a while longer, in case there is another one."""
    follow = FollowUp(quiet=2.0)
    assert not follow.is_over(0.0)
    assert follow.asked(10.0)
    follow.is_open = True
    assert not follow.is_over(100.0), 'the answer is still awaited'
    follow.answered(100.0)
    assert not follow.is_over(101.0)
    assert follow.asked(101.5)
    follow.answered(102.0)
    assert not follow.is_over(103.9)
    assert follow.is_over(104.1)


def test_an_answer_that_never_comes_does_not_keep_the_log_open():
    """The evaluator may have died over the question."""
    follow = FollowUp(quiet=2.0)
    follow.asked(10.0)
    follow.is_open = True
    assert follow.is_over(10.1 + LONGEST_ANSWER)


def test_follow_up_logs_can_be_switched_off():
    """Zero seconds of patience."""
    assert not FollowUp(quiet=0.0).asked(1.0)


@pytest.mark.parametrize(('run_id', 'taken', 'name'), [
    ('run', (), 'run_analysis'), ('run', ('run_analysis',), 'run_analysis_2'),
    ('run', ('run_analysis', 'run_analysis_2'), 'run_analysis_3'), ('', (), 'analysis'),
])
def test_names_of_follow_up_logs_are_free(run_id, taken, name):
    """Nothing is ever overwritten."""
    assert free_name(run_id, taken.__contains__) == name

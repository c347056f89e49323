# SPDX-License-Identifier: Apache-2.0
"""The model in use, the last runs, and what is asked about them."""

from dataclasses import replace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.parameter import Parameter
from rosette_msgs.srv import AddEffect

from rosette_ros.analysis import analyse
from rosette_ros.core.diagnosis.noise_facts import noise_facts
from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.model.model import Model
from rosette_ros.core.model.noise import Noise
from rosette_ros.core.run.errors import InvalidData, InvalidModel, NotDeterminable
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.model_file import parse_entry
from rosette_ros.nodes import conversions
from rosette_ros.nodes.evaluation import ModelInUse, extended
from rosette_ros.nodes.evaluator import entry_of
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.words.verdict_words import noise_words, verdict_text

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
def in_use(drifting):
    """Return an ModelInUse with the base model and one run."""
    made = ModelInUse(Model())
    made.evaluate(drifting)
    return made


def test_evaluation_is_that_of_offline(drifting):
    """Under the model in use."""
    model = Model().with_effect('frame_drift')
    fit = ModelInUse(model).evaluate(drifting)
    offline = analyse(drifting, model)
    assert np.array_equal(fit.error_motions.values, offline.error_motions.values)


def test_next_readings_ask_for_what_is_open_in_this_cell():
    """A cell that has always drifted is sooner settled about a weak drift than any other; the change of model keeps it.
    """
    run = machine_run('weak', {'kind': 'frame_drift', 'rate_um_per_h': [0.6, 0.0, 0.4]})
    known = Experience((KnownCause('frame_drift', 0.95, 1.0, 20.0, 20),), runs=20)
    told = []
    for model in (Model(), Model(experience=known)):
        in_use = ModelInUse(model)
        in_use.evaluate(run)
        found = in_use.next_readings('weak', '', lambda n: [], readings=4, until=0.9)
        told.append(sum(one.probability for one in found.contenders if 'frame_drift' in one.members))
    assert told[1] > told[0] + 0.05
    assert in_use.add('weak', 'plate_warp', {}).after.model.experience is known


def test_the_last_four_runs_are_kept(drifting):
    """By name; none named is the last."""
    in_use = ModelInUse(Model())
    with pytest.raises(InvalidData, match='expected a run, found none yet: calibrate first'):
        in_use.run()
    for number in range(6):
        in_use.evaluate(drifting.replace(run_id=f'run_{number}'))
    in_use.evaluate(drifting.replace(run_id='run_3'))
    assert in_use.run().run_id == 'run_3'
    assert in_use.run('run_2').run_id == 'run_2'
    with pytest.raises(InvalidData, match=r'run_id: expected one of run_2, run_4, run_5, run_3 '):
        in_use.run('run_1')


def test_an_effect_comes_and_goes(in_use, drifting):
    """The model in use changes, and the change holds both fits."""
    change = in_use.add('', 'frame_drift', {'axes': 'xyz'})
    assert str(in_use.model).endswith('+ frame_drift(axes=xyz)')
    assert change.after.rms < 0.6 * change.before.rms
    assert change.sentence.startswith('run drifting: model table_motions + ')
    back = in_use.remove('drifting', 'frame_drift')
    assert in_use.model == Model()
    assert back.after.rms == change.before.rms
    assert back.run is drifting


def test_what_cannot_be_leaves_the_model_alone(in_use):
    """An effect that the order hides, an unknown one, one that is not there."""
    with pytest.raises(NotDeterminable, match='table_backlash cannot be seen'):
        in_use.add('', 'table_backlash', {})
    with pytest.raises(InvalidModel, match='Unknown effect '):
        in_use.add('', 'drift', {})
    with pytest.raises(InvalidModel, match="Unknown effect 'frame_drift'"):
        in_use.remove('', 'frame_drift')
    assert in_use.model == Model()


def test_an_effect_that_does_not_fit_can_be_removed(in_use):
    """It is the reason why there is no fit before."""
    in_use.model = Model().with_effect('table_backlash')
    change = in_use.remove('', 'table_backlash')
    assert change.before is None
    assert 'residual undetermined -> ' in change.sentence
    assert in_use.model == Model()


@pytest.mark.parametrize(('effect', 'definition', 'words'), [
    ('frame_warmup', 'tau: [1, 2]', 'tau: expected a positive number'),
    ('frame_warmup', '- tau', 'definition: expected a YAML mapping such as "tau: 600.0"'),
    ('frame_warmup', 'tau: {', 'definition: expected YAML, found text that is none'),
    ('frame_warmup', 'a: &x 1\ntau: *x', 'definition: line 2: expected plain YAML, found an alias'),
    ('frame_warmup', 'name: frame_drift', "definition: name: expected 'frame_warmup'"),
    ('wave', '{own: ripple, direction: z, expression: t}', "effect: expected 'ripple'"),
    ('cmm_deviations', 'a: 1', 'model: cmm_deviations has no settings, found a; leave them out'),
    ('noise.axes', 'a: 1', 'model: noise.axes has no settings, found a; leave them out'),
    ('wave', '{own: wave, direction: z, expression: "().__class__"}', 'expression: expected'),
])
def test_definitions_are_refused_in_words(effect, definition, words):
    """They come over the wire from anyone."""
    with pytest.raises(InvalidModel, match=words):
        extended(Model(('table_motions',)), effect, parse_entry(definition, 'definition'))


@pytest.mark.parametrize(('fields', 'entry'), [
    ({}, {}),
    ({'settings': [Parameter('tau', value=600.0), Parameter('axes', value='xz')]}, {'tau': 600.0, 'axes': 'xz'}),
    ({'effect': 'wave', 'direction': 'z', 'expression': 't'}, {'own': 'wave', 'direction': 'z', 'expression': 't'}),
    ({'effect': 'wave', 'direction': 'z', 'expression': 't', 'per': 'ball'},
     {'own': 'wave', 'direction': 'z', 'expression': 't', 'per': 'ball'}),
    ({'definition': 'tau: 600.0'}, {'tau': 600.0}),
])
def test_the_fields_of_a_request_are_an_entry_of_a_model_file(fields, entry):
    """Typed fields say the same as the definition."""
    fields = {**fields, 'settings': [one.to_parameter_msg() for one in fields.get('settings', ())]}
    assert entry_of(AddEffect.Request(**fields)) == entry


@pytest.mark.parametrize(('fields', 'words'), [
    ({'definition': 'tau: 1.0', 'direction': 'z'}, 'definition: expected it empty, or no direction beside it'),
    ({'settings': [Parameter('tau', value=1.0)], 'expression': 't'},
     r"settings: expected none for a user's own term \(expression\), found tau"),
    ({'settings': [Parameter('tau', value=1.0), Parameter('tau', value=2.0)]},
     'settings: expected each once, found tau, tau'),
])
def test_fields_that_contradict_are_refused(fields, words):
    """In words."""
    fields = {**fields, 'settings': [one.to_parameter_msg() for one in fields.get('settings', ())]}
    with pytest.raises(InvalidModel, match=words):
        entry_of(AddEffect.Request(**fields))


def test_a_definition_that_came_with_a_model_goes_back_in(in_use):
    """The message of a model holds what is needed to make it again."""
    model = extended(extended(Model(), 'frame_warmup', {'tau': 600.0}), '',
                     {'own': 'wave', 'direction': 'z', 'expression': 't*cos(3*alpha)'})
    message = conversions.model_message(model, Time())
    again = Model(tuple(message.base))
    for effect in message.effects:
        again = extended(again, effect.name, parse_entry(effect.definition, 'definition'))
    assert again == model
    assert again.hash == message.hash


def test_diagnosis_becomes_a_message(in_use, drifting):
    """Every field, float64 as it is, settings as YAML."""
    run, found = in_use.diagnose('drifting')
    message = conversions.diagnosis_message(run, found, Time(sec=5))
    assert (message.header.stamp.sec, message.run_id) == (5, 'drifting')
    assert (message.model_name, message.model_hash) == (str(Model()), Model().hash)
    assert message.missing == list(found.missing) == ['frame_drift']
    assert (message.verdict, message.unexplained) == (verdict_text(found.verdict).sentence, False)
    noise, fit = message.noise, found.final
    assert (noise.sigma, noise.sigma_source, noise.is_white, noise.words) == (fit.sigma, fit.sigma_source, True, [])
    assert noise.axes.tolist() == noise.factors.tolist() * 3 == [1.0, 1.0, 1.0] and noise.wander.tolist() == [0, 0, 0]
    assert (noise.by, noise.tail, noise.tail_dof, noise.memory, noise.resolution) == ('', '', np.inf, 0.0, 0.0)
    for sent, entry in zip(message.candidates, found.candidates, strict=True):
        assert (sent.effect, sent.p, sent.visible_fraction) == (entry.name, entry.p, entry.visible_fraction)
        assert (sent.rms_before, sent.rms_after) == (entry.before, entry.after)
        assert np.isnan([sent.held_out_rms_before, sent.held_out_rms_after, sent.delta_bic]).all()
        assert sent.parameters.u.tolist() == [one.u for one in entry.parameters]
        assert sent.look_alikes == list(entry.look_alikes)


def test_other_noise_is_in_the_message(drifting):
    """Its words are those of the verdict, its numbers those of the fit."""
    fit = replace(analyse(drifting), noise=Noise(
        axes=np.array([0.8, 0.8, 1.3]), by='ball', factors=np.linspace(0.5, 2, 6), tail='reading', tail_dof=4.0,
        phi=1.0, wander=np.array([0.01, 0.02, 0.03])))
    sent = conversions.noise_message(fit)
    assert not sent.is_white and sent.words == noise_words(noise_facts(fit))
    assert (sent.by, sent.tail, sent.tail_dof, sent.memory) == ('ball', 'reading', 4.0, 1.0)
    assert (sent.axes.tolist(), sent.wander.tolist()) == ([0.8, 0.8, 1.3], [0.01, 0.02, 0.03])
    assert sent.factors.tolist() == fit.noise.factors.tolist()

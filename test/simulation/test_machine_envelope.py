# SPDX-License-Identifier: Apache-2.0
"""The sealed envelope: opens again, is not readable at a glance, reveals changes."""

import base64
import hashlib
import json

import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.simulation.envelope import open_envelope, seal_envelope


@pytest.fixture
def machine():
    """Return a machine that hides something drawn."""
    return Machine(MachineConfig(seed=5).changed(hidden={'seed': 11}))


def test_round_trip(machine, tmp_path):
    """What was sealed comes out, may stand in a configuration, and the digest was known before."""
    path = tmp_path / 'envelope.json'
    digest = seal_envelope(path, machine)
    envelope = open_envelope(path)
    assert envelope.digest == digest
    assert len(digest) == 64
    assert envelope.seed == 5
    again = Machine(MachineConfig(seed=5).changed(hidden=list(envelope.hidden)))
    assert again.hidden == machine.hidden


def test_it_says_where_the_machine_stood(machine, tmp_path):
    """A machine that goes on from there measures the same, bit by bit."""
    machine.align(repeats=2)
    seal_envelope(tmp_path / 'envelope.json', machine)
    again = Machine(machine.config, open_envelope(tmp_path / 'envelope.json').state)
    one, other = (each.measure_many([1, 2], [1, 3], [1, -1]) for each in (machine, again))
    assert (one.centre == other.centre).all() and (one.time == other.time).all()


def test_an_envelope_without_a_state_is_of_a_machine_just_switched_on(machine, tmp_path):
    """As earlier versions sealed it."""
    path = tmp_path / 'envelope.json'
    seal_envelope(path, machine)
    outer = json.loads(path.read_text())
    content = json.loads(base64.b64decode(outer['sealed']))
    del content['state']
    text = json.dumps(content).encode()
    path.write_text(json.dumps({**outer, 'sealed': base64.b64encode(text).decode(),
                                'sha256': hashlib.sha256(text).hexdigest()}))
    assert open_envelope(path).state is None


def test_nothing_is_read_by_accident(machine, tmp_path):
    """No kind stands in the file in plain words, and equal machines seal differently."""
    seal_envelope(tmp_path / 'one', machine)
    seal_envelope(tmp_path / 'two', machine)
    text = (tmp_path / 'one').read_text()
    assert not any(effect.kind in text for effect in machine.hidden)
    assert open_envelope(tmp_path / 'one').digest != open_envelope(tmp_path / 'two').digest


def test_an_envelope_is_never_overwritten(machine, tmp_path):
    """An existing file is left as it is."""
    path = tmp_path / 'envelope.json'
    path.write_text('mine')
    with pytest.raises(InvalidData, match=r'expected a new file for the envelope, found one that ex'):
        seal_envelope(path, machine)
    assert path.read_text() == 'mine'
    with pytest.raises(InvalidData, match=r'expected an envelope that can be written, found: '):
        seal_envelope(tmp_path / 'no' / 'folder', machine)


def test_a_changed_envelope_is_refused(machine, tmp_path):
    """Changed content, with the old digest, is refused."""
    path = tmp_path / 'envelope.json'
    seal_envelope(path, machine)
    outer = json.loads(path.read_text())
    sealed = base64.b64decode(outer['sealed']).replace(b'"seed": 5', b'"seed": 6')
    path.write_text(json.dumps({**outer, 'sealed': base64.b64encode(sealed).decode()}))
    with pytest.raises(InvalidData, match=r'the envelope was changed after it was sealed'):
        open_envelope(path)


@pytest.mark.parametrize(('text', 'words'), [
    ('no json', r'expected an envelope file, found: '),
    ('[]', r'expected an envelope of schema rosette-envelope/1, found something else'),
    ('{"schema": "rosette-envelope/1"}', r'sealed: expected base64 text, found something else'),
    ('{"schema": "rosette-envelope/1", "sealed": "%"}', r'sealed: expected base64 text'),
    ('{"schema": "rosette-envelope/1", "sealed": "e30=", "sha256": '
     '"44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a"}',
     r'sealed: expected seed and hidden effects, found something else'),
])
def test_no_envelope(tmp_path, text, words):
    """Other files are refused in words."""
    path = tmp_path / 'envelope.json'
    path.write_text(text)
    with pytest.raises(InvalidData, match=words):
        open_envelope(path)
    with pytest.raises(InvalidData, match=r'expected an envelope file, found: '):
        open_envelope(tmp_path / 'none')

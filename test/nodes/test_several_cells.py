# SPDX-License-Identifier: Apache-2.0
"""Several cells on one network: each keeps its frames, its time and its messages to itself."""

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import Cell
from rosette_ros.cli.hidden_demo import compare, write_machine
from rosette_ros.cli.main import main
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.log_writer import LogWriter
from rosette_ros.io.messages import nanoseconds
from rosette_ros.io.type_definitions import TypeLibrary
from rosette_ros.nodes.interfaces import interface_class
from rosette_ros.nodes.names import remappings
from rosette_ros.simulation import MachineConfig
from rosette_ros.studio.cell_watcher import CellWatcher

pytestmark = pytest.mark.long

N = 4
BALLS = 3 + 2 * N + N * N + 1
FIRST = MachineConfig().changed(seed=11, plate={'balls': N})
SECOND = MachineConfig().changed(seed=12, plate={'balls': N},
                                 placement={'origin_mm': [150.0, 320.0, -250.0], 'axis_tilt_mrad': 4.0})
SHARED = ('/diagnostics', '/rosout', '/parameter_events')
"""What is common to all of a domain: it says by itself which node it comes from."""
OF_A_RUN = ('probe_target', 'ball_centre', 'run_state', 'error_motions', 'diagnosis', 'calibration_event')


def settings_of(config):
    """Return the parameters of the nodes for a machine."""
    return {'sequencer': {'plate.balls': N, 'repeats': 3,
                          'table.origin_m': [1e-3 * float(x) for x in config.placement.origin_mm]}}


def cell_of_machine(domain, namespace, config, folder, **changes):
    """Return the Cell of a machine that keeps everything in a folder."""
    folder.mkdir()
    write_machine(config, folder / 'machine.yaml')
    return Cell(domain, namespace, machine=folder / 'machine.yaml', params=settings_of(config),
                log_dir=folder / 'runs', output_dir=folder / 'output', **changes)


@dataclass(frozen=True, eq=False)
class Place:
    """A cell that runs: where it is, and its machine."""

    cell: Cell
    config: MachineConfig

    def calibrate(self, order):
        """Run one calibration."""
        with CellClient(self.cell.domain_id, self.cell.namespace) as client:
            return client.calibrate(order, check=self.cell.check, timeout=300)


def at_the_same_time(places):
    """Calibrate in both cells at once; return the Outcomes."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(Place.calibrate, places, ('diagonal', 'row')))


def off_the_truth(log, config):
    """Return the rms of (curve - truth) / u of a log for a machine."""
    read = read_log(log)
    run = read.to_run()
    return compare(analyse(run), config, read.frame_of(run.run_id)).rms


def assert_own(outcome, own, other):
    """The log is whole and evaluates to the truth of its own machine, not to that of the other one."""
    assert outcome.success, outcome.message
    log = read_log(outcome.log)
    assert ({one.seq for one in log.targets}, len(log.answers)) == (set(range(1, BALLS + 1)), BALLS)
    assert log.run_ids == (outcome.run_id,)
    assert np.array_equal(analyse(log.to_run()).error_motions.values, outcome.error_motions.values)
    assert off_the_truth(outcome.log, own) < 1.8, 'true within its uncertainties (24 numbers, 14 of them free)'
    assert off_the_truth(outcome.log, other) > 5


@pytest.fixture(scope='module')
def neighbours(module_domain_id, tmp_path_factory):
    """Yield two Places in one domain, the first in the default namespace."""
    folder = tmp_path_factory.mktemp('neighbours')
    with cell_of_machine(module_domain_id, 'rosette', FIRST, folder / 'first') as first, \
            cell_of_machine(module_domain_id, '/cell2', SECOND, folder / 'second') as second:
        yield [Place(first, FIRST), Place(second, SECOND)]


@pytest.fixture(scope='module')
def calibrated(neighbours, module_domain_id, wait_until):
    """Return (Outcomes of two calibrations at the same time, what the studio saw of the second cell)."""
    watch = CellWatcher(module_domain_id, 'cell2')
    try:
        outcomes = at_the_same_time(neighbours)
        wait_until(lambda: watch.state.frames)
        return SimpleNamespace(outcomes=outcomes, watch=watch.state)
    finally:
        watch.close()


def test_each_log_is_true_to_its_own_machine(calibrated):
    """The table of the other one, 0.2 m away, is in neither."""
    first, second = calibrated.outcomes
    assert_own(first, FIRST, SECOND)
    assert_own(second, SECOND, FIRST)


@pytest.mark.parametrize('place, home, frames, clock', [
    (0, '/rosette/', '/tf_static', '/clock'), (1, '/cell2/', '/cell2/tf_static', '/cell2/clock')])
def test_no_message_of_the_other_cell_is_in_a_log(calibrated, place, home, frames, clock):
    """By topic, by run, and by a clock that never goes back."""
    outcome = calibrated.outcomes[place]
    times, runs, topics = [], set(), set()
    for entry in iter_log(outcome.log):
        topics.add(entry.topic)
        if entry.topic == clock:
            times.append(nanoseconds(deserialize_message(entry.data, Clock).clock))
        elif entry.topic.removeprefix(home) in OF_A_RUN:
            runs.add(deserialize_message(entry.data, interface_class(entry.type_name)).run_id)
    assert {frames, clock, *(home + name for name in OF_A_RUN)} <= topics
    assert [name for name in topics if not name.startswith(home) and name not in (*SHARED, frames, clock)] == []
    assert runs - {''} == {outcome.run_id}
    assert len(times) >= BALLS
    assert times == sorted(times)
    assert len(read_log(outcome.log).frames) == 1


def test_the_studio_sees_the_frame_of_its_own_cell(calibrated):
    """It subscribes to the topics of the namespace."""
    [received], latched = calibrated.watch.frames, read_log(calibrated.outcomes[1].log).frames[0].frame
    assert np.array_equal(received.frame.origin, latched.origin)
    assert np.array_equal(received.frame.rotation, latched.rotation)


def test_the_verbs_take_a_log_of_another_namespace(calibrated, domain_id, capsys):
    """info, evaluate, and replay onto an evaluator of the same namespace."""
    log = str(calibrated.outcomes[1].log)
    assert main(['info', log, '--json']) == 0
    [run] = json.loads(capsys.readouterr().out)['runs']
    assert run['ended'] == 'done: error motions are published'
    assert main(['evaluate', log, '--json']) == 0
    assert json.loads(capsys.readouterr().out)['ctx_m'] == calibrated.outcomes[1].error_motions['ctx'].tolist()
    assert main(['replay', log, '--domain', str(domain_id)]) == 0
    assert 'equal to those in the log, bit for bit' in capsys.readouterr().out


def test_a_log_with_the_names_of_a_domain_is_replayed_where_it_was(calibrated, domain_id, tmp_path, capsys):
    """A cell that was started by hand in a namespace, alone in its domain, without remapping."""
    log, library = calibrated.outcomes[1].log, TypeLibrary.from_environment(os.environ)
    back = {f'/cell2/{name.lstrip("/")}': name for name, _ in remappings('cell2')}
    with LogWriter(tmp_path / 'log', 'log') as writer:
        for topic in read_log(log).topics:
            if topic.messages:
                writer.add_topic(back.get(topic.name, topic.name), library.definition(topic.type_name), topic.qos)
        for entry in iter_log(log):
            writer.write(back.get(entry.topic, entry.topic), entry.data, entry.log_time, entry.publish_time)
    assert main(['replay', str(tmp_path / 'log'), '--domain', str(domain_id)]) == 0
    assert 'equal to those in the log, bit for bit' in capsys.readouterr().out


def test_calibrate_takes_the_namespace(neighbours, calibrated, module_domain_id, capsys):
    """The log lies with the logs of that cell; a name that cannot be one is refused."""
    words = ['calibrate', '--domain', str(module_domain_id), '--order', 'column', '--namespace']
    assert main([*words, '/cell2']) == 0
    assert f'Log: {neighbours[1].cell.log_dir}' in capsys.readouterr().out.replace('\n', '')
    assert main([*words, 'cell 2']) == 2
    assert 'expected a namespace such as cell2' in capsys.readouterr().err


def test_rosette_cell_takes_the_namespace(domain_id, tmp_path, wait_until):
    """Its sequencer stands in the namespace, with frames and time of its own, and its logs are true."""
    output = tmp_path / 'cell.log'
    write_machine(FIRST, tmp_path / 'machine.yaml')
    (tmp_path / 'cell.yaml').write_text(yaml.safe_dump({'/**/sequencer': {
        'ros__parameters': settings_of(FIRST)['sequencer']}}))
    with open(output, 'wb') as stream:
        process = subprocess.Popen(
            [sys.executable, '-m', 'rosette_ros.cli.main', 'cell', '--domain', str(domain_id), '--namespace', 'cell2',
             '--machine', tmp_path / 'machine.yaml', '--params', tmp_path / 'cell.yaml', '-o', tmp_path / 'runs'],
            stdout=stream, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        wait_until(lambda: 'Ctrl-C ends the cell' in output.read_text() or process.poll() is not None)
        assert f'rosette calibrate --domain {domain_id} --namespace cell2' in output.read_text()
        with CellClient(domain_id, 'cell2') as client:
            outcome = client.calibrate(timeout=300)
        assert off_the_truth(outcome.log, FIRST) < 1.8
        assert {topic.name for topic in read_log(outcome.log).topics} >= {'/cell2/tf_static', '/cell2/clock'}
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 128 + signal.SIGTERM
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def test_the_same_namespace_in_two_domains(neighbours, domain_id, tmp_path):
    """Domains keep cells apart, whatever their names."""
    with cell_of_machine(domain_id, 'rosette', SECOND, tmp_path / 'other') as other:
        first, second = at_the_same_time([neighbours[0], Place(other, SECOND)])
    assert_own(first, FIRST, SECOND)
    assert_own(second, SECOND, FIRST)

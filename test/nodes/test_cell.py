# SPDX-License-Identifier: Apache-2.0
"""A whole cell over DDS in separate processes: results, interfaces, and the log."""

import re
from collections import Counter

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2._vendor.rosidl_adapter import parser
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosette_msgs.msg import ErrorMotions, Run, RunState

from rosette_ros.analysis import analyse, result
from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.log_reader import iter_log, read_log
from rosette_ros.io.messages import Phase
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.simulation import Machine, load_machine

N = 4
TOTAL = 3 + 2 * N + N * N + 1
HEARD = {
    'probe_target': 'rosette_msgs/msg/ProbeTarget',
    'ball_centre': 'rosette_msgs/msg/BallCentre',
    'touches': 'rosette_msgs/msg/Touches',
    'run_state': 'rosette_msgs/msg/RunState',
    'error_motions': 'rosette_msgs/msg/ErrorMotions',
    'calibration_event': 'rosette_msgs/msg/CalibrationEvent',
    'calibrate/_action/feedback': 'rosette_msgs/action/Calibrate_FeedbackMessage',
    'calibrate/_action/status': 'action_msgs/msg/GoalStatusArray',
    '/tf_static': 'tf2_msgs/msg/TFMessage',
}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return the folder of the shared cell."""
    return tmp_path_factory.mktemp('cell')


@pytest.fixture(scope='module')
def cell(module_domain_id, folder, make_cell):
    """Yield a running cell with a machine without noise."""
    with make_cell(module_domain_id, folder, N, silent=True) as running:
        yield running


@pytest.fixture(scope='module')
def calibrated(cell, module_domain_id, make_peer):
    """Return (outcome, progress, what a peer heard) of one calibration by the action."""
    peer = make_peer(module_domain_id)
    for topic, type_name in HEARD.items():
        peer.listen(topic, type_name)
    peer.start()
    progress = []
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate('row', options='{limits.attempts: 2}',
                                   on_progress=progress.append, check=cell.check)
    peer.stop()
    return outcome, progress, peer.heard


def messages_of(log, topic):
    return [entry.data for entry in iter_log(log) if entry.topic == topic]


def test_calibration_ends_with_curves_and_a_log(calibrated, folder):
    """The result says where the log is and has curves for every table position."""
    outcome, _, _ = calibrated
    assert outcome.success, outcome.message
    assert not outcome.cancelled
    assert outcome.run_id.endswith('_row')
    assert outcome.log == folder / 'runs' / outcome.run_id
    assert sorted(path.name for path in outcome.log.iterdir()) == [
        'metadata.yaml', f'{outcome.run_id}_0.mcap']
    assert outcome.error_motions.values.shape == (N, 6)


def test_noise_free_cell_recovers_the_table(calibrated, folder):
    """The curves are those built into the machine, up to what no run can know."""
    machine = Machine(load_machine(folder / 'machine.yaml'))
    angle = 2 * np.pi * np.arange(N) / N
    true = remove_gauge(machine.table.error(angle))
    found = remove_gauge(calibrated[0].error_motions.values)
    assert np.abs(true[:, :3]).max() > 10e-9
    assert found[:, :3] == pytest.approx(true[:, :3], abs=1e-9)
    assert found[:, 3:] == pytest.approx(true[:, 3:], abs=5e-9)


def test_cell_measures_what_the_machine_measures_without_ros(calibrated, folder):
    """Messages, clock and frames on the way change nothing: same machine, same curves."""
    machine = Machine(load_machine(folder / 'machine.yaml'))
    run = machine.run(plan(N, 'row'), repeats=3)
    direct = analyse(run).error_motions
    assert calibrated[0].error_motions.values == pytest.approx(direct.values, abs=1e-14)
    logged = read_log(calibrated[0].log).to_run()
    assert logged.centre == pytest.approx(run.centre, abs=1e-14)
    assert logged.time == pytest.approx(run.time, abs=2e-9)
    assert logged.table_travel == pytest.approx(run.table_travel, abs=1e-12)
    assert logged.approach.tolist() == run.approach.tolist()
    assert logged.temperature == pytest.approx(run.temperature, abs=1e-12)


def test_log_gives_the_published_numbers_bit_for_bit(calibrated):
    """Offline evaluation of the log, the message in the log and the result of the action agree."""
    outcome = calibrated[0]
    log = read_log(outcome.log)
    offline = result(log.to_run())
    published = log.latest_error_motions()
    for got, wanted in ((published.motions, offline.curves), (outcome.error_motions, offline.curves),
                        (published.modelled, offline.modelled)):
        assert np.array_equal(got.values, wanted.motions.values) and np.array_equal(got.u, wanted.motions.u)
    assert published.which == outcome.which == offline.curves.which
    assert (published.run_id, published.completeness) == (outcome.run_id, 1.0)
    assert log.problems == ()
    assert log.run_ids == (outcome.run_id,)


def test_progress_goes_through_all_phases(calibrated):
    """Feedback tells every phase in order and never goes back."""
    _, progress, _ = calibrated
    phases = [p.phase for p in progress]
    assert phases == sorted(phases)
    assert set(phases) == {Phase.REPEATABILITY, Phase.ALIGNMENT, Phase.RUN, Phase.DRIFT_CHECK,
                           Phase.EVALUATION, Phase.DONE}
    done = [p.done for p in progress]
    assert done == sorted(done)
    assert done[-1] == progress[-1].total == TOTAL
    assert {p.order for p in progress} == {'row'}


@pytest.mark.parametrize('topic', HEARD)
def test_log_holds_what_a_peer_heard_byte_for_byte(calibrated, topic):
    """Every message of the run, in order, as it was on the wire."""
    outcome, _, heard = calibrated
    logged = messages_of(outcome.log, topic if topic.startswith('/') else f'/rosette/{topic}')
    assert logged
    if topic in ('probe_target', 'ball_centre', 'touches'):
        assert len(logged) == TOTAL
    assert logged == heard[topic]


def test_spheres_through_the_touches_are_the_balls_that_were_sent(calibrated):
    """Of every phase, to a picometre."""
    run, refit = open_refitted(calibrated[0].log)
    assert refit.radius.size == TOTAL
    assert refit.moved.max() < 1e-12
    assert np.abs(run.centre - read_log(calibrated[0].log).to_run().centre).max() < 1e-12


def test_log_holds_the_handshake_of_the_recorder(calibrated):
    """Request and response of both services, from client and server, as far as a log can."""
    log = calibrated[0].log
    start = messages_of(log, '/rosette/recorder/start_recording/_service_event')
    stop = messages_of(log, '/rosette/recorder/stop_recording/_service_event')
    assert len(start) == 4
    assert len(stop) >= 2  # the last response follows the last byte of the log


def test_log_names_the_services_whose_traffic_it_holds(calibrated):
    """As docs/log-format.md lists them."""
    content = yaml.safe_load((calibrated[0].log / 'metadata.yaml').read_text())
    events = {entry['topic_metadata']['name'] for entry in
              content['rosbag2_bagfile_information']['topics_with_message_count']}
    assert {name.removesuffix('/_service_event') for name in events if name.endswith('/_service_event')} == {
        f'/rosette/{name}' for name in (
            'start_calibration', 'cancel_calibration', 'evaluator/diagnose', 'evaluator/add_effect',
            'evaluator/remove_effect', 'evaluator/evaluate_jointly', 'evaluator/next_readings',
            'recorder/start_recording', 'recorder/stop_recording')}


def test_metadata_names_qos_and_hashes(calibrated):
    """Latched topics are offered so, and every type has its hash."""
    content = yaml.safe_load((calibrated[0].log / 'metadata.yaml').read_text())
    topics = {entry['topic_metadata']['name']: entry['topic_metadata'] for entry in
              content['rosbag2_bagfile_information']['topics_with_message_count']}
    assert all(t['type_description_hash'].startswith('RIHS01_') for t in topics.values())
    durability = {name: [qos['durability'] for qos in topic['offered_qos_profiles']]
                  for name, topic in topics.items()}
    for latched in ('probe_target', 'run_state', 'error_motions', 'model'):
        assert durability[f'/rosette/{latched}'] == ['transient_local']
    assert durability['/rosette/ball_centre'] == ['volatile']
    assert durability['/tf_static'] == ['transient_local']
    reliability = {qos['reliability'] for topic in topics.values()
                   for qos in topic['offered_qos_profiles']}
    assert reliability == {'reliable'}


def test_stamps_are_those_of_a_real_cell(calibrated):
    """A ball takes half a minute of simulated time, and nothing is stamped 1970."""
    log = read_log(calibrated[0].log)
    steps = np.diff([answer.stamp_ns for answer in log.answers]) * 1e-9
    assert steps.min() > 5
    assert steps.max() < 120
    assert log.start_ns > 1.6e18
    late = [after.stamp_ns - before.stamp_ns for after, before in zip(log.targets[1:], log.answers[:-1])]
    assert min(late) >= 0


def test_start_calibration_answers_at_once_with_the_run_id(cell, module_domain_id, folder,
                                                           wait_until, trigger):
    """The plain service starts the configured calibration; its log holds the call itself."""
    with CellClient(module_domain_id) as client:
        started, run_id = trigger(client, 'start_calibration')
    assert started
    assert run_id.endswith('_interleaved')
    log = folder / 'runs' / run_id
    wait_until(lambda: f'log of run {run_id}' in cell.processes['recorder'].text())
    assert read_log(log).latest_error_motions().run_id == run_id
    assert len(messages_of(log, '/rosette/start_calibration/_service_event')) >= 2
    assert messages_of(log, '/rosette/calibrate/_action/feedback') == []
    origins = {event.origin for event in read_log(log).events if event.run_id == run_id}
    assert origins == {'start_calibration'}


@pytest.mark.parametrize(('order', 'options', 'words'), [
    ('circle', '', "calibration refused: goal: order: expected one of row, diagonal, column, random"),
    ('', 'repeat: 3', "found 'repeat'; did you mean 'repeats'"),
])
def test_wrong_goal_is_refused_in_words(cell, module_domain_id, order, options, words):
    """Nothing starts."""
    with CellClient(module_domain_id) as client, pytest.raises(CellError, match=words):
        client.calibrate(order, options=options, check=cell.check)


def test_every_message_decodes_with_mcap_ros2_support(calibrated, monkeypatch):
    """Foxglove's Python decoder reads all, once its check of names knows events and feedback."""
    monkeypatch.setattr(parser, 'VALID_MESSAGE_NAME_PATTERN', re.compile('[A-Z][A-Za-z0-9_]*$'))
    path = next(calibrated[0].log.glob('*.mcap'))
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [(channel.topic, type(message).__name__)
                   for _, channel, _, message in reader.iter_decoded_messages()]
        total = reader.get_summary().statistics.message_count
    assert len(decoded) == total
    kinds = dict(decoded)
    assert kinds['/rosette/recorder/start_recording/_service_event'] == 'StartRecording_Event'
    assert kinds['/rosette/calibrate/_action/feedback'] == 'Calibrate_FeedbackMessage'
    assert {'/rosette/ball_centre', '/clock', '/rosout', '/diagnostics'} <= set(kinds)


def test_every_message_decodes_with_rosbags(calibrated):
    """A reader without ROS opens the directory, checks the type hashes and reads all."""
    counts = Counter()
    with AnyReader([calibrated[0].log]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            assert message is not None
            counts[connection.topic] += 1
        assert reader.message_count == sum(counts.values())
    assert counts['/rosette/ball_centre'] == TOTAL


def test_replay_onto_a_fresh_evaluator_gives_the_same_numbers(calibrated, cell_of, peer,
                                                              wait_until):
    """An evaluator that knows nothing hears the log, topic after topic, and publishes the same."""
    log = calibrated[0].log
    topics = {'/rosette/run': Run, '/rosette/run_state': RunState}
    latched = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = {topic: peer.node.create_publisher(kind, topic, latched)
                  for topic, kind in topics.items()}
    peer.listen('error_motions', 'rosette_msgs/msg/ErrorMotions')
    with cell_of(N, nodes=('evaluator',)):
        peer.start()
        wait_until(lambda: all(one.get_subscription_count() for one in publishers.values()))
        for topic, publisher in publishers.items():
            for data in messages_of(log, topic):
                publisher.publish(data)
        wait_until(lambda: peer.heard['error_motions'])
    replayed = deserialize_message(peer.heard['error_motions'][0], ErrorMotions)
    (logged,) = messages_of(log, '/rosette/error_motions')
    original = deserialize_message(logged, ErrorMotions)
    replayed.header.stamp, replayed.process = original.header.stamp, original.process
    assert replayed == original  # not by their bytes: what stands between the fields in CDR is anything

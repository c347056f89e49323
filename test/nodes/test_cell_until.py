# SPDX-License-Identifier: Apache-2.0
"""A cell that measures until nothing is open: one run, one log, which alone tells why each reading was made.

KILLS=30 tries so many seeded kills, `make soak` does.
"""

import os
import signal
import time

import numpy as np
import pytest
import yaml
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import BallCentre, CalibrationEvent, ProbeTarget

from rosette_ros.analysis import summarise
from rosette_ros.calibration.settings import PLANNED, plan_of
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES
from rosette_ros.cli.main import main
from rosette_ros.cli.replay import decisions_of
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase, answer_of
from rosette_ros.nodes import names, qos
from rosette_ros.nodes.conversions import target_message
from rosette_ros.presentation.report import open_source, report_html

pytestmark = pytest.mark.long

N, MOST = 6, 12
HIDDEN = [{'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}]
UNTIL = 0.6
GOAL = {'order': 'row', 'until_probability': UNTIL, 'until_uncertainty': 1e-9, 'most_readings': MOST}
"""A U that no run reaches: readings are added up to the limit."""
BEFORE = 3 + 2 * N
"""Targets before those of the run: repeatability and alignment."""
KILLS = int(os.environ.get('KILLS', '4'))
ASKING = 'asking the evaluator'


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a running cell whose machine hides a drift."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('cell'), N, groups={'hidden': HIDDEN}) as running:
        yield running


@pytest.fixture(scope='module')
def outcome(cell, module_domain_id):
    """Return the Outcome of a run that grew, and the texts of its states."""
    texts = []
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(**GOAL, on_progress=lambda progress: texts.append(progress.text), check=cell.check)
    assert outcome.success, outcome.message
    return outcome, texts


def decided(log):
    """Return the texts of the events about what was added, and the readings added in the end, at least one."""
    events = [one for one in log.events if one.kind == CalibrationEvent.EXTENDED]
    added = yaml.safe_load(events[-1].settings)['added'].split(', ')
    assert 0 < len(added) <= MOST
    return [one.text for one in events], added


def readings(run):
    """Return table position and ball of the targets of phase RUN, in order of seq."""
    last = {one.seq: one for one in run.targets if one.phase == Phase.RUN}
    return [(last[seq].table_position, last[seq].ball) for seq in sorted(last)]


def test_one_run_grows_block_by_block(outcome):
    """All in one log: the blocks numbered on, the reason of each, the drift check last; the limit holds."""
    result, texts = outcome
    log = read_log(result.log)
    texts_of_events, added = decided(log)
    assert log.problems == () and log.run_ids == (result.run_id,)
    assert log.to_run().size == N * N + len(added)
    assert [text.partition(':')[0] for text in texts_of_events] == ['settling'] * (len(texts_of_events) - 1) + [
        'not settled']
    assert result.message.endswith(texts_of_events[-1])
    if len(added) == MOST:
        assert f'after as many readings as are to be added ({MOST})' in result.message
    (run,) = log.runs.values()
    assert [f'{i} {j}' for i, j in readings(run)[N * N:]] == [' '.join(row.split()[:2]) for row in added]
    assert [one.seq for one in run.targets] == list(range(1, len(run.targets) + 1))
    assert run.targets[-1].phase == Phase.DRIFT_CHECK
    assert any(text.startswith('settling: ') and f'; run {N * N + 1} of ' in text for text in texts)
    assert any(text.startswith(ASKING) for text in texts)


def test_a_replay_gives_the_same_blocks(outcome, domain_id, capsys):
    """An evaluator that knows nothing but the log answers each request as it was answered."""
    log = outcome[0].log
    times = len(list(decisions_of(log)))
    assert times == len(decided(read_log(log))[0])
    assert main(['replay', str(log), '--domain', str(domain_id)]) == 0
    printed = ' '.join(capsys.readouterr().out.split())
    assert 'equal to those in the log, bit for bit' in printed
    assert f'next readings equal to those in the log, {times} times' in printed


def completed(calibrate):
    """Return the Outcome of a run that is resumed, None where nothing is missing; waits for a cell that starts."""
    deadline = time.monotonic() + 60
    while True:
        try:
            return calibrate()
        except CellError as error:
            if 'lacks nothing' in str(error):
                return None
            assert 'expected' in str(error) and time.monotonic() < deadline, error
            time.sleep(0.2)


@pytest.mark.parametrize('seed', range(KILLS))
def test_a_node_is_killed(cell, module_domain_id, seed, domain_id, capsys):
    """Every node in turn, while a block is asked, and at a drawn moment: nothing is lost, the run ends as it would
    have, and its log gives the same blocks again."""
    name, killed = list(MODULES)[seed % len(MODULES)], []
    is_while_asked = seed // len(MODULES) % 2 == 0
    moment = int(np.random.default_rng(seed).integers(1, BEFORE + N * N + 1))

    def look(progress):
        if (progress.text.startswith(ASKING) if is_while_asked else progress.done >= moment) and not killed:
            killed.append(progress.done)
            cell.processes[name].popen.send_signal(signal.SIGKILL)
            cell.processes[name].popen.wait(60)
            cell.restart_failed()

    with CellClient(module_domain_id) as client:
        try:
            outcome = client.calibrate(**GOAL, on_progress=look)
        except CellError as error:
            assert name == 'sequencer' and 'rosette calibrate --resume' in str(error)
            outcome = None
        run_id = client._run_id
    if outcome is None or not outcome.success:
        with CellClient(module_domain_id) as client:
            outcome = completed(lambda: client.calibrate(resume=run_id))
    assert killed and outcome.success, outcome.message
    log = read_log(outcome.log)
    _, added = decided(log)
    assert log.problems == ()
    assert len(readings(log.runs[run_id])) == N * N + len(added)
    if name == names.CMM and is_while_asked:  # the first one was measured in the session of the CMM before
        assert {one.session for one in log.targets if one.seq > killed[0]} == {2}
    assert {one.seq for one in log.answers} == set(range(1, BEFORE + N * N + len(added) + 2))
    assert main(['replay', str(outcome.log), '--domain', str(domain_id)]) == 0
    assert 'next readings equal to those in the log' in ' '.join(capsys.readouterr().out.split())


def test_the_report_shows_the_way(outcome):
    """What was known after the plan and after each block, from the log alone."""
    log = read_log(outcome[0].log)
    until, asked = log.asked[outcome[0].run_id]
    sizes = [N * N + len(one) for one in map(added_in, log.events) if one is not None]
    assert until == UNTIL and asked == [N * N, *sizes[:-1]]
    run, source = open_source(outcome[0].log)
    assert source.asked == tuple(asked)
    assert 'The way to the cause: probability of the leading explanations' in report_html(summarise(run), source)


def added_in(event):
    """Return the readings that were added until an event of an extension, None for another event."""
    if event.kind != CalibrationEvent.EXTENDED:
        return None
    return yaml.safe_load(event.settings)['added'].split(', ')


def test_the_service_takes_until_from_the_parameters(domain_id, cell_of, trigger, wait_until):
    """A schedule that knows nothing of goals starts a run that goes on, too."""
    parameters = {'order': 'row', 'until.probability': UNTIL, 'until.uncertainty_m': 1e-9, 'until.most_readings': 6}
    with cell_of(N, sequencer=parameters, groups={'hidden': HIDDEN}) as cell, CellClient(domain_id) as client:
        started, run_id = trigger(client, 'start_calibration')
        assert started, run_id
        wait_until(lambda: 'not settled: ' in cell.processes['sequencer'].text())
        wait_until(lambda: (cell.log_dir / run_id / 'metadata.yaml').is_file())
    run = read_log(cell.log_dir / run_id).to_run()
    assert N * N < run.size <= N * N + 6


def test_a_block_that_the_cmm_refuses(domain_id, cell_of, capsys):
    """Over the service of a real node: the next best block is measured, and a replay chooses it, too."""
    cell = cell_of(N, groups={'hidden': HIDDEN})
    cell._modules[names.CMM] = 'refusing_cmm'
    with cell, CellClient(domain_id) as client:
        outcome = client.calibrate(**{**GOAL, 'most_readings': 6}, check=cell.check)
        said = cell.processes['sequencer'].text()
    assert outcome.success, outcome.message
    assert 'the CMM cannot measure this plan: no way to ball' in said and 'asking for other readings' in said
    asked = [(request, response) for _, request, response in decisions_of(outcome.log)]
    first, second = asked[:2]
    assert not first[0].refused and list(second[0].refused) == [first[1].block]
    assert second[1].block != first[1].block
    added = [' '.join(row.split()[:2]) for row in decided(read_log(outcome.log))[1]]
    block = second[1].block
    assert added[:len(block.ball)] == [f'{i} {j}' for i, j in zip(block.table_position, block.ball)]
    assert main(['replay', str(outcome.log), '--domain', str(domain_id)]) == 0
    assert f'next readings equal to those in the log, {len(asked)} times' in ' '.join(capsys.readouterr().out.split())


def test_a_run_is_cancelled_while_a_block_is_asked(cell, module_domain_id):
    """At once; the answer that comes later changes nothing, and the run can be resumed."""
    def look(progress):
        if progress.text.startswith(ASKING):
            os.kill(os.getpid(), signal.SIGINT)

    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(**GOAL, on_progress=look)
        assert outcome.cancelled and 'continue with: rosette calibrate --resume' in outcome.message
        again = client.calibrate(resume=str(outcome.log))
    assert again.success and 'not settled: ' in again.message


def test_a_simulated_machine_waits_for_the_time_of_a_target(cell_of, peer, wait_until):
    """The next answer is so much later; a stamp that is past, or absurd, changes nothing."""
    made = plan_of({wanted.name: wanted.default for wanted in PLANNED} | {'plate.balls': 4})
    out = peer.node.create_publisher(ProbeTarget, names.PROBE_TARGET, qos.TARGET)
    peer.listen(names.BALL_CENTRE, 'rosette_msgs/msg/BallCentre')
    stamps, heard = [], peer.heard[names.BALL_CENTRE]
    with cell_of(4, nodes=('cmm',)):
        peer.start()
        wait_until(lambda: out.get_subscription_count())
        for count, wait in enumerate((0.0, 0.0, 600.0, -600.0, 1e9)):
            target = made.placed(made.target(0), made.taught, 'machine')._replace(
                run_id='a', seq=count + 1, stamp_ns=(stamps or [0])[-1] + round(1e9 * wait))
            out.publish(target_message(target))
            wait_until(lambda count=count: len(heard) > count)
            stamps.append(answer_of(deserialize_message(heard[-1], BallCentre)).stamp_ns)
    steps = np.diff(stamps) * 1e-9
    assert 600.0 < steps[1] < 600.0 + steps[0]  # stamps are the middle of the touches
    assert steps[[2, 3]] == pytest.approx(steps[[0, 0]], rel=0.1)


def test_a_goal_outside_the_limits_is_refused(cell, module_domain_id):
    """In one line, before anything is measured."""
    with CellClient(module_domain_id) as client, pytest.raises(CellError) as caught:
        client.calibrate(until_probability=0.4)
    assert 'until.probability: expected a number above 0.5 and below 1, or 0 for none, found 0.4' in str(caught.value)

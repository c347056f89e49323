# SPDX-License-Identifier: Apache-2.0
"""One node or two at once are killed at any moment: every answered ball is in the log, the run is completed, the
curves agree.

The machine has no noise, so that curves agree bit for bit. KILLS=60 tries so many seeded runs, `make soak` does.
"""

import os
import signal
import time
from itertools import combinations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import BallCentre

from rosette_ros.analysis import analyse
from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import names

pytestmark = pytest.mark.long

N, REPEATS = 5, 3
TOTAL = REPEATS + 2 * N + N * N + 1
VICTIMS = [(name,) for name in MODULES] + list(combinations(MODULES, 2))
KILLS = int(os.environ.get('KILLS', '5'))
ANSWER_S = 0.03
"""The machine answers so slowly that a second of a run is worth talking about."""


@pytest.fixture(scope='module')
def killable(module_domain_id, make_cell, make_peer, tmp_path_factory):
    """Yield (cell, domain, what a witness has heard of the answers)."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('kills'), N, silent=True,
                   groups={'table': {'positioning_urad': 0.0}},
                   params={'cmm': {'answer_s': ANSWER_S}}) as cell:
        witness = make_peer(module_domain_id)
        witness.listen(names.BALL_CENTRE, 'rosette_msgs/msg/BallCentre')
        try:
            witness.start()
            yield cell, module_domain_id, witness.heard[names.BALL_CENTRE]
        finally:
            witness.stop()


@pytest.fixture(scope='module')
def undisturbed(killable):
    """Return the Outcome of a run in which nobody was killed."""
    cell, domain, _ = killable
    with CellClient(domain) as client:
        outcome = client.calibrate(check=cell.check)
    assert outcome.success, outcome.message
    return outcome


def killed_run(cell, domain, victims, moment):
    """Calibrate; kill nodes at once when so many targets are answered; resume where that ends the run.

    Returns (run_id, its last Outcome).
    """
    killed = []

    def look(progress):
        if progress.done >= moment and not killed:
            killed.extend(victims)
            for name in victims:
                cell.processes[name].popen.send_signal(signal.SIGKILL)
            for name in victims:
                cell.processes[name].popen.wait(60)
            cell.restart_failed()

    with CellClient(domain) as client:
        outcome = completed(lambda: client.calibrate(on_progress=look), killed)
        run_id = client._run_id
    if outcome is None or not outcome.success or 'closing the log' in outcome.message:
        with CellClient(domain) as client:
            outcome = completed(lambda: client.calibrate(resume=run_id), ())
    assert killed, 'the node was killed'
    return run_id, outcome


def completed(calibrate, killed):
    """Return the Outcome; None where the cell went away with the sequencer; waits for a cell that starts."""
    deadline = time.monotonic() + 60
    while True:
        try:
            outcome = calibrate()
            if killed or outcome.success or time.monotonic() > deadline:
                return outcome
            time.sleep(0.2)
        except CellError as error:
            if killed:
                assert 'sequencer' in str(error)
                assert 'rosette calibrate --resume' in str(error)
                return None
            if 'lacks nothing' in str(error):
                return None
            assert time.monotonic() < deadline, error
            time.sleep(0.2)


def answered(heard, run_id):
    """Return the targets of a run to which the witness heard a good answer."""
    messages = [deserialize_message(data, BallCentre) for data in list(heard)]
    return {one.seq for one in messages if one.run_id == run_id and one.status == BallCentre.STATUS_OK}


def last_part(folder, run_id):
    """Return the folder of the last part of a run."""
    return max(folder.glob(f'{run_id}*'), key=lambda path: (len(path.name), path.name))


@pytest.mark.parametrize('seed', range(KILLS))
def test_a_node_is_killed_at_any_moment(killable, undisturbed, seed):
    """Every node and every two in turn; the moment is drawn."""
    cell, domain, heard = killable
    victims = VICTIMS[seed % len(VICTIMS)]
    moment = int(np.random.default_rng(seed).integers(1, TOTAL))
    run_id, outcome = killed_run(cell, domain, victims, moment)
    folder = last_part(cell.log_dir, run_id)
    if victims == ('evaluator',):  # what it published before the others knew it is used when they do
        assert folder.name == run_id and outcome.success
    log = read_log(folder)
    assert log.problems == ()
    in_log = {answer.seq for answer in log.runs[run_id].answers}
    assert answered(heard, run_id) <= in_log
    assert in_log == set(range(1, TOTAL + 1))
    run = log.to_run()
    assert run.size == N * N
    if folder.name != run_id:
        assert log.custom_data['rosette.resumes'] == run_id
    fit = analyse(run)
    assert np.array_equal(fit.error_motions.values, undisturbed.error_motions.values)
    if outcome is not None:
        assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)


def test_a_sequencer_that_is_killed_after_success(killable, undisturbed, wait_until):
    """Its client says success, with the results and the log: it advised to resume what lacks nothing."""
    cell, domain, _ = killable
    killed, sequencer = [], cell.processes['sequencer']
    begun = sequencer.output.read_text().count(names.COMPLETE)

    def look(progress):
        if progress.phase == Phase.DONE and not killed:
            killed.append(progress.run_id)
            cell.processes['sequencer'].popen.send_signal(signal.SIGKILL)
            cell.processes['sequencer'].popen.wait(60)
            cell.restart_failed()

    with CellClient(domain) as client:
        outcome = client.calibrate(on_progress=look)
    assert outcome.success, outcome.message
    assert killed == [outcome.run_id] and outcome.log == cell.log_dir / outcome.run_id
    assert outcome.verdict == undisturbed.verdict
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)
    assert read_log(outcome.log).to_run().size == N * N
    wait_until(lambda: sequencer.output.read_text().count(names.COMPLETE) > begun)


@pytest.mark.parametrize('moment', [names.READY, 'recording run'])
def test_a_recorder_that_is_killed_again_as_it_comes_back(killable, undisturbed, moment):
    """While the run waits for it, or has it open the new part: the run waits again, and is completed."""
    cell, domain, heard = killable
    kills = []

    def kill():
        kills.append(time.monotonic())
        cell.processes['recorder'].popen.send_signal(signal.SIGKILL)
        cell.processes['recorder'].popen.wait(60)
        cell.start_node('recorder', wait=False)

    def look(progress=None):
        if progress is not None and progress.done >= TOTAL // 2 and not kills:
            kill()
        elif 0 < len(kills) < 3 and moment in cell.processes['recorder'].text():
            kill()

    with CellClient(domain) as client:
        outcome = client.calibrate(on_progress=look, check=look)
        if 'closing the log' in outcome.message:  # all was measured before the last kill
            outcome = completed(lambda: client.calibrate(resume=client._run_id), ()) or outcome
    assert outcome.success, outcome.message
    assert len(kills) == 3
    log = read_log(outcome.log)
    assert log.problems == ()
    assert answered(heard, outcome.run_id) <= {answer.seq for answer in log.answers} == set(range(1, TOTAL + 1))
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)


@pytest.mark.parametrize('damage', [os.unlink, lambda path: os.truncate(path, 0), lambda path: os.truncate(path, 9000)],
                         ids=['deleted', 'emptied', 'cut'])
def test_a_log_that_goes_in_the_middle_of_a_run_loses_nothing(killable, undisturbed, damage):
    """The run goes on in a new part, which holds every answer; the curves are those of an undisturbed run."""
    cell, domain, heard = killable
    damaged = []

    def look(progress):
        if progress.done >= TOTAL // 2 and not damaged:
            damaged.append(progress.run_id)
            damage(cell.log_dir / progress.run_id / f'{progress.run_id}_0.mcap')

    with CellClient(domain) as client:
        outcome = client.calibrate(on_progress=look, check=cell.check)
    assert outcome.success, outcome.message
    assert outcome.log == cell.log_dir / f'{outcome.run_id}_part2'
    assert damaged == [outcome.run_id]
    log = read_log(outcome.log)
    assert log.problems == ()
    assert {answer.seq for answer in log.answers} == answered(heard, outcome.run_id) == set(range(1, TOTAL + 1))
    assert np.array_equal(analyse(log.to_run()).error_motions.values, undisturbed.error_motions.values)
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)

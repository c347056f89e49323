# SPDX-License-Identifier: Apache-2.0
"""Who else publishes in a cell: two at once are refused before a run, and hold it in words; nothing of them is used."""

import re
import socket
import subprocess
import sys

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rich.console import Console
from rosette_msgs.msg import BallCentre, Diagnosis, ErrorMotions, ProbeTarget, Run, RunState
from std_msgs.msg import Header

from rosette_ros.cell.client import CellClient
from rosette_ros.cell.supervisor import MODULES, Cell, cell_environment
from rosette_ros.cli.cell import refuse_second_cell
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.messages import Phase
from rosette_ros.nodes import names, qos

pytestmark = pytest.mark.long

N = 4
FORGED_STAMP = Time(sec=2**31 - 1)
"""By which an answer of a Forger is found in a log."""
TOTAL = 3 + 2 * N + N * N + 1
TWO = r'2 nodes publish /rosette/ball_centre \(/rosette/cmm and (/rosette/peer|one whose name is not known)\)'
"""The name of a node is known a little later than what it publishes."""
WAIT = 'limits.return_timeout_s: 60.0'


@pytest.fixture(scope='module')
def cell(module_domain_id, make_cell, tmp_path_factory):
    """Yield a cell without noise that answers slowly enough to be disturbed."""
    with make_cell(module_domain_id, tmp_path_factory.mktemp('senders'), N, silent=True,
                   groups={'table': {'positioning_urad': 0.0}}, params={'cmm': {'answer_s': 0.15}}) as made:
        yield made


@pytest.fixture
def client(cell, module_domain_id):
    """Yield a client of the cell."""
    with CellClient(module_domain_id) as made:
        yield made


@pytest.fixture(scope='module')
def undisturbed(cell, module_domain_id):
    """Return the outcome of a run in which nobody else published."""
    with CellClient(module_domain_id) as client:
        outcome = client.calibrate(check=cell.check)
    assert outcome.success, outcome.message
    return outcome


@pytest.fixture
def stranger(cell, module_domain_id, make_peer):
    """Yield a node of another process' kind: a participant of its own, without a status."""
    made = make_peer(module_domain_id)
    made.start()
    yield made
    made.stop()


class Forger:
    """Answers every target at once, 10 µm beside, and states and results of its own besides."""

    def __init__(self, peer):
        """Publish nothing yet."""
        self._node, self._publishers, self._subscription = peer.node, [], None
        self.answered = 0

    def publish(self, kind, topic, profile, *messages):
        """Join a topic and publish there."""
        made = self._node.create_publisher(kind, topic, profile)
        self._publishers.append(made)
        for message in messages:
            made.publish(message)
        return made

    def answer(self, now=lambda: FORGED_STAMP):
        """Join as a CMM; one that is to be believed states the time of each answer."""
        publisher = self.publish(BallCentre, names.BALL_CENTRE, qos.ANSWER)

        def on_target(target):
            self.answered += 1
            centre = target.centre
            centre.x += 1e-5
            publisher.publish(BallCentre(
                header=Header(stamp=now(), frame_id=target.header.frame_id), run_id=target.run_id,
                seq=target.seq, table_position=target.table_position, ball=target.ball,
                cmm_position=target.cmm_position, table_angle=target.table_angle, centre=centre))

        self._subscription = self._node.create_subscription(ProbeTarget, names.PROBE_TARGET, on_target, qos.ORDER)

    def leave(self):
        """Leave all topics."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)
        self._publishers.clear()


def disturbed_run(client, cell, join, leave, is_enough, options=WAIT):
    """Calibrate; join in the middle, leave once the run is held and told. Returns (Outcome, texts of the states)."""
    told, joined = [], []

    def look(progress=None):
        if progress is not None:
            told.append(progress.text)
            if progress.done >= 4 and not joined:
                joined.append(progress.run_id)
                join(progress.run_id)
        if joined and leave is not None and is_enough(told):
            leave()

    outcome = client.calibrate(on_progress=look, check=lambda: (cell.check(), look()), options=options)
    assert joined
    return outcome, told


def taken_by(client, topic):
    """Return the list to which the messages of a topic are appended once the client has taken them."""
    taken = []
    for subscription in client._node.subscriptions:
        if subscription.topic_name == client._node.resolve_topic_name(topic):
            subscription.callback = (lambda message, callback=subscription.callback:
                                     (callback(message), taken.append(message)))
    return taken


def is_held(told):
    return any('waiting for the end of one' in text for text in told)


def test_a_second_cmm_is_refused_before_a_run(cell, client, stranger, wait_until):
    """In words that name both; when it has gone, the cell calibrates again."""
    forger = Forger(stranger)
    forger.answer()
    wait_until(lambda: 'expected one in this domain' in cell.processes['sequencer'].text())
    with pytest.raises(CellError, match=f'calibration refused: {TWO}: expected one in this domain and namespace; is '
                                        'another cell running'):
        client.calibrate()
    said = len(cell.processes['sequencer'].text())
    forger.leave()
    wait_until(lambda: names.COMPLETE in cell.processes['sequencer'].text()[said:])
    assert client.calibrate(check=cell.check).success


def test_forged_answers_during_a_run_are_not_used(cell, client, stranger, undisturbed):
    """The run is held while there are two, goes on with the CMM alone, and tells it; the curves are the true ones."""
    forger = Forger(stranger)
    outcome, told = disturbed_run(
        client, cell, lambda _: forger.answer(), forger.leave, lambda told: is_held(told) and all(
            re.search(f'{TWO}: what they publish is not used', cell.processes[name].text()) for name in cell.processes
            if name not in ('cmm', 'evaluator')))
    assert outcome.success, outcome.message
    assert re.search(f'; {TWO} for a while: what they published then is not used$', outcome.message)
    assert any('2 nodes publish /rosette/ball_centre' in text for text in told)
    log = read_log(outcome.log)
    assert not [answer for answer in log.answers if answer.stamp_ns == FORGED_STAMP.sec * 10**9]
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)


def test_a_second_cmm_that_stays_ends_the_run_in_words(cell, client, stranger):
    """Nothing of it is used; what was measured before is in the log and can be resumed."""
    forger = Forger(stranger)
    outcome, _ = disturbed_run(client, cell, lambda _: forger.answer(), None, None, 'limits.return_timeout_s: 2.0')
    forger.leave()
    assert not outcome.success
    # The recorder may have found the second one first: then it lacks what the CMM answered meanwhile, and says so.
    assert re.fullmatch(rf'{TWO} for 2 s; end one of them and resume the run'
                        r'(; closing the log: it lacks \d+ answers)?; what was measured is in \S+; continue with: .*',
                        outcome.message)
    assert read_log(outcome.log).states[-1].phase == Phase.FAILED


FORGED = {
    names.RUN_STATE: (RunState, qos.STATE, lambda run_id: (
        RunState(phase=RunState.PHASE_IDLE), RunState(run_id=run_id, phase=RunState.PHASE_FAILED))),
    names.ERROR_MOTIONS: (ErrorMotions, qos.RESULT, lambda run_id: (
        ErrorMotions(run_id=run_id, balls=N, angle=[0.0] * N, **{c: [0.0] * N for c in ('ctx', 'cty', 'ctz')}),)),
    names.RUN: (Run, qos.RESULT, lambda run_id: (Run(run_id=run_id),)),
    names.DIAGNOSTICS: (DiagnosticArray, qos.STATUS, lambda _: (DiagnosticArray(status=[DiagnosticStatus(
        name='rosette/cmm', values=[KeyValue(key='process', value='cmm 1 deadbeef'),
                                    KeyValue(key='problem', value='forged trouble')])]),)),
    names.DIAGNOSIS: (Diagnosis, qos.RESULT, lambda run_id: (
        Diagnosis(run_id=run_id, outcome='fits', verdict='perfect'),)),
}


@pytest.mark.parametrize('topic', FORGED)
def test_what_another_node_says_does_not_end_or_change_a_run(cell, client, stranger, undisturbed, wait_until, topic):
    """An idle state closed the log and lost 122 of 179 balls; forged error motions and a forged verdict were the
    result; a forged run replaced that of the sequencer; a forged problem ended the run. Named once, in a warning."""
    forger, (kind, profile, messages) = Forger(stranger), FORGED[topic]
    recorder = cell.processes['recorder']
    said = len(recorder.text())
    forged, taken = [], taken_by(client, topic)

    def join(run_id):
        forged.extend(messages(run_id))
        publishers.append(forger.publish(kind, topic, profile, *forged))

    def is_named():  # a status is not kept for those who discover its publisher later
        for message in forged:
            publishers[0].publish(message)
        return f' publishes on {topic} is not used: it is not the ' in recorder.text()[said:]

    publishers = []
    outcome, told = disturbed_run(client, cell, join, lambda: None, lambda told: True)
    wait_until(is_named)
    forger.leave()
    assert outcome.success, outcome.message
    assert not is_held(told) and '2 nodes' not in outcome.message
    assert recorder.text()[said:].count(f' publishes on {topic} is not used') == 1
    assert topic != names.RUN_STATE or all(message in taken for message in forged)
    log = read_log(outcome.log)
    assert len(log.runs[outcome.run_id].answers) == TOTAL
    assert log.states[-1].phase == Phase.DONE
    assert outcome.verdict.sentence == undisturbed.verdict.sentence
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)


@pytest.mark.parametrize('name', names.SINGLE)
def test_a_second_node_of_a_role_ends_and_disturbs_nothing(cell, client, undisturbed, module_domain_id, name):
    """Beside a run, in one line with host and process of the first: the recorder took it for a restart, closed the log,
    and the client said that the sequencer was restarted."""
    seconds = []

    def join(_):
        seconds.append(subprocess.Popen(
            [sys.executable, '-m', MODULES[name], '--ros-args', '-r', '__ns:=/rosette', '-p', 'use_sim_time:=true'],
            env=cell_environment(module_domain_id), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True))

    outcome, told = disturbed_run(client, cell, join, None, None, f'{WAIT}\nrepeats: 30')
    _, said = seconds[0].communicate(timeout=300)
    where = f'process {cell.processes[name].popen.pid} on {socket.gethostname()}'
    assert (seconds[0].returncode, [line for line in said.splitlines() if not line.startswith('[')]) == (2, [
        f'{name}: expected no other {name} in the namespace /rosette of this domain, found {where}, which runs; end '
        'that '
        'one, or give this one a namespace or domain of its own'])
    assert outcome.success, outcome.message
    assert outcome.message == undisturbed.message and not is_held(told)
    assert outcome.log.name == outcome.run_id and read_log(outcome.log).states[-1].phase == Phase.DONE
    assert client.calibrate(check=cell.check).success


def test_a_target_of_another_node_is_not_measured(cell, client, stranger, undisturbed):
    """The CMM obeys the process that asks, holds while there are two, and says so; what it then did not take is asked
    again."""
    forger, cmm = Forger(stranger), cell.processes[names.CMM]
    said = len(cmm.text())

    def join(run_id):
        forger.publish(ProbeTarget, names.PROBE_TARGET, qos.TARGET, ProbeTarget(
            header=Header(frame_id='machine'), run_id=run_id, seq=9999, balls=N, radius=0.1825, table_position=1,
            ball=1, cmm_position=1))

    outcome, _ = disturbed_run(client, cell, join, forger.leave, lambda told: (
        is_held(told) and '2 nodes publish /rosette/probe_target' in cmm.text()[said:]))
    assert outcome.success, outcome.message
    assert '2 nodes publish /rosette/probe_target' in outcome.message
    assert not [answer for answer in read_log(outcome.log).answers if answer.seq == 9999]
    assert np.array_equal(outcome.error_motions.values, undisturbed.error_motions.values)


def test_a_cmm_without_status_follows_one_with_a_status(cell_of, domain_id, make_peer, wait_until):
    """The simulated CMM has gone, another that publishes no status answers: it is accepted."""
    with cell_of(3, simulated_time=False, sequencer={'repeats': 0}) as cell, CellClient(domain_id) as client:
        cell.processes['cmm'].popen.terminate()
        wait_until(lambda: 'no CMM' in cell.processes['sequencer'].text())
        said = len(cell.processes['sequencer'].text())
        peer = make_peer(domain_id)
        perfect = Forger(peer)
        perfect.answer(lambda: peer.node.get_clock().now().to_msg())
        peer.start()
        try:
            wait_until(lambda: names.COMPLETE in cell.processes['sequencer'].text()[said:])
            outcome = client.calibrate(options='limits.answer_timeout_s: 5.0')
        finally:
            peer.stop()
    assert outcome.success, outcome.message
    assert perfect.answered >= 16


def test_a_second_cell_does_not_start(cell, module_domain_id, tmp_path):
    """In words, and the first one does not notice."""
    said = len(cell.processes['sequencer'].text())
    with pytest.raises(CellError, match=rf'cell: expected no cell in domain {module_domain_id} and namespace /rosette, '
                                        'found sequencer, cmm, evaluator, recorder; end that one, or give this one'):
        refuse_second_cell(Console(), Cell(module_domain_id, log_dir=tmp_path))
    assert cell.processes['sequencer'].text()[said:] == ''
    refuse_second_cell(Console(), Cell(module_domain_id, 'another', log_dir=tmp_path))


def test_a_cell_starts_beside_the_cmm_that_it_is_for(domain_id, make_peer, tmp_path):
    """A node named cmm that runs already is no second cell of one without a simulation."""
    cmm = make_peer(domain_id, name=names.CMM)
    status = DiagnosticStatus(name='rosette/cmm', values=[KeyValue(key='process', value='cmm of somebody else')])
    publisher = cmm.node.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATUS)
    cmm.node.create_timer(qos.STATUS_PERIOD, lambda: publisher.publish(DiagnosticArray(status=[status])))
    cmm.start()
    others = [name for name in MODULES if name != names.CMM]
    refuse_second_cell(Console(), Cell(domain_id, nodes=others, log_dir=tmp_path))
    with pytest.raises(CellError, match='found cmm; end that one'):
        refuse_second_cell(Console(), Cell(domain_id, log_dir=tmp_path))
    cmm.stop()

# SPDX-License-Identifier: Apache-2.0
"""A run whose table always turns clockwise, in a live cell: with an ordinary run it gives the reversal."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosette_msgs.msg import JointEvaluation
from rosette_msgs.srv import EvaluateJointly

from rosette_ros.cell.client import CellClient
from rosette_ros.core.run.errors import CellError
from rosette_ros.io.log_reader import iter_log, read_log

pytestmark = pytest.mark.long

N = 6
BACKLASH = {'kind': 'table_backlash', 'width_urad': 5.0}


def joint_messages(log):
    """Return the joint evaluations in a log."""
    return [deserialize_message(entry.data, JointEvaluation) for entry in iter_log(log)
            if entry.topic == '/rosette/joint_evaluation']


def test_runs_of_both_senses_give_the_reversal(domain_id, cell_of, make_peer, wait_until):
    """Measured as planned, position 1 too; of three runs the two that are named give the backlash."""
    with cell_of(N, groups={'hidden': [BACKLASH]}), CellClient(domain_id) as client:
        first, other = (client.calibrate(order=order) for order in ('row', 'diagonal'))
        second = client.calibrate(order='row', turning='clockwise', joint_with=[first.run_id])
        run = read_log(second.log).to_run()
        assert run.approach.tolist() == [-1] * N * N
        moved = np.diff(run.table_travel)
        assert np.all(moved < 1e-3) and moved.sum() == pytest.approx(-5 * np.pi / 3, abs=1e-3)
        peer = make_peer(domain_id)
        asked = peer.node.create_client(EvaluateJointly, 'evaluator/evaluate_jointly')
        peer.start()
        assert asked.wait_for_service(20.0)
        future = asked.call_async(EvaluateJointly.Request(run_ids=[first.run_id, second.run_id]))
        wait_until(future.done)
        peer.stop()
    answer = future.result()
    assert answer.success, answer.message
    found = answer.evaluation
    assert list(found.run_ids) == [first.run_id, second.run_id] and other.run_id not in found.run_ids
    assert sorted(curves.sense for curves in found.curves) == [-1, 1]
    (reversal,) = found.reversals
    assert reversal.mean[5] == pytest.approx(5e-6, abs=4 * reversal.u_mean[5])
    assert 4 * reversal.u_mean[5] < 2.5e-6
    assert any('reversal' in words for words in found.known) and len(reversal.angle) == N and not found.notes
    logged, *_ = joint_messages(second.log)
    assert list(logged.run_ids) == [first.run_id, second.run_id]
    assert second.message == f'error motions are published; jointly with {first.run_id}: {logged.verdict}'
    assert second.is_joint and logged.verdict == found.verdict and logged.reversals[0].crz == found.reversals[0].crz


def test_runs_that_are_not_kept_are_told_at_the_end(domain_id, cell_of):
    """The run is measured and evaluated; names that are no names are refused before it begins."""
    with cell_of(N), CellClient(domain_id) as client:
        with pytest.raises(CellError, match="joint_with: expected names of finished runs, each once, found .'a', 'a'."):
            client.calibrate(joint_with=['a', 'a'])
        done = client.calibrate(joint_with=['another'])
    assert done.success and done.error_motions is not None and not done.is_joint
    assert done.message.startswith(
        f'error motions are published; jointly with another: run_id: expected one of {done.run_id}')
    assert joint_messages(done.log) == []

# SPDX-License-Identifier: Apache-2.0
"""The table corrector over DDS: poses for joint states, points by a service, refusals in words."""

import subprocess
import sys

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosette_msgs.srv import CorrectPoint
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from rosette_ros.cell.supervisor import cell_environment
from rosette_ros.core.run.geometry import TWO_PI, Frame, rotate_z, rotation_matrix
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.correction_file import format_correction

NODE = [sys.executable, '-m', 'rosette_ros.nodes.table_corrector', '--ros-args', '-r', '__ns:=/rosette']


@pytest.fixture(scope='module')
def correction():
    """Return a correction with curves of a few micrometres and microradian, other ones backward."""
    angle = TWO_PI * np.arange(12) / 12
    draw = np.random.default_rng(1)
    both = [ErrorMotions(angle, 5e-6 * draw.standard_normal((12, 6)), np.full((12, 6), 1e-7)) for _ in range(2)]
    return Correction(*both, run_id='run 7')


@pytest.fixture(scope='module')
def file(correction, tmp_path_factory):
    """Return the path of its file."""
    path = tmp_path_factory.mktemp('correction') / 'c.yaml'
    path.write_text(format_correction(correction))
    return path


@pytest.fixture(scope='module')
def peer(module_domain_id, file, make_peer):
    """Yield a Peer beside a running corrector, whose joint counts backwards from 0.5 rad."""
    parameters = {'correction': file, 'joint': 'turntable', 'sign': -1, 'zero_rad': 0.5}
    process = subprocess.Popen(
        [*NODE, *(part for name, value in parameters.items() for part in ('-p', f'{name}:={value}'))],
        env=cell_environment(module_domain_id), stdout=subprocess.DEVNULL)
    made = make_peer(module_domain_id)
    made.listen('/tf', 'tf2_msgs/msg/TFMessage')
    made.joints = made.node.create_publisher(JointState, 'joint_states', 10)
    made.point = made.node.create_client(CorrectPoint, 'table_corrector/correct_point')
    made.start()
    yield made
    made.stop()
    process.terminate()
    assert process.wait(60) == 0


def test_each_joint_state_gives_the_pose_at_its_time(peer, correction, wait_until):
    """In the frame of the ideal joint, by the sense in which the table came; other joints count for nothing."""
    def turn(seconds, *positions):
        before = len(peer.heard['/tf'])
        message = JointState(name=['arm', 'turntable'], position=[9.0, *positions])
        message.header.stamp.sec = seconds
        peer.joints.publish(message)
        return before

    wait_until(lambda: (turn(1, 0.4), peer.heard['/tf'])[1])
    turn(2)  # without a position
    for seconds, position, sense in ((3, 0.2, 1), (4, 0.1, 1), (5, 0.3, -1)):
        turn(seconds, position)

        def found(seconds=seconds):
            every = [deserialize_message(data, TFMessage).transforms[0] for data in peer.heard['/tf']]
            return [one for one in every if one.header.stamp.sec == seconds]

        wait_until(found)
        pose = found()[0]
        assert (pose.header.frame_id, pose.child_frame_id) == ('table_nominal', 'table_corrected')
        angle = 0.5 - position
        shift, turned = correction.pose(angle, sense)
        got, rotation = pose.transform.translation, pose.transform.rotation
        assert (got.x, got.y, got.z) == tuple(shift)
        wanted = Frame(rotation_matrix(turned), shift).quaternion()
        assert (rotation.x, rotation.y, rotation.z, rotation.w) == tuple(wanted)
        point = np.array([0.2, 0.1, 0.0])
        body = rotate_z(angle, rotation_matrix(turned) @ point + shift)
        np.testing.assert_allclose(correction.point(angle, point, sense), body, atol=1e-10)


def test_a_point_is_corrected(peer, correction, wait_until):
    """As offline, bit for bit; what is not finite is refused."""
    assert peer.point.wait_for_service(20)

    def ask(**fields):
        request = CorrectPoint.Request(angle=fields.get('angle', 1.2), sense=fields.get('sense', 0))
        request.point.x, request.point.y, request.point.z = 0.2, -0.1, 0.03
        future = peer.point.call_async(request)
        wait_until(future.done)
        return future.result()

    for sense in (0, 1, -1):
        answer = ask(sense=sense)
        assert answer.success
        wanted = correction.point(1.2, [0.2, -0.1, 0.03], sense or 1)
        assert (answer.corrected.x, answer.corrected.y, answer.corrected.z) == tuple(wanted)
    assert ask(angle=float('nan')).message == 'expected a finite angle and point, found nan rad and (0.2, -0.1, 0.03)'


@pytest.mark.parametrize(('parameters', 'words'), [
    ({}, 'correction: expected a correction file (rosette correct RUN --for ros), found none'),
    ({'correction': '/nowhere'}, '/nowhere: expected a correction file that can be read, found No such file'),
    ({'sign': 0}, 'sign: expected 1 or -1, found 0')])
def test_what_it_cannot_run_with_is_refused(module_domain_id, file, parameters, words):
    """In one line; it ends with 2."""
    given = {'correction': str(file), **parameters} if parameters else {}
    outcome = subprocess.run(
        [*NODE, *(part for name, value in given.items() for part in ('-p', f'{name}:={value}'))],
        env=cell_environment(module_domain_id), capture_output=True, text=True, timeout=300, check=False)
    assert outcome.returncode == 2
    assert words in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1


def test_arguments_that_ros_does_not_know_are_refused(module_domain_id):
    """By every node, in a line."""
    outcome = subprocess.run([*NODE, '--nonsense'], env=cell_environment(module_domain_id), capture_output=True,
                             text=True, timeout=300, check=False)
    assert outcome.returncode == 2
    assert outcome.stderr == ("table_corrector: ROS refuses the arguments or the environment: ['--nonsense']\n")

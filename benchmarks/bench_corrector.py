# SPDX-License-Identifier: Apache-2.0
"""The table corrector: from a joint state to its transform and back, beside a node that only answers."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RATES, SECONDS, DOMAIN = (250, 1000), 5.0, 97
ECHO = '''
import rclpy
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage
from geometry_msgs.msg import TransformStamped
from rosette_ros.nodes.base_node import make_executor
rclpy.init()
node = rclpy.create_node('echo')
out = node.create_publisher(TFMessage, '/tf', 100)
def answer(message):
    one = TransformStamped()
    one.header.stamp = message.header.stamp
    out.publish(TFMessage(transforms=[one]))
node.create_subscription(JointState, '/rosette/joint_states', answer, 10)
executor = make_executor()
executor.add_node(node)
while True:
    executor.spin_once(timeout_sec=1.0)
'''


def measure(command):
    """Print rate and round trip of a process that answers joint states with transforms."""
    import rclpy
    from sensor_msgs.msg import JointState
    from tf2_msgs.msg import TFMessage

    from rosette_ros.cell.supervisor import cell_environment
    from rosette_ros.nodes.base_node import make_executor
    process = subprocess.Popen(command, env=cell_environment(DOMAIN), stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node('bench', context=context)
    executor = make_executor(context)
    executor.add_node(node)
    sent, trips = {}, []

    def back(message):
        stamp = message.transforms[0].header.stamp
        if (begun := sent.pop(stamp.sec * 10**9 + stamp.nanosec, None)) is not None:
            trips.append(time.perf_counter() - begun)

    node.create_subscription(TFMessage, '/tf', back, 100)
    out = node.create_publisher(JointState, '/rosette/joint_states', 10)
    for rate in RATES:
        while not trips:  # until both have found each other
            send(out, JointState, sent, 0.0)
            executor.spin_once(timeout_sec=0.1)
        sent.clear()
        trips.clear()
        begin = time.perf_counter()
        for count in range(int(rate * SECONDS)):
            send(out, JointState, sent, count / rate)
            while (left := begin + (count + 1) / rate - time.perf_counter()) > 0:
                executor.spin_once(timeout_sec=left)
        until = time.perf_counter() + 1
        while sent and time.perf_counter() < until:
            executor.spin_once(timeout_sec=0.05)
        done = 1e3 * np.array(trips)
        print(f'   {rate:5d} joint states a second: {done.size} of {int(rate * SECONDS)} answered, round trip median '
              f'{np.median(done):.2f} ms, 99 % below {np.quantile(done, 0.99):.2f} ms')
        trips.clear()
    process.terminate()
    process.wait()
    rclpy.try_shutdown(context=context)


def send(out, kind, sent, angle):
    """Publish a joint state and note when."""
    stamp = time.time_ns()
    message = kind(name=['table'], position=[angle])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    sent[stamp] = time.perf_counter()
    out.publish(message)


def main():
    """Print both."""
    from rosette_ros.analysis import analyse
    from rosette_ros.core.run.scheme import plan
    from rosette_ros.core.table.correction import Correction
    from rosette_ros.io.correction_file import format_correction
    from rosette_ros.simulation import Machine, MachineConfig
    motions = analyse(Machine(MachineConfig()).run(plan(12, 'diagonal'))).error_motions
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'c.yaml'
        path.write_text(format_correction(Correction(motions, motions)), encoding='utf-8')
        print('   a node that only answers')
        measure([sys.executable, '-c', ECHO])
        print(f'   table_corrector, n = 12 ({os.cpu_count()} cores)')
        measure([sys.executable, '-m', 'rosette_ros.nodes.table_corrector', '--ros-args', '-r', '__ns:=/rosette', '-p',
                 f'correction:={path}'])


if __name__ == '__main__':
    main()

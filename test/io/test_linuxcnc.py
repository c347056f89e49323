# SPDX-License-Identifier: Apache-2.0
"""A LinuxCNC without a screen reads the compensation file and turns motor and table to the corrected angles."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

from rosette_ros.core.run.geometry import TWO_PI
from rosette_ros.core.run.records import ErrorMotions
from rosette_ros.core.table.correction import Correction
from rosette_ros.io.controller_tables import Axis, linuxcnc

pytestmark = pytest.mark.skipif(not shutil.which('linuxcnc') or not Path('/usr/bin/python3').exists(),
                                reason='LinuxCNC is not installed (Debian: linuxcnc-uspace)')
LOW, HIGH = -360, 450
ANGLES = (30, 60, 96, 402, 198, 96, 60, 30, -102)
AXIS = f'MIN_LIMIT = {LOW}\nMAX_LIMIT = {HIGH}\nMAX_VELOCITY = 3000\nMAX_ACCELERATION = 30000\n'
CONFIGURATION = f'''[EMC]
VERSION = 1.1
[DISPLAY]
DISPLAY = ./display.py
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = machine.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 10.0
SERVO_PERIOD = 1000000
[HAL]
HALFILE = machine.hal
[TRAJ]
COORDINATES = C
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_ANGULAR_VELOCITY = 3000
DEFAULT_ANGULAR_VELOCITY = 3000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.01
[KINS]
KINEMATICS = trivkins coordinates=C
JOINTS = 1
[AXIS_C]
{AXIS}[JOINT_0]
TYPE = ANGULAR
{AXIS}FERROR = 5
MIN_FERROR = 5
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
COMP_FILE = table.comp
COMP_FILE_TYPE = 1
'''
HAL = '''loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net motor joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
'''
DISPLAY = '''#!/usr/bin/python3
import subprocess, sys, time, linuxcnc
command, status = linuxcnc.command(), linuxcnc.stat()

def pin(name):
    return float(subprocess.run(['halcmd', 'getp', name], capture_output=True, text=True, check=True).stdout)

def wait(condition):
    end = time.monotonic() + 60
    while not condition():
        if time.monotonic() > end:
            sys.exit('expected an end of the move within 60 s')
        time.sleep(0.02)
        status.poll()

command.state(linuxcnc.STATE_ESTOP_RESET)
command.state(linuxcnc.STATE_ON)
command.wait_complete()
status.poll()
command.mode(linuxcnc.MODE_MANUAL)
command.wait_complete()
command.teleop_enable(0)
command.wait_complete()
command.home(0)
wait(lambda: status.homed[0])
command.mode(linuxcnc.MODE_MDI)
command.wait_complete()
with open('seen.txt', 'w') as seen:
    for angle in %r:
        command.mdi(f'G0 C{angle}')
        command.wait_complete(60)
        before = [None]
        def is_still():
            last, before[0] = before[0], pin('joint.0.motor-pos-cmd')
            return last == before[0] and abs(pin('joint.0.pos-fb') - angle) < 1e-4
        wait(is_still)
        print(angle, pin('joint.0.motor-pos-cmd'), pin('joint.0.pos-fb'), file=seen)
'''


def test_motor_and_table_turn_to_the_corrected_angles(tmp_path):
    """In both senses, beyond a turn and below zero; the error that the motor makes good is 9 mrad, 16 backwards."""
    angle = TWO_PI * np.arange(12) / 12
    both = []
    for size in (0.009, 0.016):
        values = np.zeros((12, 6))
        values[:, 5] = size * np.sin(angle + 1)
        both.append(ErrorMotions(angle, values, np.full((12, 6), 1e-7)))
    correction = Correction(*both, ('crz',))
    (tmp_path / 'table.comp').write_text(linuxcnc(correction, LOW, HIGH, 6, Axis())[0])
    (tmp_path / 'machine.ini').write_text(CONFIGURATION)
    (tmp_path / 'machine.hal').write_text(HAL)
    (tmp_path / 'display.py').write_text(DISPLAY % (ANGLES,))
    (tmp_path / 'display.py').chmod(0o755)
    plain = {name: value for name, value in os.environ.items() if name not in ('LD_LIBRARY_PATH', 'PYTHONPATH')}
    with tempfile.TemporaryDirectory() as folder:  # which the real-time part can enter, where root has started it
        Path(folder).chmod(0o777)
        root = {'RTAPI_UID': '65534', 'RTAPI_FIFO_PATH': f'{folder}/fifo'} if os.geteuid() == 0 else {}
        done = subprocess.run(['linuxcnc', '-r', 'machine.ini'], cwd=tmp_path, capture_output=True, text=True,
                              env={**plain, 'HOME': str(tmp_path), **root}, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    wanted, motor, table = np.loadtxt(tmp_path / 'seen.txt', unpack=True)
    assert wanted.tolist() == [*ANGLES]
    np.testing.assert_allclose(table, wanted, atol=1e-4)
    senses = np.where(np.diff(wanted, prepend=0) > 0, 1, -1)
    error = [float(correction.errors(np.deg2rad(one), int(sense))[0, 5]) for one, sense in zip(wanted, senses)]
    np.testing.assert_allclose(motor + np.rad2deg(error), wanted, atol=1e-4)  # where the table then really stands

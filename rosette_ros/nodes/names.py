# SPDX-License-Identifier: Apache-2.0
"""Every name that the cell uses on the graph, once. Names without a slash are relative."""

import os
from collections.abc import Iterable

SEQUENCER, CMM, EVALUATOR, RECORDER = 'sequencer', 'cmm', 'evaluator', 'recorder'
NODES = (SEQUENCER, CMM, EVALUATOR, RECORDER)
SINGLE = (SEQUENCER, EVALUATOR, RECORDER)
"""Nodes that end where another one of their name runs; while there are two CMMs, neither is used."""
NEEDED = (CMM, RECORDER)
"""Nodes whose problems prevent a calibration; a problem of the evaluator is one of a single run."""
NAMESPACE = 'rosette'
DOMAINS = range(233)
"""ROS domains whose ports DDS can use; another one ends the process."""

PROBE_TARGET, BALL_CENTRE, TOUCHES = 'probe_target', 'ball_centre', 'touches'
ERROR_MOTIONS, MODEL, DIAGNOSIS = 'error_motions', 'model', 'diagnosis'
RUN, RUN_STATE, CALIBRATION_EVENT = 'run', 'run_state', 'calibration_event'

PUBLISHERS = {PROBE_TARGET: SEQUENCER, CALIBRATION_EVENT: SEQUENCER, BALL_CENTRE: CMM, TOUCHES: CMM}
"""The one node that publishes each topic of a run; while another one does, too, nothing there is used."""
SIGNED = {RUN: SEQUENCER, RUN_STATE: SEQUENCER, ERROR_MOTIONS: EVALUATOR, MODEL: EVALUATOR, DIAGNOSIS: EVALUATOR}
"""Likewise, where messages name the process that publishes them: those of another one are not used."""

CALIBRATE, CALIBRATE_FEEDBACK, CALIBRATE_STATUS = 'calibrate', 'calibrate/_action/feedback', 'calibrate/_action/status'
START_CALIBRATION, CANCEL_CALIBRATION = 'start_calibration', 'cancel_calibration'
START_RECORDING, STOP_RECORDING = 'recorder/start_recording', 'recorder/stop_recording'
RECALL, RECORDED = 'recorder/recall', 'recorder/recorded'
DIAGNOSE, ADD_EFFECT, REMOVE_EFFECT = 'evaluator/diagnose', 'evaluator/add_effect', 'evaluator/remove_effect'
NEXT_READINGS = 'evaluator/next_readings'
EVALUATE_JOINTLY, JOINT_EVALUATION = 'evaluator/evaluate_jointly', 'joint_evaluation'
TRIAL = 'check'
"""Begin of the name of a node that tries the CMM in place of a sequencer (rosette check-cmm)."""
RECOVER, CHECK_PLAN = 'cmm/recover', 'cmm/check_plan'
"""Of a CMM that waits for a person, and of one that knows what it can measure."""
SERVICE_EVENT = '/_service_event'

SERVERS = {START_RECORDING: RECORDER, STOP_RECORDING: RECORDER, RECALL: RECORDER, RECORDED: RECORDER,
           NEXT_READINGS: EVALUATOR, EVALUATE_JOINTLY: EVALUATOR, CHECK_PLAN: CMM}
"""The one node that offers each service of a run; while another one does, too, nothing is asked of either."""

TABLE_CORRECTOR, JOINT_STATES, CORRECT_POINT = 'table_corrector', 'joint_states', 'table_corrector/correct_point'
"""The node that applies a correction; it runs beside robots and machines, not in the calibration cell."""

TF, TF_STATIC, CLOCK, DIAGNOSTICS = '/tf', '/tf_static', '/clock', '/diagnostics'
ROSOUT, PARAMETER_EVENTS = '/rosout', '/parameter_events'
OF_A_DOMAIN = (TF, TF_STATIC, CLOCK)
"""Frames and time: all nodes of a ROS domain share them, unless they are remapped."""

READY = 'ready'  # a node logs this word when its interfaces are created
COMPLETE = 'the cell is complete'
"""The sequencer logs this sentence when every node that a calibration needs is present."""

PARENT_PID = 'ROSETTE_CELL_PID'  # environment variable, set by cell.supervisor: a node ends when this process does


def where(domain: int, namespace: str) -> list[str]:
    """Return the arguments by which a command of `rosette` finds a cell, typed in this terminal or in another one.

    Domain 0 is left out only where the environment names none, as that of other terminals then."""
    space, is_default = namespace.strip('/'), not domain and not os.environ.get('ROS_DOMAIN_ID')
    return ['--domain', str(domain)] * (not is_default) + ['--namespace', space] * (space != NAMESPACE)


def remappings(namespace: str) -> tuple[tuple[str, str], ...]:
    """Return the pairs (name, name instead) by which a cell has frames and time of its own.

    None in the namespace that is the default: there the names are those that ROS tools expect."""
    return () if namespace.strip('/') == NAMESPACE else tuple((name, name.lstrip('/')) for name in OF_A_DOMAIN)


def is_of_cell(logger: str, namespace: str) -> bool:
    """Return whether a logger, by the name in rcl_interfaces/Log, is that of a node in a namespace."""
    return f'{logger}.'.startswith(f'{namespace.strip("/").replace("/", ".")}.') or not namespace.strip('/')


def remap_arguments(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Return the arguments of a node for pairs (name, name instead); they come behind --ros-args."""
    return [part for old, new in pairs for part in ('-r', f'{old}:={new}')]


def enclave(namespace: str, node: str) -> str:
    """Return the name under which SROS2 keeps the keys and the permissions of a node."""
    return f'/{namespace.strip("/")}/{node}'.replace('//', '/')

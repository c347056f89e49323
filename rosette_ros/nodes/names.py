# SPDX-License-Identifier: Apache-2.0
"""Every name that the cell uses on the graph, once. Names without a slash are relative."""

SEQUENCER, CMM, EVALUATOR, RECORDER = 'sequencer', 'cmm', 'evaluator', 'recorder'
NODES = (SEQUENCER, CMM, EVALUATOR, RECORDER)
NAMESPACE = 'rosette'

PROBE_TARGET = 'probe_target'
BALL_CENTRE = 'ball_centre'
ERROR_MOTIONS = 'error_motions'
MODEL = 'model'
DIAGNOSIS = 'diagnosis'
RUN_STATE = 'run_state'
CALIBRATION_EVENT = 'calibration_event'

CALIBRATE = 'calibrate'
CALIBRATE_FEEDBACK = 'calibrate/_action/feedback'
CALIBRATE_STATUS = 'calibrate/_action/status'
START_CALIBRATION = 'start_calibration'
START_RECORDING = 'recorder/start_recording'
STOP_RECORDING = 'recorder/stop_recording'
DIAGNOSE = 'evaluator/diagnose'
ADD_EFFECT = 'evaluator/add_effect'
REMOVE_EFFECT = 'evaluator/remove_effect'
SERVICE_EVENT = '/_service_event'

TF_STATIC = '/tf_static'
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'
ROSOUT = '/rosout'
PARAMETER_EVENTS = '/parameter_events'

READY = 'ready'
"""A node logs this word when its interfaces stand."""
COMPLETE = 'the cell is complete'
"""The sequencer logs this sentence when it sees every part that a calibration needs."""

PARENT_PID = 'ROSETTE_CELL_PID'
"""Environment variable: process whose end is the end of a node, set by cell.Cell."""

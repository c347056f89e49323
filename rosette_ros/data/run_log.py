# SPDX-License-Identifier: Apache-2.0
"""A Run into a log: what `rosette import` writes, readable by every ROS tool."""

from pathlib import Path

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import nominal_angles
from rosette_ros.data.assemble import STATUS_OK, TABLE_FRAME, Phase
from rosette_ros.data.bag_metadata import Qos
from rosette_ros.data.cdr import encode_columns
from rosette_ros.data.log_reader import (
    BALL_CENTRE,
    DOF_KEY,
    PROBE_TARGET,
    REPEATABILITY_KEY,
    REPEATS_KEY,
)
from rosette_ros.data.ros2msg import parse_schema
from rosette_ros.data.whole_log import whole_log

TARGET_TOPIC, ANSWER_TOPIC = '/rosette/probe_target', '/rosette/ball_centre'
MAX_SECONDS = 2**31
"""Seconds that a ROS time stamp can hold."""
LATCHED = Qos(durability='transient_local')


def write_log(run, directory, library, name=None):
    """Write a Run as a log directory and return its path.

    library: schemas.TypeLibrary that knows rosette_msgs; name: of the files, else the run_id or
    the name of the directory. Each reading becomes a ProbeTarget and a BallCentre in the table
    frame; the repeatability goes to custom_data. Times are kept to 1 ns, counted from 0.

    Raises InvalidData where the directory holds a log, or the run is longer than stamps can tell, CellError where
    the disk refuses; nothing is left then.
    """
    directory = Path(directory)
    if run.time[-1] - run.time[0] >= MAX_SECONDS:
        raise InvalidData(f'{run.source}: time: wanted a run of less than {MAX_SECONDS} s, got '
                          f'{run.time[-1] - run.time[0]:g} s; a ROS stamp cannot hold more')
    stamp = np.rint((run.time - run.time[0]) * 1e9).astype(np.int64)
    run_id = run.run_id or directory.name
    kinds = {TARGET_TOPIC: PROBE_TARGET, ANSWER_TOPIC: BALL_CENTRE}
    messages = {}
    with whole_log(directory, name or directory.name, custom_data=_known(run)) as writer:
        for topic, columns in _columns(run, run_id, stamp).items():
            definition = library.definition(kinds[topic])
            writer.add_topic(topic, definition, (LATCHED if topic == TARGET_TOPIC else Qos(),))
            schema = parse_schema(definition.name, definition.text)
            messages[topic] = encode_columns(schema, columns, run.size)
        for row, time in enumerate(stamp.tolist()):
            for topic, data in messages.items():
                writer.write(topic, data[row].tobytes(), time, time)
    return directory


def _columns(run, run_id, stamp):
    """Return the fields of both messages by topic."""
    common = {
        'header.stamp.sec': stamp // 10**9, 'header.stamp.nanosec': stamp % 10**9,
        'header.frame_id': TABLE_FRAME, 'run_id': run_id, 'seq': np.arange(1, run.size + 1),
        'table_position': run.table_position, 'ball': run.ball, 'cmm_position': run.cmm_position,
        'approach': run.approach}
    target = {
        **common, 'attempt': 1, 'session': run.session, 'phase': int(Phase.RUN), 'balls': run.n, 'radius': run.radius,
        'table_angle': nominal_angles(run.n)[run.table_position - 1],
        'centre.x': run.radius * np.cos(run.alpha), 'centre.y': run.radius * np.sin(run.alpha)}
    answer = {
        **common, 'status': STATUS_OK, 'table_angle': run.table_angle,
        'table_travel': run.table_travel, 'temperature': run.temperature,
        **{f'centre.{axis}': run.centre[:, column] for column, axis in enumerate('xyz')}}
    return {TARGET_TOPIC: target, ANSWER_TOPIC: answer}


def _known(run):
    known = {'rosette.source': str(run.source)}
    if run.repeats:
        known[REPEATS_KEY] = 'yes'
    if run.repeatability is not None:
        known[REPEATABILITY_KEY] = repr(float(run.repeatability))
        if run.repeatability_dof is not None:
            known[DOF_KEY] = repr(float(run.repeatability_dof))
    return known

# SPDX-License-Identifier: Apache-2.0
"""A Run into a log: what `rosette import` writes, readable by every ROS tool."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import Floats, Frame, Ints, rotate_z
from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import nominal_places
from rosette_ros.io import log_run
from rosette_ros.io.bag_metadata import Qos
from rosette_ros.io.log_writer import encode_messages, whole_log
from rosette_ros.io.messages import MACHINE_FRAME, STATUS_OK, TABLE_FRAME, Phase
from rosette_ros.io.type_definitions import StoredTypes, TypeLibrary

TARGET_TOPIC, ANSWER_TOPIC, FRAME_TOPIC = '/rosette/probe_target', '/rosette/ball_centre', '/tf_static'
MAX_SECONDS = 2**31  # seconds that a ROS time stamp can hold
LATCHED = Qos(durability='transient_local')


def write_log(run: Run, directory: str | Path, library: TypeLibrary | StoredTypes, said: Sequence[str] = ()) -> Path:
    """Write a Run as a log directory and return its path.

    library: knows rosette_msgs; said: how the readings were read and what is doubtful in them, in words. Each reading
    becomes a ProbeTarget and a BallCentre in the table frame; the rotation of that, where it is known, goes to
    /tf_static, the repeatability, and what is said, to custom_data. Times are kept to 1 ns, from 0 on, or from
    the date on that a table says.

    Raises InvalidData where the directory holds a log, or the run is longer than stamps can hold, CellError where
    the disk refuses; nothing is left then."""
    directory = Path(directory)
    if (run.begun or 0.0) + run.time[-1] - run.time[0] >= MAX_SECONDS:
        raise InvalidData(f'{run.source}: time: expected a run of less than {MAX_SECONDS} s, found '
                          f'{run.time[-1] - run.time[0]:g} s; a ROS stamp cannot hold more')
    stamp = round((run.begun or 0.0) * 1e9) + np.rint((run.time - run.time[0]) * 1e9).astype(np.int64)
    targets, answers = zip(*_messages(run, run.run_id or directory.name, stamp), strict=True)
    messages = {}
    with whole_log(directory, directory.name, custom_data=_known(run, said)) as writer:
        for topic, type_name, qos, rows in ((TARGET_TOPIC, log_run.PROBE_TARGET, LATCHED, targets),
                                            (ANSWER_TOPIC, log_run.BALL_CENTRE, Qos(), answers)):
            definition = library.definition(type_name)
            writer.add_topic(topic, definition, (qos,))
            messages[topic] = encode_messages(definition, rows)
        if (rotation := run.from_angle_zero()[1]) is not None:
            definition = library.definition(log_run.TF_MESSAGE)
            writer.add_topic(FRAME_TOPIC, definition, (LATCHED,))
            writer.write(FRAME_TOPIC, encode_messages(definition, [_frame_message(rotation)])[0], *2 * [int(stamp[0])])
        for row, time in enumerate(stamp.tolist()):
            for topic, data in messages.items():
                writer.write(topic, data[row], time, time)
    return directory


def _messages(run: Run, run_id: str, stamp: Ints) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    expected = rotate_z(run.table_offset, nominal_places(run.n, run.radius, run.table_position, run.ball))
    centre, _ = run.from_angle_zero()
    for row in range(run.size):
        seconds, rest = divmod(int(stamp[row]), 10**9)
        common = {
            'header': {'stamp': {'sec': seconds, 'nanosec': rest}, 'frame_id': TABLE_FRAME}, 'run_id': run_id,
            'seq': row + 1, 'table_position': run.table_position[row], 'ball': run.ball[row],
            'cmm_position': run.cmm_position[row], 'approach': run.approach[row]}
        yield (
            {**common, 'attempt': 1, 'session': run.session[row], 'phase': Phase.RUN, 'balls': run.n,
             'radius': run.radius, 'table_angle': run.phi[row] + run.table_offset,
             'centre': dict(zip('xyz', expected[row], strict=True))},
            {**common, 'status': STATUS_OK, 'table_angle': run.table_angle[row] + run.table_offset,
             'table_travel': run.table_travel[row], 'temperature': run.temperature[row],
             'centre': dict(zip('xyz', centre[row], strict=True))})


def _frame_message(rotation: Floats) -> dict[str, Any]:
    """Return the transform of a table frame of which only the rotation is known."""
    quaternion = Frame(rotation, np.zeros(3)).quaternion().tolist()
    header = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': MACHINE_FRAME}
    return {'transforms': [{'header': header, 'child_frame_id': TABLE_FRAME, 'transform': {
        'translation': dict.fromkeys('xyz', 0.0), 'rotation': dict(zip('xyzw', quaternion, strict=True))}}]}


def _known(run: Run, said: Sequence[str]) -> dict[str, str]:
    known = {'rosette.source': str(run.source)}
    if said:
        known[log_run.NOTES_KEY] = '\n'.join(said)
    if run.simulated:
        known[log_run.SIMULATED_KEY] = 'yes'
    if run.repeatability is not None:
        known[log_run.REPEATABILITY_KEY] = repr(float(run.repeatability))
        if run.repeatability_dof is not None:
            known[log_run.DOF_KEY] = repr(float(run.repeatability_dof))
        if run.repeatability_axes is not None:
            known[log_run.AXES_KEY] = ' '.join(repr(float(one)) for one in run.repeatability_axes)
    return known

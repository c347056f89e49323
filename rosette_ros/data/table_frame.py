# SPDX-License-Identifier: Apache-2.0
"""Table frames as they are told: one that is none is refused, and two for one run, one of another machine."""

import numpy as np

from rosette_ros.core.errors import InvalidData
from rosette_ros.core.geometry import Frame
from rosette_ros.data.assemble import TABLE_FRAME, Phase

SAME = 1e-12
"""Frames whose axes (as numbers) and origins (m) differ by no more are one frame that was told twice."""
UNIT_TOLERANCE = 1e-6
"""A quaternion whose size misses 1 by more is none."""


def frame_told(quaternion, origin):
    """Return the Frame of a quaternion (x, y, z, w) and an origin (3,), m, as a message tells them.

    Raises InvalidData where the quaternion is none of unit size, or the origin is not finite.
    """
    with np.errstate(over='ignore', invalid='ignore'):
        size = float(np.sqrt(np.sum(np.square(np.asarray(quaternion, dtype=float)))))
    if not abs(size - 1) < UNIT_TOLERANCE:
        raise InvalidData(f'table frame: rotation: wanted a unit quaternion, got the size {size}')
    if not np.isfinite(np.asarray(origin, dtype=float)).all():
        raise InvalidData(f'table frame: translation: wanted finite numbers, got {tuple(origin)}')
    return Frame.from_quaternion(quaternion, origin)


def refuse_two_frames(frames, targets, answers, run_id, source):
    """Refuse a run during whose alignment two machine-to-table frames were latched that differ.

    frames: (stamp in ns, Frame) each; targets, answers: TargetTable and AnswerTable. Where every answer is in the
    table frame already, none is needed and any number may come.

    Raises InvalidData.
    """
    own = answers.run_id.equal(run_id)
    if not np.any(own & ~answers.frame_id.matching(lambda name: name.split('/')[-1] == TABLE_FRAME)):
        return
    begin, end = _alignment(targets, run_id)
    different = []
    for stamp, frame in frames:
        if begin <= stamp <= end and not any(_is_same(frame, one) for one in different):
            different.append(frame)
    if len(different) > 1:
        raise InvalidData(f'{source}: wanted one table frame for run {run_id}, got {len(different)} that differ; two '
                          'cells share /tf_static? give each its namespace or domain')


def _alignment(targets, run_id):
    """Return the stamps between which the frame of a run is found, ns: from its first target to its first of RUN.

    Where the alignment was gone on with after a pause, the session that ended it counts: what was found before
    is given up.
    """
    own = targets.run_id.equal(run_id)
    end = targets.stamp_ns[own & (targets.phase == Phase.RUN)].min()
    aligning = np.flatnonzero(own & (targets.phase == Phase.ALIGNMENT) & (targets.stamp_ns <= end))
    if aligning.size:
        own &= targets.session == targets.session[aligning[np.argmax(targets.stamp_ns[aligning])]]
    return targets.stamp_ns[own].min(), end


def _is_same(one, other):
    return (np.abs(one.rotation - other.rotation).max() <= SAME
            and np.abs(one.origin - other.origin).max() <= SAME)

# SPDX-License-Identifier: Apache-2.0
"""What a fault of the simulated cell makes of an answer. No ROS beyond the message itself."""

import copy

from rosette_msgs.msg import BallCentre

NOWHERE = 'another_run'


def distort(answer, faults, previous, now):
    """Return what is said instead of an answer: pairs of a message and when (steady s, None: now).

    faults: machine.faults.Strike; previous: the answer before this one, or None. The answer given is
    not changed; several faults act one after the other.
    """
    out = copy.deepcopy(answer)
    said, due = [], None
    for strike in faults:
        kind = strike.kind
        if kind == 'silent':
            return []
        if kind == 'late':
            due = now + strike.fault.late_s
        elif kind == 'twice':
            said.append((copy.deepcopy(out), due))
        elif kind == 'again' and previous is not None:
            said.append((copy.deepcopy(previous), due))
        else:
            _change(out, strike, kind)
    return [*said, (out, due)]


def _change(out, strike, kind):
    """Put a fault into a message."""
    if kind == 'wrong_seq':
        out.seq += 1
    elif kind == 'wrong_run':
        out.run_id = NOWHERE
    elif kind == 'not_a_number':
        out.centre.y = float('nan')
    elif kind == 'infinite':
        out.centre.z = float('inf')
    elif kind == 'failed':
        out.status, out.text = BallCentre.STATUS_FAILED, 'the stylus did not trigger'
    elif kind == 'wrong_ball':
        out.ball += 1
    elif kind == 'outlier' and out.status == BallCentre.STATUS_OK:
        shift = 1e-6 * strike.fault.size_um * strike.direction
        out.centre.x += float(shift[0])
        out.centre.y += float(shift[1])
        out.centre.z += float(shift[2])

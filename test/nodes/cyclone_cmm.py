# SPDX-License-Identifier: Apache-2.0
"""A CMM that is not ours: Eclipse Cyclone DDS on the wire, no ROS, types written out by hand.

Usage: cyclone_cmm.py DOMAIN NAMESPACE. It touches every ball exactly where it is expected, on a
table that stands 1 mm beside where it was taught, and ends with its standard input.
"""

import sys
import threading
import time
from dataclasses import dataclass, field

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int8, int32, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

OFFSET = (0.001, -0.0005, 0.0002)


@dataclass
@final
class Time(IdlStruct, typename='builtin_interfaces.msg.dds_.Time_'):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
@final
class Header(IdlStruct, typename='std_msgs.msg.dds_.Header_'):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ''


@dataclass
@final
class Point(IdlStruct, typename='geometry_msgs.msg.dds_.Point_'):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
@final
class ProbeTarget(IdlStruct, typename='rosette_msgs.msg.dds_.ProbeTarget_'):
    header: Header
    run_id: str
    seq: uint32
    attempt: uint32
    phase: uint8
    balls: uint32
    radius: float64
    table_position: uint32
    ball: uint32
    cmm_position: uint32
    table_angle: float64
    approach: int8
    centre: Point


@dataclass
@final
class BallCentre(IdlStruct, typename='rosette_msgs.msg.dds_.BallCentre_'):
    header: Header
    run_id: str
    seq: uint32
    table_position: uint32
    ball: uint32
    cmm_position: uint32
    status: uint8
    text: str
    table_angle: float64
    table_travel: float64
    approach: int8
    centre: Point
    form_error: float64
    temperature: float64


class Table:
    """A table that counts how far it has turned."""

    def __init__(self):
        self.travel, self.angle, self.approach = 0.0, 0.0, 0

    def turn_to(self, angle, approach):
        full = 2 * 3.141592653589793
        step = (angle - self.angle) % full
        if approach < 0 and step > 0:
            step -= full
        self.travel += step
        self.angle = angle
        self.approach = approach or self.approach


def answer(target, table):
    table.turn_to(target.table_angle, target.approach)
    # While the table is searched the balls lie beside their targets; later the target is right.
    off = OFFSET if target.phase in (1, 2) else (0.0, 0.0, 0.0)
    now = time.time_ns()
    return BallCentre(
        header=Header(Time(now // 10**9, now % 10**9), target.header.frame_id),
        run_id=target.run_id, seq=target.seq, table_position=target.table_position,
        ball=target.ball, cmm_position=target.cmm_position, status=0, text='cyclone',
        table_angle=target.table_angle, table_travel=table.travel, approach=table.approach,
        centre=Point(target.centre.x + off[0], target.centre.y + off[1],
                     target.centre.z + off[2]),
        form_error=1e-7, temperature=20.5)


def main(domain, namespace):
    participant = DomainParticipant(domain)
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(50),
              Policy.Durability.Volatile,
              Policy.DataRepresentation(use_cdrv0_representation=True))
    reader = DataReader(participant, Topic(participant, f'rt/{namespace}/probe_target',
                                           ProbeTarget, qos=qos))
    writer = DataWriter(participant, Topic(participant, f'rt/{namespace}/ball_centre',
                                           BallCentre, qos=qos))
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    table = Table()
    while not over.is_set():
        for target in reader.take(50):
            if getattr(target, 'run_id', None):
                writer.write(answer(target, table))
        time.sleep(0.002)


if __name__ == '__main__':
    main(int(sys.argv[1]), sys.argv[2])

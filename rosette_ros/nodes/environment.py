# SPDX-License-Identifier: Apache-2.0
"""The environment of a cell's processes: they stay on this computer and do not talk by shared memory.

A process that was killed leaves ports of its shared memory behind, by which its successor may hear nothing (Fast-DDS
issue 5053). FASTDDS_BUILTIN_TRANSPORTS alone does not keep a participant from it that stays on its computer:
rmw_fastrtps then chooses the transports itself. So these processes offer no address but one of UDP, by a profile.
"""

from pathlib import Path

RANGE, PEERS, RMW = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'RMW_IMPLEMENTATION'
TRANSPORTS, PROFILES = 'FASTDDS_BUILTIN_TRANSPORTS', 'FASTRTPS_DEFAULT_PROFILES_FILE'
FAST_DDS = ('', 'rmw_fastrtps_cpp', 'rmw_fastrtps_dynamic_cpp')
LOCAL, WIDE = 'LOCALHOST', ('SUBNET', 'SYSTEM_DEFAULT')


def added(given):
    """Return what holds for a process of a cell beyond its environment `given`, name to value.

    What is given stays. The profile is for those who stay on this computer: nobody on another one could reach them.
    """
    made = {} if given.get(RANGE) else {RANGE: LOCAL}
    if TRANSPORTS not in given:
        made[TRANSPORTS] = 'UDPv4'
    stays = (given.get(RANGE) or LOCAL) not in WIDE and not given.get(PEERS)
    if stays and given.get(RMW, '') in FAST_DDS and PROFILES not in given:
        made[PROFILES] = str(Path(__file__).with_name('fastdds.xml'))
    return made

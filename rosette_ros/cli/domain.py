# SPDX-License-Identifier: Apache-2.0
"""ROS domains and namespaces: where a cell is, so that cells do not meet by accident."""

import argparse
import os
import random
import re
import socket

from rosette_ros.cli.arguments import whole
from rosette_ros.core.errors import CellError
from rosette_ros.nodes.names import NAMESPACE

FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250
"""DDS-RTPS 2.2, section 9.6.1.1: port of discovery by multicast = 7400 + 250 domain."""
HIGHEST = 101
"""Highest domain whose ports lie below those that Linux hands out on its own."""


def add_domain(parser):
    """Add the argument --domain."""
    parser.add_argument('--domain', metavar='ID', type=whole(0, 232),
                        help='ROS domain (default: that of the environment)')


def add_namespace(parser):
    """Add the argument --namespace."""
    parser.add_argument('--namespace', metavar='NS', type=namespace, default=NAMESPACE,
                        help=f'namespace of the cell (default {NAMESPACE})')


def namespace(text):
    """Read a namespace, with or without the slash in front."""
    bare = text.strip('/')
    if not re.fullmatch(r'([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?', bare, re.ASCII):
        raise argparse.ArgumentTypeError(f'wanted a namespace such as cell2 (letters, digits and "_", none begins '
                                         f'with a digit), got {text!r}')
    return bare


def free_domain():
    """Return a domain in which nothing seems to talk on this computer.

    Raises CellError where all are in use.
    """
    candidates = random.sample(range(1, HIGHEST + 1), HIGHEST)
    for domain in candidates:
        base = FIRST_PORT + PORTS_PER_DOMAIN * domain
        if all(_is_free(base + offset) for offset in (0, 10, 11)):
            return domain
    raise CellError(f'ROS domain: wanted a free one in 1 .. {HIGHEST}, found none; end other ROS '
                    'programs or choose one with --domain')


def domain_of_environment():
    """Return the domain that ROS takes when none is given."""
    return int(os.environ.get('ROS_DOMAIN_ID') or 0)


def _is_free(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True

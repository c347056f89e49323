# SPDX-License-Identifier: Apache-2.0
"""Prints rosette_ros/io/definitions.json, the message types of an imported table: python tools/stored_types.py"""

import json
import os
import sys

from rosette_ros.io.log_run import BALL_CENTRE, PROBE_TARGET, TF_MESSAGE
from rosette_ros.io.type_definitions import TypeLibrary


def content() -> str:
    """Return the file for the definitions of this environment."""
    library = TypeLibrary.from_environment(os.environ)
    made = {name: library.definition(name) for name in (PROBE_TARGET, BALL_CENTRE, TF_MESSAGE)}
    return json.dumps({name: {'text': one.text, 'hash': one.hash} for name, one in made.items()}, indent=1) + '\n'


if __name__ == '__main__':
    sys.stdout.write(content())

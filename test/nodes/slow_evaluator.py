# SPDX-License-Identifier: Apache-2.0
"""An evaluator that takes its time to say which readings follow: SECONDS_EACH, in the environment, s."""

import os
import sys
import time
from functools import partial

from rosette_ros.nodes import names
from rosette_ros.nodes.base_node import run_node
from rosette_ros.nodes.evaluation import ModelInUse
from rosette_ros.nodes.evaluator import Evaluator

SECONDS_EACH = 'TEST_SECONDS_EACH'


def main():
    """Run the node."""
    quick = ModelInUse.next_readings

    def slow(*arguments, **wanted):
        print('asked for the next readings', flush=True)
        time.sleep(float(os.environ[SECONDS_EACH]))
        return quick(*arguments, **wanted)

    ModelInUse.next_readings = slow
    return run_node(names.EVALUATOR, partial(Evaluator))


if __name__ == '__main__':
    sys.exit(main())

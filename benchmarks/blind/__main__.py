# SPDX-License-Identifier: Apache-2.0
"""The command of the blind tests.

    python -m benchmarks.blind [--noise [KIND ...]] [--causes [KIND ...]] [--library [KIND ...]] [--power [KIND ...]]
                               [--orders ORDER ...] [--seeds 20] [--strength 16 40] [-n 12] [--jobs 2]
                               [--json FILE] [--compare OLD.json] [--list]

Without --noise, --causes, --library and --power the first three tables are made. A line is printed when its runs are
done.
"""

import os

# one process for each core, and one thread for each process
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
os.environ.setdefault('OMP_NUM_THREADS', '1')

import sys

from benchmarks.blind.command import main

if __name__ == '__main__':
    sys.exit(main())

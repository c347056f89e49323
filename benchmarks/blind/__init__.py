# SPDX-License-Identifier: Apache-2.0
"""Blind tests of the diagnosis: truth is drawn from physics, the diagnosis sees readings, and both are compared."""

import os

# one process for each core, and one thread for each process
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
os.environ.setdefault('OMP_NUM_THREADS', '1')

from benchmarks.blind.trial import SETS, Trial, trials  # noqa: E402
from benchmarks.blind.truth import Truth  # noqa: E402

__all__ = ['SETS', 'Trial', 'Truth', 'trials']

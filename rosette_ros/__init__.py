# SPDX-License-Identifier: Apache-2.0
"""Calibrates rotary tables by the three-rosette method, and finds what a model of the cell leaves out."""

import os

# The matrices are small: more than one thread of the linear algebra library mostly waits for the others, and the last
# digits of a sum depend on their number. It is read once, when numpy is imported.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

__version__ = '0.1.0'

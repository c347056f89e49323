# SPDX-License-Identifier: Apache-2.0
"""Looking values up at many places of a buffer at once, wherever they are aligned."""

import numpy as np


def every_byte(buffer, dtype):
    """Return a uint8 buffer (B,) as seen with a value of `dtype` at every byte, a view."""
    size = np.dtype(dtype).itemsize
    return np.ndarray((max(buffer.size - size + 1, 0),), dtype, buffer, 0, (1,))


def byte_rows(buffer, place, size):
    """Return `size` bytes from each place (N,) of a buffer, (N, size), a copy."""
    if not size or not place.size:
        return np.zeros((place.size, size), dtype=np.uint8)
    return np.lib.stride_tricks.sliding_window_view(buffer, size)[place]

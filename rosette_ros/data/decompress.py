# SPDX-License-Identifier: Apache-2.0
"""Bytes of compressed chunks; a size that is told wrongly takes no memory."""

import lz4.frame
import zstandard

DAMAGED = (RuntimeError, EOFError, ValueError, zstandard.ZstdError)
"""What is raised where the bytes are none of the compression."""
_STEP = 1 << 22  # bytes are made room for in pieces of this size


def _plain(data, size):
    return data


def _lz4(data, size):
    unpack = lz4.frame.LZ4FrameDecompressor()
    return _joined(unpack.decompress, data, size)


def _zstd(data, size):
    reader = zstandard.ZstdDecompressor().stream_reader(data)
    return _joined(lambda _, most: reader.read(most), data, size)


def _joined(read, data, size):
    """Return at most size + 1 bytes: one more than wanted tells that the size is wrong."""
    left = size + 1
    pieces = [read(data, min(left, _STEP))]
    while pieces[-1] and (left := left - len(pieces[-1])):
        pieces.append(read(b'', min(left, _STEP)))
    return b''.join(pieces)


DECOMPRESSORS = {'': _plain, 'lz4': _lz4, 'zstd': _zstd}
"""By the name in the file: function of the bytes and the size that they shall have."""

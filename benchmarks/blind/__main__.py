# SPDX-License-Identifier: Apache-2.0
"""The command of the blind tests: python -m benchmarks.blind --help."""

import sys

from benchmarks.blind.command import main

if __name__ == '__main__':
    sys.exit(main())

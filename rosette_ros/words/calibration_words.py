# SPDX-License-Identifier: Apache-2.0
"""How a calibration ended, in words."""

import shlex
from collections.abc import Collection

CONTINUE = 'continue with: '


def with_advice(words: str, log: str, is_measured: bool, where: Collection[str]) -> str:
    """Return how a run ended, where what was measured is, and how to continue it; log: '' where there is none; where:
    options of its cell."""
    if not is_measured:
        return f'{words}; nothing was measured'
    if not log:
        return f'{words}; what was measured is in no log'
    more = shlex.join(['rosette', 'calibrate', '--resume', log, *where])
    return f'{words}; what was measured is in {log}; {CONTINUE}{more}'

# SPDX-License-Identifier: Apache-2.0
"""How an argument is said where the user stands: `--force` to whoever types commands, `force=True` in Python."""

from collections.abc import Iterator
from contextlib import contextmanager

_COMMANDS: list[bool] = []
"""One entry for each command that runs in this process."""


@contextmanager
def typed() -> Iterator[None]:
    """Say arguments as they are typed after `rosette` while a block runs."""
    _COMMANDS.append(True)
    try:
        yield
    finally:
        _COMMANDS.pop()


def as_typed(option: str, argument: str) -> str:
    """Return how an argument is said: an option such as '--columns', or in Python 'columns='."""
    return option if _COMMANDS else argument

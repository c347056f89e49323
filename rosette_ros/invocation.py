# SPDX-License-Identifier: Apache-2.0
"""How the command `rosette` is called from where the user stands, and its version: below all that prints it."""

import os
import shlex
import shutil
import sys
from pathlib import Path

__version__ = '0.1.0'


def command(*words: object) -> str:
    """Return a command as it is typed in a shell where the user stands: `rosette` with these words."""
    return ' '.join(map(_quoted, [program(), *map(str, words)]))


def _quoted(word: str) -> str:
    """Return a word as the shell of this system takes it: that of Windows knows double quotes and no escapes."""
    return shlex.quote(word) if os.name == 'posix' else f'"{word}"' if not word or ' ' in word else word


def program() -> str:
    """Return how `rosette` is called from where the user stands: by its name where that finds it, else by its path."""
    own = Path(sys.prefix) / ('bin/rosette' if os.name == 'posix' else 'Scripts/rosette.exe')
    found = shutil.which('rosette')
    if not own.is_file() or (found and Path(found).samefile(own)):
        return 'rosette'
    if not own.is_relative_to(Path.cwd()):
        return str(own)
    near = str(own.relative_to(Path.cwd()))
    return near if os.sep in near else os.path.join('.', near)

# SPDX-License-Identifier: Apache-2.0
"""Compiles what rosette_ros imports, so that its commands and nodes start fast from the first time on, and the tests.

Run by .venv's Python. Files of .venv are written in any case: where Python itself shall write no byte code
(PYTHONDONTWRITEBYTECODE), every start of a node would compile all of it anew, which takes seconds. Tests are compiled
by pytest, which rewrites their assertions: here once, else by each of the processes in which they run.
"""

import importlib
import importlib.util
import pkgutil
import py_compile
import subprocess
import sys
from pathlib import Path

import rosette_ros

ROOT = Path(__file__).parents[1]


def imported() -> list[str]:
    """Import every module of rosette_ros; return the source files of .venv that came with them."""
    for module in pkgutil.walk_packages(rosette_ros.__path__, 'rosette_ros.'):
        importlib.import_module(module.name)
    files = {getattr(module, '__file__', None) or '' for module in list(sys.modules.values())}
    return sorted(name for name in files if name.endswith('.py') and Path(sys.prefix) in Path(name).parents)


def main() -> None:
    """Compile them beside themselves; a file that does not compile was imported all the same and is left alone."""
    tests = None if sys.dont_write_bytecode else subprocess.Popen(
        [sys.executable, '-m', 'pytest', '--collect-only', '-q', ROOT], cwd=ROOT)
    sys.pycache_prefix = None
    for name in imported():
        if not Path(importlib.util.cache_from_source(name)).exists():
            py_compile.compile(name, quiet=2)
    if tests:
        tests.wait()  # what cannot be collected is told when the tests run


if __name__ == '__main__':
    main()

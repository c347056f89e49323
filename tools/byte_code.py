# SPDX-License-Identifier: Apache-2.0
"""Compiles what rosette_ros imports, so that its commands and nodes start fast from the first time on.

Run by .venv's Python. Only files of .venv are written: where Python itself shall write no byte code
(PYTHONDONTWRITEBYTECODE), every start of a node would compile all of it anew, which takes seconds.
"""

import importlib
import importlib.util
import pkgutil
import py_compile
import sys
from pathlib import Path

import rosette_ros


def imported() -> list[str]:
    """Import every module of rosette_ros; return the source files of .venv that came with them."""
    for module in pkgutil.walk_packages(rosette_ros.__path__, 'rosette_ros.'):
        importlib.import_module(module.name)
    files = {getattr(module, '__file__', None) or '' for module in list(sys.modules.values())}
    return sorted(name for name in files if name.endswith('.py') and Path(sys.prefix) in Path(name).parents)


def main() -> None:
    """Compile them beside themselves; a file that does not compile was imported all the same and is left alone."""
    sys.pycache_prefix = None
    for name in imported():
        if not Path(importlib.util.cache_from_source(name)).exists():
            py_compile.compile(name, quiet=2)


if __name__ == '__main__':
    main()

# SPDX-License-Identifier: Apache-2.0
"""Parts of numpy that nothing here uses: they load when they are used, by importlib.util.LazyLoader.

The first part of scipy that loads asks numpy for every name it has; of f2py and testing this alone loads 100 modules in
0.1 s of processor time, a tenth of what `rosette evaluate` takes."""

import importlib.util
import sys

import numpy as np

UNUSED = ('f2py', 'testing')


def postpone_unused() -> None:
    """Let each of them load at the first use of one of its names, unless it has been loaded already."""
    for name in UNUSED:
        full = f'numpy.{name}'
        spec = None if full in sys.modules else importlib.util.find_spec(full)
        if spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
            module = sys.modules[full] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            setattr(np, name, module)

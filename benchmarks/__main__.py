# SPDX-License-Identifier: Apache-2.0
"""All benchmarks, one after the other, in one run on one machine: python -m benchmarks [NAME ...].

A benchmark is a file bench_NAME.py here with a function main() that prints its times and ratios.
"""

import importlib.util
import os
import platform
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
HERE = Path(__file__).parent


def benchmarks():
    """Return the files of all benchmarks by name, in the order of the alphabet."""
    return {path.stem.removeprefix('bench_'): path for path in sorted(HERE.glob('bench_*.py'))}


def run(name, path):
    """Run one benchmark; return whether it ran to its end."""
    print(f'\n== {name}', flush=True)
    began = time.perf_counter()
    spec = importlib.util.spec_from_file_location(f'benchmarks.{path.stem}', path)
    module = importlib.util.module_from_spec(spec)
    # Benchmarks start processes, which look for the module by its name.
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
        module.main()
    except Exception:  # one that fails must not hide what the others say
        traceback.print_exc()
        return False
    print(f'   ({time.perf_counter() - began:.0f} s)', flush=True)
    return True


def main(chosen):
    """Run the chosen benchmarks (all if none is); return the exit code."""
    known = benchmarks()
    for name in chosen:
        if name not in known:
            print(f'benchmarks: expected some of {", ".join(known)}, found {name!r}', file=sys.stderr)
            return 2
    print(f'{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, '
          f'Python {platform.python_version()}, load {os.getloadavg()[0]:.1f} before')
    failed = [name for name in chosen or known if not run(name, known[name])]
    if failed:
        print(f'benchmarks: failed: {", ".join(failed)}', file=sys.stderr)
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))

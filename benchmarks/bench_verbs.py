# SPDX-License-Identifier: Apache-2.0
"""Verbs of the command line on a log of 12 balls, from the start of the process to its end.

Beside them, in turns, the same Python that only imports what everyone who calculates and draws imports.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.bench_log import RECORDED

PEERS = {'import of numpy and scipy': 'import numpy, scipy.linalg, scipy.optimize, scipy.special, scipy.sparse',
         'import of matplotlib too': 'import numpy, scipy.linalg, scipy.optimize, scipy.special, scipy.sparse, '
                                     'matplotlib.figure'}
WANTED = {'evaluate': 1.0, 'diagnose': 1.5, 'report': 4.0}
"""Verb: the time that it may take on a quiet computer, s."""
ROUNDS = 5


def seconds(command: list[str], folder: str) -> float:
    """Return how long a process takes, s; raises CalledProcessError where it fails."""
    began = time.perf_counter()
    subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - began


def main() -> None:
    """Print the least time of each and what is wanted."""
    rosette = str(Path(sys.executable).with_name('rosette'))
    commands = {name: [sys.executable, '-c', words] for name, words in PEERS.items()}
    commands |= {verb: [rosette, verb, str(RECORDED), *(['--force'] if verb == 'report' else [])] for verb in WANTED}
    with tempfile.TemporaryDirectory() as folder:
        times = [{name: seconds(command, folder) for name, command in commands.items()} for _ in range(ROUNDS)]
    print(f'verbs on a log of 12 balls, from the start of the process, least of {ROUNDS}')
    for name in commands:
        least, wanted = min(one[name] for one in times), WANTED.get(name)
        words = '' if wanted is None else f', expected {wanted:g} s' + (': NOT reached' if least > wanted else '')
        print(f'  {name:26} {least:5.2f} s{words}')


if __name__ == '__main__':
    main()

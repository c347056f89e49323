# SPDX-License-Identifier: Apache-2.0
"""A log that is made from another one, or from a table, is whole or is not there."""

import resource
import subprocess
import sys

import pytest

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.log_writer import LogWriter, whole_log

COMMAND = 'import sys; from rosette_ros.cli.main import main; sys.exit(main())'


def _limited(*words):
    """Run `rosette ...` in a process that may write no file of more than 5000 bytes, and no byte code, which is cut."""
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))

    return subprocess.run([sys.executable, '-Bc', COMMAND, *map(str, words)], capture_output=True, text=True,
                          preexec_fn=limit, timeout=300, check=False)


def test_a_log_that_is_there_stays_whatever_comes(tmp_path):
    """Who is refused has begun nothing; who fails later takes back its own files alone."""
    with LogWriter(tmp_path / 'log', 'log'):
        before = sorted(tmp_path.rglob('*'))
        with pytest.raises(InvalidData, match='holds'), whole_log(tmp_path / 'log', 'log'):
            pytest.fail('expected a refusal')
        assert sorted(tmp_path.rglob('*')) == before
    (tmp_path / 'own').mkdir()
    (tmp_path / 'own' / 'notes.txt').write_text('mine')
    for error in (KeyError, InvalidData):
        with pytest.raises(error), whole_log(tmp_path / 'own', 'log'):
            raise error('no')
        assert [path.name for path in (tmp_path / 'own').iterdir()] == ['notes.txt']

# SPDX-License-Identifier: Apache-2.0
"""rosette demo --circle: from a table that nobody has corrected to one whose errors are within U, over real nodes."""

import subprocess
import sys

from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.open_run import open_run


def test_once_round(tmp_path, module_domain_id, rosette):
    """What is missing is named and added, the table corrected, the correction confirmed; the logs say so again."""
    done = subprocess.run(
        [sys.executable, '-m', 'rosette_ros.cli.main', 'demo', '--circle', '--balls', '6', '-o', tmp_path, '--domain',
         str(module_domain_id)], capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stderr
    assert 'The model lacks' in done.stdout
    assert 'The correction did what it promised: ' in done.stdout
    before, after = sorted(tmp_path.iterdir())
    correction, _ = read_correction(after / 'correction.yaml')
    assert correction.run_id == open_run(before).run_id
    assert (after / 'circle.png').read_bytes().startswith(b'\x89PNG')
    again = rosette('verify', before, after, '--correction', after / 'correction.yaml', '--model', after / 'model.yaml')
    assert 'The correction did what it promised: ' in again.out

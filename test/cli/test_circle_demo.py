# SPDX-License-Identifier: Apache-2.0
"""rosette demo --circle: from a table that nobody has corrected to one whose errors are within U, over real nodes."""

import pytest

from rosette_ros.io.correction_file import read_correction
from rosette_ros.io.open_run import open_run

pytestmark = pytest.mark.long


def test_once_round(tmp_path, domain_id, rosette):
    """What is missing is named and added, the table corrected, the correction confirmed; the logs say so again."""
    done = rosette('demo', '--circle', '--balls', 6, '-o', tmp_path, '--domain', domain_id)
    assert done.code == 0, done.err
    assert 'With them the residual standard deviation falls from' in ' '.join(done.out.split())
    assert 'The correction did what it promised: ' in done.out
    before, after = sorted(tmp_path.iterdir())
    correction, _ = read_correction(after / 'correction.yaml')
    assert correction.run_id == open_run(before).run_id
    assert (after / 'circle.png').read_bytes().startswith(b'\x89PNG')
    again = rosette('verify', before, after, '--correction', after / 'correction.yaml', '--model', after / 'model.yaml')
    assert 'The correction did what it promised: ' in again.out

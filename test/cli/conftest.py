# SPDX-License-Identifier: Apache-2.0
"""The command run in this process, and ball-centre tables written without the package's writer."""

from dataclasses import dataclass

import numpy as np
import pytest

from rosette_ros.cli.main import main
from rosette_ros.core.run.scheme import plan


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    code: int
    out: str
    err: str


@pytest.fixture
def rosette(capsys):
    """Return a function that runs `rosette ...` in this process and returns its Answer."""
    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return Answer(code, captured.out, captured.err)
    return run


@pytest.fixture
def refused(rosette):
    """Return a function that runs a command which must fail: exit 2, one line, nothing else."""
    def run(*words):
        answer = rosette(*words)
        assert answer.code == 2
        assert answer.out == ''
        assert answer.err.count('\n') == 1
        assert answer.err.startswith('rosette: ')
        return answer.err
    return run


HEADER = 'seq,table_position,ball,cmm_position,table_angle_deg,x_mm,y_mm,z_mm,time_s,' \
         'temperature_C,approach'


def table_lines(n, order='diagonal', seed=0, size_mm=0.05):
    """Return the lines of a ball-centre table: nominal centres plus random deviations."""
    scheme = plan(n, order, seed)
    rng = np.random.default_rng(seed)
    lines = ['# schema: rosette-ball-centres/1', '# radius_mm: 182.5',
             '# repeatability_um: 0.1', f'# run_id: test_{order}_{n}', HEADER]
    for row, (i, j, k) in enumerate(zip(
            scheme.table_position, scheme.ball, scheme.cmm_position, strict=True)):
        alpha = 2 * np.pi * (k - 1) / n
        x, y, z = rng.normal(0, size_mm, 3) + 182.5 * np.array([np.cos(alpha), np.sin(alpha), 0])
        lines.append(f'{row + 1},{i},{j},{k},{360 * (i - 1) / n:.12f},{x:.12f},{y:.12f},{z:.12f},'
                     f'{40.0 * row},20.0,1')
    return lines


@pytest.fixture
def make_table(tmp_path):
    """Return a function that writes a table and returns its path; edit changes its lines."""
    def make(n=6, order='diagonal', seed=0, name='run.csv', edit=None):
        lines = table_lines(n, order, seed)
        path = tmp_path / name
        path.write_text('\n'.join(edit(lines) if edit else lines) + '\n', encoding='utf-8')
        return path
    return make

# SPDX-License-Identifier: Apache-2.0
"""Data without noise, of one or two values or of one axis, and the smallest plate: every verb, no warning of numpy."""

import json
from functools import cache

import numpy as np
import pytest

from rosette_ros.core.run.records import Run
from rosette_ros.core.run.scheme import nominal_places, plan
from rosette_ros.io.ball_centre_table import write_csv

pytestmark = pytest.mark.long

RADIUS = 0.1825


def run_of(n, deviation, repeatability=1e-7, **rest):
    """Return a run of nominal places and a deviation (N, 3), m, of its indices (table position, ball) from 0."""
    scheme = plan(n, 'diagonal')
    i, j = scheme.table_position, scheme.ball
    centre = nominal_places(n, RADIUS, i, j) + deviation(i - 1, j - 1)
    return Run(n, RADIUS, i, j, centre, time=40.0 * np.arange(n * n), temperature=np.full(n * n, 20.0),
               approach=scheme.approach, repeatability=repeatability, run_id='degenerate', **rest)


def noise(n, axes=(1, 1, 1), size=1e-7):
    """Return white noise along some axes."""
    return np.random.default_rng(1).normal(0, size, (n * n, 3)) * axes


def waves(i, j):
    """Return a table error motion that the base model describes to the last digit."""
    return 1e-6 * np.stack([0 * i, 0 * i, np.cos(2 * np.pi * 2 * i / 6)], axis=-1)


KINDS = {
    'noise-free': lambda: run_of(6, waves),
    'noise-free, no repeatability': lambda: run_of(6, waves, None),
    'constant': lambda: run_of(6, lambda i, j: np.full((i.size, 3), 1e-5)),
    'two-valued': lambda: run_of(6, lambda i, j: 1e-6 * np.sign(noise(6))),
    'one reading': lambda: run_of(6, lambda i, j: 1e-5 * np.outer((i == 2) & (j == 3), [1, 0, 0])),
    'single axis': lambda: run_of(6, lambda i, j: noise(6, (0, 0, 1))),
    'n = 3': lambda: run_of(3, lambda i, j: noise(3)),
    'n = 3, noise-free': lambda: run_of(3, lambda i, j: np.zeros((i.size, 3))),
    'incomplete': lambda: run_of(6, lambda i, j: noise(6)).take([*range(3), *range(4, 29), *range(30, 36)]),
}
VERBS = ('evaluate', 'compare --ladder', 'diagnose', 'advise', 'info', 'report', 'export', 'import',
         'add frame_drift')


@cache
def made(kind, folder):
    """Return the path of a kind of run as a table."""
    path = folder / f'{kind.replace(" ", "_")}.csv'
    write_csv(KINDS[kind](), path)
    return path


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return the folder of the tables."""
    return tmp_path_factory.mktemp('degenerate')


@pytest.mark.filterwarnings('error', 'ignore::ResourceWarning')  # files that other tests have left
@pytest.mark.parametrize('verb', VERBS)
@pytest.mark.parametrize('kind', KINDS)
def test_a_verb_goes_through(kind, verb, folder, rosette, tmp_path):
    """Exit 0, or 2 in one line where the run does not determine what is asked; no warning, no traceback."""
    path = made(kind, folder)
    words = verb.split()
    if words[0] in ('report', 'export', 'import'):
        words += ['-o', tmp_path / 'out']
    for json_too in ([], ['--json']) if words[0] not in ('report', 'export', 'import') else ([],):
        model = ['--model', tmp_path / f'{len(json_too)}.yaml', '--run'] if words[0] == 'add' else []
        answer = rosette(*words, *model, path, *json_too)
        assert answer.code in (0, 2), answer.err
        assert answer.code == 0 or (answer.err.count('\n') == 1 and words[0] == 'add'), answer.err
        assert 'nan' not in answer.out.lower().replace('nanosec', '')
        if json_too and answer.code == 0:
            json.loads(answer.out)

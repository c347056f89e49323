# SPDX-License-Identifier: Apache-2.0
"""The run record: frozen, checked once, derived quantities."""

import numpy as np
import pytest
from synthetic import synthetic_run

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import rotation_matrix
from rosette_ros.core.run.records import ErrorMotions, Run, remove_gauge


def test_arrays_are_frozen():
    """Nobody can change a reading by accident."""
    run, *_ = synthetic_run(6)
    with pytest.raises(ValueError, match='read-only'):
        run.centre[0, 0] = 1.0


@pytest.mark.parametrize('changes, words', [
    ({'n': 2}, 'expected at least 3 balls, found n = 2'),
    ({'radius': 0.0}, 'expected a positive radius in metres, found 0.0'),
    ({'time': np.zeros(5)}, r'time: expected shape \(36,\), found \(5,\)'),
    ({'ball': np.full(36, 7)}, r'reading 1: ball: expected 1..6, found 7'),
    ({'ball': np.zeros(36)}, r'reading 1: ball: expected 1..6, found 0'),
    ({'repeatability': -1.0}, 'repeatability: expected a positive number of metres, found -1.0'),
    ({'ball': np.ones(36)}, 'readings 1 and 12 are both table position 1, ball 1; expected each'),
])
def test_nonsense_is_refused(changes, words):
    """What cannot be a run is refused with what was wanted and what came."""
    run, *_ = synthetic_run(6)
    with pytest.raises(InvalidData, match=words):
        run.replace(**changes)


def test_nan_is_refused():
    """A ball centre that is not a number is refused, with its reading."""
    run, *_ = synthetic_run(6)
    centre = run.centre.copy()
    centre[4, 1] = np.nan
    with pytest.raises(InvalidData, match='reading 5: centre: expected finite numbers'):
        run.replace(centre=centre)


def test_radians_for_degrees_are_noticed():
    """Angles that were converted twice are recognised."""
    run, *_ = synthetic_run(6)
    with pytest.raises(InvalidData, match='look like radians where degrees were wanted'):
        run.replace(table_angle=np.deg2rad(run.table_angle))


def test_empty_run():
    """No readings are no run."""
    with pytest.raises(InvalidData, match='expected ball centres, found none'):
        Run(6, 0.1825, np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))


def test_gauge_is_removed_once():
    """Removing the gauge twice changes nothing, and it takes what it says."""
    curves = np.random.default_rng(0).standard_normal((12, 6))
    once = remove_gauge(curves)
    assert np.allclose(remove_gauge(once), once, atol=1e-15)
    assert np.allclose(once.mean(axis=0), 0, atol=1e-15)
    turn = np.exp(2j * np.pi * np.arange(12) / 12)
    for x, y in ((0, 1), (3, 4)):
        pair = once[:, x] + 1j * once[:, y]
        assert abs(np.mean(pair * turn.conj())) < 1e-15
        assert abs(np.mean(pair * turn)) > 1e-3


def test_curves_of_a_run_between_the_steps_turn_into_the_axes_of_angle_zero():
    """Where x and y change places at a quarter turn, and so do their uncertainties; the machine frame stays."""
    rng = np.random.default_rng(0)
    rotation = rotation_matrix([0.3, -0.2, 0.1])
    motions = ErrorMotions(np.arange(4.0), rng.standard_normal((4, 6)), rng.uniform(1, 2, (4, 6)), rotation)
    turned = motions.turned_back(np.pi / 2)
    np.testing.assert_allclose(turned.values, motions.values[:, [1, 0, 2, 4, 3, 5]] * [-1, 1, 1, -1, 1, 1])
    np.testing.assert_allclose(turned.u, motions.u[:, [1, 0, 2, 4, 3, 5]])
    np.testing.assert_allclose(turned.values[:, :3] @ turned.rotation.T, motions.values[:, :3] @ rotation.T)
    assert motions.turned_back(0.0) is motions

# SPDX-License-Identifier: Apache-2.0
"""Pages with examples run as they stand."""

import doctest
from pathlib import Path

import pytest

import rosette_ros.presentation.formatting

DOCS = Path(__file__).parents[1] / 'docs'


@pytest.mark.parametrize('name', ['adding-an-effect.md'])
def test_a_page_runs(name):
    """Every example gives what stands below it."""
    result = doctest.testfile(str(DOCS / name), module_relative=False)
    assert result.attempted > 10
    assert result.failed == 0


def test_the_example_of_the_units_runs():
    """In the docstring."""
    assert doctest.testmod(rosette_ros.presentation.formatting).failed == 0

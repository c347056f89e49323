# SPDX-License-Identifier: Apache-2.0
"""Fixtures for the tests of the core."""

import pytest
from synthetic import synthetic_run


@pytest.fixture
def make_run():
    """Return the maker of synthetic runs."""
    return synthetic_run


@pytest.fixture(scope='module', autouse=True)
def known_searches():
    """Search anew in every test, as the search is what is tested; files about what follows it share their searches."""

# SPDX-License-Identifier: Apache-2.0
"""Blind tests search anew."""

import pytest


@pytest.fixture(scope='module', autouse=True)
def known_searches():
    """Search anew in every test: the search is what is tested."""

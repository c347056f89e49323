# SPDX-License-Identifier: Apache-2.0
"""Nothing that is written here has to outlive a power cut."""

import os

import pytest


@pytest.fixture(scope='session', autouse=True)
def quick_disk():
    """Let files be written without waiting for the disk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, 'fsync', lambda descriptor: None)
        yield

# SPDX-License-Identifier: Apache-2.0
"""The notebooks of examples/ run from start to end, and are stored with what they show."""

import os
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / 'tools'))
from notebooks import pictures, run  # noqa: E402

NOTEBOOKS = sorted((ROOT / 'examples').glob('*.ipynb'))
MOST_BYTES = 200_000


def code(notebook):
    """Return the cells of code."""
    return [cell for cell in notebook.cells if cell.cell_type == 'code']


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_small_outputs(path):
    """All of its cells have been run, in order, without an error or a path of the computer that ran it."""
    notebook, text = nbformat.read(path, as_version=4), path.read_text(encoding='utf-8')
    assert [cell.execution_count for cell in code(notebook)] == [*range(1, 1 + len(code(notebook)))]
    assert path.stat().st_size < MOST_BYTES
    assert '"output_type": "error"' not in text and '/tmp/' not in text and str(Path.home()) not in text


@pytest.mark.long
@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    """From start to end; its words are those that are stored, and it has as many pictures."""
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(ROOT), *sys.path]))
    made, stored = run(path, tmp_path), nbformat.read(path, as_version=4)
    assert len(pictures(made)) == len(pictures(stored))
    for new, old in zip(code(made), code(stored), strict=True):
        assert [one.get('data', {}).get('text/plain') for one in new.outputs] == [
            one.get('data', {}).get('text/plain') for one in old.outputs]

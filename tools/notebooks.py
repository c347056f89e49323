# SPDX-License-Identifier: Apache-2.0
"""Runs the notebooks of examples/ and stores what they show: python tools/notebooks.py [NAME ...]

The pictures of the first hour become those of docs/python.md."""

import base64
import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
EXAMPLES, IMAGES = ROOT / 'examples', ROOT / 'docs' / 'images'
SHOWN = 'first_hour'


def run(path: Path, folder: Path | str) -> nbformat.NotebookNode:
    """Return a notebook as it is after a run in a folder, without what differs from run to run."""
    notebook = nbformat.read(path, as_version=4)
    place = {'metadata': {'path': str(folder)}}
    NotebookClient(notebook, timeout=300, kernel_name='python3', resources=place).execute()
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()
    notebook.metadata = {'kernelspec': notebook.metadata.kernelspec, 'language_info': {'name': 'python'}}
    return notebook


def pictures(notebook: nbformat.NotebookNode) -> list[bytes]:
    """Return the pictures that a notebook shows, PNG."""
    return [base64.b64decode(output.data['image/png']) for cell in notebook.cells for output in cell.get('outputs', ())
            if 'image/png' in output.get('data', {})]


def main(names: list[str]) -> None:
    """Run all notebooks, or those of some names."""
    os.environ['PYTHONPATH'] = str(ROOT)
    for path in sorted(EXAMPLES.glob('*.ipynb')):
        if names and path.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            notebook = run(path, folder)
        nbformat.write(notebook, path)
        if path.stem == SHOWN:
            for number, data in enumerate(pictures(notebook), 1):
                (IMAGES / f'first-hour-{number}.png').write_bytes(data)


if __name__ == '__main__':
    main(sys.argv[1:])

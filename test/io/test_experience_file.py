# SPDX-License-Identifier: Apache-2.0
"""Files of experience: written and read again, and refused where they say what cannot be."""

import pytest

from rosette_ros.core.model.experience import Experience, KnownCause
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.experience_file import format_experience, read_experience

KNOWN = Experience((KnownCause('frame_warmup', 0.8, 0.99, 5.2, 6, 1e-7, 0.4, (('tau', 1000.0, 30.0),)),
                    KnownCause('touches | frame', 0.1, 0.05, 0.5, 6)),
                   'cell2', 'T17', 'C3', 6, '2026-01-05', '2026-05-04')


def written(folder, text):
    """Return the path of a file with a text."""
    path = folder / 'cell.yaml'
    path.write_text(text)
    return path


def test_what_is_written_is_read(tmp_path):
    """With its sizes, constants, days and numbers of runs, and without what is not known."""
    got = read_experience(written(tmp_path, format_experience(KNOWN)))
    assert got.causes[0] == KNOWN.causes[0]
    assert (got.cell, got.table, got.cmm, got.runs, got.begin, got.end) == (
        'cell2', 'T17', 'C3', 6, '2026-01-05', '2026-05-04')
    assert got.causes[1].rate == 0.1 and got.causes[1].size != got.causes[1].size


@pytest.mark.parametrize(('change', 'words'), [
    (('rosette-experience/1', 'rosette-model/1'), 'expected a mapping with "schema: rosette-experience/1"'),
    (('rate: 0.8', 'rate: 1.0'), r'causes: 1: rate: expected a probability above 0 and below 1, found 1\.0'),
    (('frame_warmup', 'frame_warmpu'), 'causes: 1: .*frame_warmup'),
    (('size_um: 0.1', 'size_um: -1'), 'causes: 1: size_um: expected a positive number'),
    (('\nruns: 6', '\nruns: many'), 'runs: expected how many runs'),
    (('cell: cell2', 'zell: cell2'), 'zell')])
def test_what_cannot_be_is_refused(tmp_path, change, words):
    """By the file, the entry, what was expected and what was found."""
    with pytest.raises(InvalidData, match=words):
        read_experience(written(tmp_path, format_experience(KNOWN).replace(*change)))

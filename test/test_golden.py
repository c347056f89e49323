# SPDX-License-Identifier: Apache-2.0
"""Numbers of an earlier version: logs and tables as they were then, and what evaluate made of them then.

How the inputs were made is told in test/golden/README.md. Keys, lists, names and counts agree exactly, numbers
within TOLERANCE; keys may be added. The logs hold the messages as they were then.
"""

import gzip
import json
import math
from pathlib import Path

import pytest

from rosette_ros.cli.main import main

GOLDEN = Path(__file__).parent / 'golden'
EXPECTED = sorted((GOLDEN / 'expected').glob('*.json.gz'))
INPUTS = 12

TOLERANCE = 1e-9
"""Relative to the largest number of an array, on every processor. Readings of 0.18 m are 2.8e-17 m apart: another order
of sums moves a curve of 1e-7 m in its tenth digit."""
SIZE_BESIDE = {'value': 'u'}
"""Key: the key beside it that tells its size. An amplitude that is not there is rounding of its uncertainty."""


def size_of(numbers):
    """Return the largest magnitude in nested lists of numbers, 0 where there is none."""
    if isinstance(numbers, list):
        return max(map(size_of, numbers), default=0.0)
    return abs(numbers) if isinstance(numbers, (int, float)) and not isinstance(numbers, bool) else 0.0


def differences(expected, got, keys=(), size=0.0):
    """Yield 'where: expected ..., found ...' for all that is not what was expected.

    size: of the array that numbers are part of. A number that is the rounding of a zero, such as the once-per-turn part
    that was taken out of a curve, has no digits of its own: it is held to the tolerance of its array.
    """
    if isinstance(expected, dict) and isinstance(got, dict):
        for name, value in expected.items():
            if name not in got:
                yield f'{where(keys)}: expected the key {name!r}, found none'
                continue
            beside = size_of(expected.get(SIZE_BESIDE.get(name)))
            yield from differences(value, got[name], (*keys, name), max(size, beside))
    elif isinstance(expected, list) and isinstance(got, list) and len(expected) == len(got):
        size = max(size, size_of(expected))
        for number, pair in enumerate(zip(expected, got)):
            yield from differences(*pair, (*keys, number), size)
    elif not agree(expected, got, size):
        yield f'{where(keys)}: expected {expected!r:.200}, found {got!r:.200}'


def where(keys):
    """Return the place of a value, for a person."""
    return ' > '.join(map(str, keys))


def agree(expected, got, size):
    """Whether two values agree."""
    if isinstance(expected, float) and isinstance(got, (int, float)) and not isinstance(got, bool):
        return math.isclose(expected, got, rel_tol=TOLERANCE, abs_tol=TOLERANCE * size)
    return type(expected) is type(got) and expected == got


@pytest.mark.parametrize('path', [pytest.param(path, marks=pytest.mark.long if '_n12_' in path.name else ())
                                  for path in EXPECTED], ids=lambda path: path.name.partition('.')[0])
def test_the_numbers_are_those_of_before(capsys, path):
    """What evaluate says of one input, or that it refuses it."""
    entry = json.loads(gzip.decompress(path.read_bytes()))
    model = ['--model', str(GOLDEN / entry['model'])] if entry['model'] else []
    code = main(['evaluate', str(GOLDEN / entry['input']), *model, '--json'])
    captured = capsys.readouterr()
    if code:
        assert (code, captured.out, captured.err[:9]) == (entry['answer'], '', 'rosette: ')
        return
    found = list(differences(entry['answer'], json.loads(captured.out, parse_constant=pytest.fail)))
    assert not found, '\n'.join([f'{len(found)} differ:', *found[:20]])


def test_all_inputs_are_there():
    """None is lost unseen."""
    assert len(EXPECTED) == INPUTS

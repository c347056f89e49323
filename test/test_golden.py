# SPDX-License-Identifier: Apache-2.0
"""Numbers of an earlier version: logs and tables as they were then, and what was made of them then.

How the inputs were made is told in test/golden/README.md. Keys, lists, names and counts agree exactly, numbers to
twelve digits; words may change, and keys may be added. The logs hold the messages as they were then.
"""

import contextlib
import ctypes
import gzip
import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from rosette_ros.cli.main import main

GOLDEN = Path(__file__).parent / 'golden'
EXPECTED = sorted((GOLDEN / 'expected').glob('*.json.gz'))
FEWEST = 30

EXCEPTIONS = {
    'log_split_n6_column': 'a ball slips during a reading: that one is wrong in part, no plate slips',
    'log_backlash_n7_random_alternate': 'an order is advised only where it is better: here from 0.325 to 0.343',
    'table_clean_n12_diagonal_1um': 'rounding to 1 µm is told as that, no longer as the form of the balls',
    'table_acceleration_n8_random_model_own': 'a drift along a curve is named and the frame wanders: weighted',
    'table_acceleration_n8_random': 'the library has got a name for it: frame_drift_curved',
    'table_asynchronous_n12_diagonal_missing': 'the order is refined once more: it moves in its fifth digit',
    'table_outlier_n6_sensitive_norep': 'compare fails where the search names an effect, as diagnose does',
    'table_step_cycle_n12_sensitive_model_fixed': 'ball 3 has no form: which part of it is fitted is chance',
    'table_step_cycle_n12_sensitive': 'the searched period is found again jointly: rms smaller in its eighth digit',
    'table_temperature_n7_random_norep': 'compare fails where the search names an effect, as diagnose does'}
"""Input (as its test is called): why it is decided otherwise now, in one line. DECIDED is not compared then."""
DECIDED = ('missing', 'unexplained', 'claimed', 'failing', 'final', 'invisible_bias')
FITTED = ('fit', 'u', 'effects', 'plate_m', 'cmm_m', 'ctx_m', 'cty_m', 'ctz_m', 'crx_rad', 'cry_rad', 'crz_rad',
          'groups', 'axis_rms_m')
WEIGHTED = {
    'log_backlash_n7_random_alternate': ('recommended',), 'table_acceleration_n8_random_model_own': FITTED,
    'table_step_cycle_n12_sensitive_model_fixed': FITTED}
"""Input: what else is not compared: an order no better than the present one was advised; the fit has weights."""

TOLERANCE = 1e-12
"""Relative. The same operations in the same order agree to the last bit; this leaves room for another way to the last
digits of a unit. It leaves none for another order of sums over the coordinates: these are of 0.18 m, 2.8e-17 m apart,
so that a curve of 1e-7 m moves in its tenth digit, and what the search makes in single precision in its eighth."""
OTHER_ARITHMETIC = 1e-5
"""The same on a processor, or with libraries, that round otherwise; some shares and sizes are sums in single
precision (6e-8)."""
FIRM = {
    'evaluate': None, 'compare': ('schema', 'run_id', 'model', 'fit', 'failing', 'axis_rms_m', 'groups'),
    'diagnose': ('schema', 'run_id', 'model', 'fit', 'missing', 'unexplained', 'invisible', 'final'),
    'advise': ('schema', 'run_id', 'n', 'radius_m')}
"""What is compared then, None: all. The rest names one of several that are equal by symmetry (the ball that an order
shows worst), so that the last bit decides."""

OF_THE_LIBRARY = ('diagnose', 'advise')
"""What counts all effects of the library, which were KNOWN then and are more now: only FIRM is compared."""
KNOWN = ('frame_drift', 'frame_warmup', 'frame_temperature', 'frame_cycle', 'frame_step', 'table_zero_drift',
         'axis_tilt_drift', 'table_backlash', 'asynchronous_motion', 'table_warmup', 'plate_creep', 'plate_slip',
         'plate_expansion', 'plate_warp', 'ball_slip', 'ball_form', 'cmm_reversal', 'outlier')

IN_SINGLE = {'size_sigma': 2.0**-23}
"""Keys of numbers whose expected value ends with a root in single precision, and how far that rounds it."""
WORDS = ('verdict', 'unexplained_text', 'summary', 'text')
"""Keys of sentences: that there are some is all that counts."""
REASONS = ('not_judged', 'unavailable')
"""Keys of sentences of which it counts whether they are empty."""
SIZE_ONE = ('visible_fraction', 'typical_visible_fraction', 'worst_share', 'share', 'correlation', 'delta_bic',
            'bias_per_m_rms', 'invisible_bias')
"""Keys of numbers whose natural size is 1: what is hidden whole has a visible fraction of 1e-16, not of 0."""
SIZE_BESIDE = {'mean_m': 'rms_m', 'value': 'u'}
"""Key: the key beside it that tells its size. A mean that the model takes out is 1e-23 m: rounding of 1e-7 m."""


def size_of(numbers):
    """Return the largest magnitude in nested lists of numbers, 0 where there is none."""
    if isinstance(numbers, list):
        return max(map(size_of, numbers), default=0.0)
    return abs(numbers) if isinstance(numbers, (int, float)) and not isinstance(numbers, bool) else 0.0


def differences(expected, got, tolerance, keys=(), skip=(), size=0.0):
    """Yield 'where: wanted ..., got ...' for all that is not what was expected.

    size: of the array that numbers are part of. A number that is the rounding of a zero, such as the once-per-turn part
    that was taken out of a curve, has no digits of its own: it is held to the tolerance of its array.
    """
    if isinstance(expected, dict) and isinstance(got, dict):
        for name, value in expected.items():
            if name in skip:
                continue
            if name not in got:
                yield f'{where(keys)}: wanted the key {name!r}, got none'
                continue
            beside = 1.0 if name in SIZE_ONE else size_of(expected.get(SIZE_BESIDE.get(name)))
            yield from differences(value, got[name], max(tolerance, IN_SINGLE.get(name, 0.0)), (*keys, name), skip,
                                   max(size, beside))
    elif isinstance(expected, list) and isinstance(got, list) and len(expected) == len(got):
        size = max(size, size_of(expected))
        for number, pair in enumerate(zip(expected, got)):
            yield from differences(*pair, tolerance, (*keys, number), skip, size)
    elif not agree(expected, got, keys, tolerance, size):
        yield f'{where(keys)}: wanted {expected!r:.200}, got {got!r:.200}'


def where(keys):
    """Return the place of a value, for a person."""
    return ' > '.join(map(str, keys))


def agree(expected, got, keys, tolerance, size):
    """Whether two values agree."""
    if isinstance(expected, str) and isinstance(got, str):
        if keys[-1] in WORDS:
            return True
        return bool(expected) == bool(got) if set(REASONS) & set(keys) else expected == got
    if isinstance(expected, float) and isinstance(got, (int, float)) and not isinstance(got, bool):
        return math.isclose(expected, got, rel_tol=tolerance, abs_tol=tolerance * size)
    return type(expected) is type(got) and expected == got


def blas_libraries():
    """Yield (get, set) of the number of threads of each OpenBLAS in this process."""
    with contextlib.suppress(OSError):
        lines = Path('/proc/self/maps').read_text().splitlines()
        for path in sorted({line.split()[-1] for line in lines if 'openblas' in line}):
            library = ctypes.CDLL(path)
            for name in ('scipy_openblas_{}_num_threads64_', 'scipy_openblas_{}_num_threads',
                         'openblas_{}_num_threads64_', 'openblas_{}_num_threads'):
                with contextlib.suppress(AttributeError):
                    yield getattr(library, name.format('get')), getattr(library, name.format('set'))
                    break


def digest_of_arithmetic():
    """Return a digest of how this computer rounds: kernels of BLAS and LAPACK, sums, functions."""
    rng = np.random.default_rng(1)
    made = []
    for rows, columns, kind in ((147, 71, float), (432, 131, float), (432, 900, np.float32), (90, 64, complex)):
        matrix = rng.normal(size=(rows, columns)).astype(kind)
        made += [matrix.T @ matrix, matrix @ matrix[0], matrix.sum(axis=0), np.linalg.norm(matrix, axis=1),
                 np.einsum('ij,ik->jk', matrix[:9], matrix[:9])]
        if columns < 200:
            made += [np.linalg.svd(matrix, full_matrices=False)[0], scipy.linalg.qr(matrix)[0],
                     np.linalg.solve(matrix.T @ matrix, matrix[0]), np.linalg.eigvalsh(made[-5])]
    x = rng.uniform(0.1, 7, 1001)
    made += [function(x) for function in (np.sin, np.cos, np.exp, np.log, np.tanh, np.sqrt, np.arctan, np.cumsum)]
    return hashlib.sha256(b''.join(np.ascontiguousarray(one).tobytes() for one in made)).hexdigest()


@pytest.fixture(scope='module')
def is_same_arithmetic():
    """Yield whether this computer rounds as the one that made the numbers; one thread, as threads split sums."""
    libraries = list(blas_libraries())
    before = [get() for get, _ in libraries]
    for _, set_threads in libraries:
        set_threads(1)
    yield digest_of_arithmetic() == (GOLDEN / 'expected' / 'arithmetic.sha256').read_text().strip()
    for (_, set_threads), threads in zip(libraries, before):
        set_threads(threads)


def name_of(path):
    """Return how the test of an input is called."""
    return path.name.partition('.')[0]


def answer_of(capsys, command, entry):
    """Return what a command prints for an input, or its exit code where it refuses."""
    model = ['--model', str(GOLDEN / entry['model'])] if entry['model'] else []
    capsys.readouterr()
    code = main([command, str(GOLDEN / entry['input']), *model, '--json'])
    captured = capsys.readouterr()
    if code:
        assert captured.out == ''
        assert captured.err.startswith('rosette: ')
        return code
    return json.loads(captured.out, parse_constant=pytest.fail)


@pytest.mark.parametrize('path', EXPECTED, ids=name_of)
def test_the_numbers_are_those_of_before(capsys, path, is_same_arithmetic):
    """Everything that evaluate, compare, diagnose and advise say of one input."""
    entry = json.loads(gzip.decompress(path.read_bytes()))
    skip = (*DECIDED, *WEIGHTED.get(name_of(path), ())) if name_of(path) in EXCEPTIONS else ()
    found = []
    for command, expected in entry['answers'].items():
        tolerance = TOLERANCE
        if not is_same_arithmetic:
            tolerance = OTHER_ARITHMETIC
        firm = FIRM[command] if not is_same_arithmetic or command in OF_THE_LIBRARY else None
        got = answer_of(capsys, command, entry)
        if isinstance(expected, dict):
            expected = {key: expected[key] for key in firm or expected}
            if 'invisible' in expected:
                got['invisible'] = [name for name in got['invisible'] if name in KNOWN]
        found += differences(expected, got, tolerance, (command,), skip)
    assert not found, '\n'.join([f'{len(found)} differ:', *found[:20]])


def test_all_inputs_are_there(is_same_arithmetic):
    """None is lost unseen, and every log and table is used."""
    entries = [json.loads(gzip.decompress(path.read_bytes())) for path in EXPECTED]
    assert len(entries) >= FEWEST
    used = {entry['input'] for entry in entries} | {entry['model'] for entry in entries}
    for folder in ('logs', 'tables', 'models'):
        assert {f'{folder}/{path.name}' for path in (GOLDEN / folder).iterdir()} <= used
    assert set(EXCEPTIONS) <= set(map(name_of, EXPECTED))
    if not is_same_arithmetic:
        pytest.skip(f'this computer rounds otherwise: numbers were compared to {OTHER_ARITHMETIC:g} only')

# SPDX-License-Identifier: Apache-2.0
"""What all interfaces share: how many inputs, nasty words, trees and bytes, and the limits of one input."""

import contextlib
import os
import resource
import signal
from pathlib import Path

import yaml
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

IS_CAMPAIGN = 'FUZZ_EXAMPLES' in os.environ
EXAMPLES = int(os.environ.get('FUZZ_EXAMPLES', '120'))
CORPUS = Path(__file__).parent / 'corpus'
MOST_SECONDS = 2.0
"""CPU time that one input may take."""
MOST_BYTES = 400 << 20
"""Address space that one input may take beyond what the process has already."""


def tried(share=1.0):
    """Return the settings of an interface: all of the examples in a campaign, else this share of them."""
    return settings(
        max_examples=EXAMPLES if IS_CAMPAIGN else max(int(share * EXAMPLES), 1),
        deadline=None,
        derandomize=not IS_CAMPAIGN,
        suppress_health_check=list(HealthCheck),
    )


def corpus(name):
    """Return the inputs that are tried always, as bytes."""
    return [path.read_bytes() for path in sorted((CORPUS / name).glob('*'))]


class TooLong(AssertionError):
    """An input that takes more than its time: it may never end."""


def _give_up(number, frame):
    raise TooLong(f'expected an answer within {MOST_SECONDS:g} s of CPU time')


@contextlib.contextmanager
def bounded(seconds=MOST_SECONDS, most=MOST_BYTES):
    """Hold what is done inside to its CPU time and its memory: more is an error that is none of the project's."""
    has = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, _give_up)
    resource.setrlimit(resource.RLIMIT_AS, (has + most, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


NASTY = st.sampled_from(
    [
        '', ' ', 'nan', 'NaN', '-nan', 'inf', '-inf', '1e999', '-0', '0x10', '1_0', '1,5', '٣', '½', '+', '--1',
        '1e-400', '9' * 400, '2147483648', '-1', '0', '1.5', 'true', 'None', '\x00', '\ufeff', '"', "'", '=1+1',
        '#', '# schema: x', '<b>', '1e308', '1e-308', '99999999999999999999', '١٢', '\u202e1', '1 2', '\t3',
    ]
)
WORDS = st.one_of(NASTY, st.text(max_size=12), st.floats().map(repr), st.integers().map(str))


@st.composite
def mutated(draw, original):
    """Return bytes made from others: bytes changed, cut out, doubled, replaced by nasty words."""
    data = bytearray(original)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        kind = draw(st.sampled_from(('byte', 'cut', 'double', 'word', 'end')))
        if kind == 'byte' and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif kind == 'cut':
            del data[at : at + draw(st.integers(1, 60))]
        elif kind == 'double':
            data[at:at] = data[at : at + draw(st.integers(1, 200))]
        elif kind == 'word':
            data[at:at] = draw(WORDS).encode('utf-8', 'surrogatepass')
        elif kind == 'end':
            del data[at:]
    return bytes(data)


NAMES = st.sampled_from(
    [
        'schema', 'base', 'effects', 'name', 'tau', 'frame_drift', 'frame_warmup', 'axes', 'direction',
        'expression', 'per', 'own', 'table_motions', 'rosette-model/1', 'hidden', 'seed', 'kind', 'plate', 'balls',
        'cmm', 'probing', 'table', 'xyz',
    ]
)
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), NAMES, NASTY)


def trees(names, scalars=SCALARS):
    """Return what YAML can say, a few levels deep, with these names as keys."""
    return st.recursive(
        scalars,
        lambda inner: st.one_of(
            st.lists(inner, max_size=4), st.dictionaries(st.one_of(names, st.text(max_size=5)), inner, max_size=4)
        ),
        max_leaves=12,
    )


TREES = trees(NAMES)


def dumped(tree):
    """Return a tree as YAML."""
    return yaml.safe_dump(tree, allow_unicode=True).encode('utf-8', 'surrogatepass')


TRICKS = st.sampled_from(
    [
        '[' * 5000, '{a: ' * 400, '&a [*a]', '9' * 5000, '2001-13-45', '0b2', '!!python/object:os.system {}',
        '? [a, b]\n: c', '!!binary "/w=="', '!!set {1, 2, 3}', '!!float nope', '!!int ""', '!!timestamp x', '-\t-',
        '%YAML 9.9\n---\n', '--- a\n--- b',
        ''.join(f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 9) if k else "x"}]\n' for k in range(9)), '<<: {a: b}',
        '<<: [1]', '<<: x', '"\\ud800"', '\x07', '=: 1', '1:60:60', '.inf', '~: ~', 'a: b: c', "'", '|', '>', '*a',
    ]
)
"""YAML that is none, or more than it seems."""

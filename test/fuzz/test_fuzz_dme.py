# SPDX-License-Identifier: Apache-2.0
"""Lines of I++ DME that are made up: a value that is written and read again, or one error, never a traceback."""

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import WORDS, bounded, corpus, mutated, trees, tried

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.dme.dme_plan import refuse_unsafe_plan
from rosette_ros.dme.dme_settings import dme_settings
from rosette_ros.dme.probe_path import UnsafePath
from rosette_ros.dme.wire import (
    ERROR,
    LONGEST,
    Call,
    NotDme,
    Word,
    decoded,
    error_of,
    parse_command,
    parse_response,
    read_line,
)

pytestmark = pytest.mark.long

many = tried()

LINES = [b'00012 ChangeTool("Probe1")', b'00019 PtMeas(X(100),Y(-20.5),Z(5e1),IJK(0,0,1))', b'E0367 AbortE()',
         b'00018 # R(0.00000), X(100.00000), Tool.A("1")', b'00032 ! Error(3, 1008, "GoTo", "Out of volume")',
         b'00012 &', b'00012 %', b'00101 #(1.0, (nan, -inf), Switch)', b'E0000 ! Error("9", "0503", "", "")']
PIECES = st.sampled_from(['(', ')', ',', ' ', '"', '#', '&', '!', '%', '00001 ', 'E0001 ', 'X', 'Error', '.', '-', '1',
                          'nan', '1.#IND', '\r\n', '0513'])
MADE_UP = st.one_of(
    st.sampled_from(LINES).flatmap(mutated), st.binary(max_size=80),
    st.lists(st.one_of(PIECES, WORDS), max_size=30).map(lambda words: ''.join(words).encode('utf-8', 'surrogatepass')))


def finite(values):
    """Return whether all numbers in values can be written."""
    return all(finite(value.values) if isinstance(value, Call) else
               isinstance(value, str) or math.isfinite(value) for value in values)


def rounded(values):
    """Return values as they are after having been written."""
    return tuple(Call(value.name, rounded(value.values)) if isinstance(value, Call) else
                 value if isinstance(value, Word | str) else round(value, 9) for value in values)


@bounded()
def check_line(data):
    """Read as a command and as a response; what is accepted is written, and read again as the same."""
    for parse in (parse_command, parse_response):
        try:
            made = parse(decoded(data))
        except NotDme as error:
            assert '\n' not in str(error)
            assert len(str(error)) < 400
            continue
        values = made.call.values if parse is parse_command else made.values
        if finite(values):
            again = parse(made.line())
            assert rounded(again.call.values if parse is parse_command else again.values) == rounded(values)
        elif parse is parse_command:
            with pytest.raises(NotDme, match='finite'):
                made.line()
        if parse is parse_response and made.kind == ERROR:
            try:
                assert 0 <= error_of(made).number <= 9999
            except NotDme:
                continue


@many
@given(MADE_UP)
def test_lines(data):
    """Whatever a client or a server sends."""
    check_line(data)


@pytest.mark.parametrize('data', corpus('dme'))
def test_lines_that_once_broke_it(data):
    """Tried always."""
    check_line(data)


@many
@given(st.lists(MADE_UP, max_size=4), st.lists(st.integers(1, 9), max_size=4))
def test_streams(lines, cuts):
    """A stream is read to its end or to the first line that is none, however it is cut into packets."""
    async def read():
        reader, data = asyncio.StreamReader(limit=LONGEST), b'\r\n'.join([*lines, b''])
        for cut in cuts:
            reader.feed_data(data[:cut])
            data = data[cut:]
        reader.feed_data(data)
        reader.feed_eof()
        try:
            while (line := await read_line(reader)) is not None:
                assert '\n' not in line
        except NotDme:
            return
    with bounded():
        asyncio.run(read())


NAMES_OF_SETTINGS = st.sampled_from([
    'schema', 'rosette-dme/1', 'server', 'host', 'port', 'path', 'box_low_mm', 'box_high_mm', 'table', 'axis',
    'limits_deg', 'azimuths_deg', 'tool', 'name', 'ball', 'touches', 'motion', 'clearance_mm'])


@many
@given(trees(NAMES_OF_SETTINGS))
def test_settings(values):
    """Whatever a settings file says: settings of which all paths can be looked at, or one error that names it."""
    base = {'schema': 'rosette-dme/1', 'path': {'box_low_mm': [-1e3] * 3, 'box_high_mm': [1e3] * 3}}
    for made in (values, {**base, **values} if isinstance(values, dict) else base):
        with bounded():
            try:
                settings = dme_settings(made, 'fuzzed.yaml')
                refuse_unsafe_plan(settings)
            except InvalidConfig as error:
                assert str(error).startswith('fuzzed.yaml: ')
                assert '\n' not in str(error)
            except UnsafePath:
                continue

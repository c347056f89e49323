# SPDX-License-Identifier: Apache-2.0
"""CDR against rosbags: every kind of field, one by one and in bulk."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosette_ros.core.errors import InvalidData
from rosette_ros.data.cdr import decode_columns, decode_message, encode_columns
from rosette_ros.data.ros2msg import parse_schema

NAME = 'some_msgs/msg/Thing'
TEXT = """
# every alignment once
int8 MODE=3
string NAME="a # b"
uint8 tiny
string<=20 first
float64 wide
bool[3] flags
uint16 small 7
Inner inner
float32[] numbers
int64 last
string second
uint8[<=5] few
int16 end
===
MSG: some_msgs/Inner
int8 a
float64 b
"""
SCHEMA = parse_schema(NAME, TEXT)
WANTED = ('tiny', 'first', 'wide', 'small', 'inner.a', 'inner.b', 'last', 'second', 'end')


@pytest.fixture(scope='module')
def outside():
    """Return rosbags' types of the same text."""
    store = get_typestore(Stores.EMPTY)
    text = TEXT.replace('===\n', '=' * 80 + '\n').replace('string NAME="a # b"\n', '')
    store.register(get_types_from_msg(text, NAME))
    return store


def number(kind, low=None, high=None):
    """Return whole numbers that fit a type."""
    limits = np.iinfo(kind)
    return st.integers(limits.min if low is None else low, limits.max if high is None else high)


floats = st.floats(allow_nan=False)
things = st.fixed_dictionaries({
    'tiny': number('u1'), 'first': st.text(max_size=9), 'wide': floats,
    'flags': st.lists(st.booleans(), min_size=3, max_size=3), 'small': number('u2'),
    'a': number('i1'), 'b': floats, 'numbers': st.lists(st.floats(width=32, allow_nan=False),
                                                        max_size=4),
    'last': number('i8'), 'second': st.sampled_from(['', 'x', 'one', 'other', 'ß' * 9]),
    'few': st.lists(number('u1'), max_size=5), 'end': number('i2')}).filter(
        lambda thing: '\0' not in thing['first'])


def serialise(store, thing):
    """Return a thing as rosbags writes it."""
    inner = store.types['some_msgs/msg/Inner'](a=thing['a'], b=thing['b'])
    fields = {name: value for name, value in thing.items() if name not in 'ab'}
    fields['flags'] = np.array(thing['flags'], dtype=bool)
    fields['numbers'] = np.array(thing['numbers'], dtype=np.float32)
    fields['few'] = np.array(thing['few'], dtype=np.uint8)
    return bytes(store.serialize_cdr(store.types[NAME](inner=inner, **fields), NAME))


@settings(max_examples=60, deadline=None)
@given(thing=things)
def test_one_message_is_decoded_as_it_was_encoded(outside, thing):
    """Every kind of field, nested and in sequences."""
    message = decode_message(SCHEMA, serialise(outside, thing))
    assert (message.inner.a, message.inner.b) == (thing['a'], thing['b'])
    for name in ('tiny', 'first', 'wide', 'small', 'last', 'second', 'end'):
        assert getattr(message, name) == thing[name]
    for name in ('flags', 'numbers', 'few'):
        assert getattr(message, name).tolist() == thing[name]


@settings(max_examples=60, deadline=None)
@given(batch=st.lists(things, min_size=1, max_size=60), gap=st.integers(0, 9))
def test_many_messages_are_decoded_as_one_by_one(outside, batch, gap):
    """Messages of all lengths, anywhere in a buffer, with and without a common layout."""
    parts = [serialise(outside, thing) for thing in batch]
    buffer = bytearray()
    start, end = [], []
    for part in parts:
        buffer += b'\xff' * gap
        start.append(len(buffer))
        buffer += part
        end.append(len(buffer))
    columns = decode_columns(SCHEMA, np.frombuffer(bytes(buffer), np.uint8), np.array(start),
                             np.array(end), WANTED)
    for name in WANTED:
        wanted = [thing[name.split('.')[-1]] for thing in batch]
        assert [columns[name][row] for row in range(len(batch))] == wanted


@settings(max_examples=80, deadline=None)
@given(thing=things, keep=st.floats(0, 1), changes=st.lists(
    st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4))
def test_damaged_messages_are_refused(outside, thing, keep, changes):
    """Cut and changed bytes: a value or InvalidData, in both ways of reading."""
    data = bytearray(serialise(outside, thing))
    for place, value in changes:
        data[place % len(data)] = value
    data = bytes(data[:int(keep * len(data))])
    for decode in (
            lambda: decode_message(SCHEMA, data),
            lambda: decode_columns(SCHEMA, np.frombuffer(data, np.uint8), np.array([0]),
                                   np.array([len(data)]), WANTED)):
        try:
            decode()
        except InvalidData as error:
            assert 'some_msgs/Thing' in str(error)


PLAIN = """uint8 tiny
string text
float64 wide
int16 small
Inner inner
string more
uint32 last
===
MSG: some_msgs/Inner
bool yes
float32 half
"""


def test_bulk_encoding_is_read_by_rosbags():
    """Columns into messages: the same bytes as rosbags writes."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(PLAIN.replace('===\n', '=' * 80 + '\n'), NAME))
    columns = {'tiny': np.arange(5), 'text': 'größer', 'wide': np.linspace(0, 1, 5),
               'inner.yes': np.array([True, False, True, True, False]), 'inner.half': 0.5,
               'last': 2**32 - np.arange(1, 6)}
    encoded = encode_columns(parse_schema(NAME, PLAIN), columns, 5)
    for row, data in enumerate(encoded):
        message = store.types[NAME](
            tiny=row, text='größer', wide=columns['wide'][row], small=0,
            inner=store.types['some_msgs/msg/Inner'](yes=bool(columns['inner.yes'][row]),
                                                     half=0.5),
            more='', last=2**32 - 1 - row)
        assert data.tobytes() == bytes(store.serialize_cdr(message, NAME))


@pytest.mark.parametrize(('text', 'words'), [
    ('float64', "schema of some_msgs/msg/Thing: wanted \"type name\", got 'float64'"),
    ('Other other', 'the definition of some_msgs/Other is missing'),
    ('Thing again', 'some_msgs/Thing contains itself'),
    ('int8 a\n===\nint8 b', 'wanted "MSG: package/Type" after the line of "="'),
    ('A a\n' + ''.join(f'===\nMSG: x/{name}\n{after} n\n' for name, after in zip(
        'AB', 'BA', strict=True)).replace('MSG: x', 'MSG: some_msgs'), 'contains itself'),
])
def test_schemas_that_make_no_sense_are_refused_with_words(text, words):
    """The log was written wrongly; nothing is guessed."""
    with pytest.raises(InvalidData, match=words):
        parse_schema(NAME, text)


def test_deep_and_wide_schemas_end_soon():
    """Forty levels of two members each are 2^40 paths: they are refused, not walked."""
    text = 'T0 a\n' + ''.join(
        f'===\nMSG: some_msgs/T{level}\nT{level + 1} a\nT{level + 1} b\n' for level in range(40))
    with pytest.raises(InvalidData, match='contains itself'):
        parse_schema(NAME, text + '===\nMSG: some_msgs/T40\nint8 a\n')


def test_wide_schemas_are_not_walked_to_the_end():
    """Thirty levels of two members each are a legal schema with 2^30 fields."""
    text = 'T0 a\n' + ''.join(
        f'===\nMSG: some_msgs/T{level}\nT{level + 1} a\nT{level + 1} b\n' for level in range(30))
    schema = parse_schema(NAME, text + '===\nMSG: some_msgs/T30\nint8 a\n')
    with pytest.raises(InvalidData, match='has more than 1000 fields'):
        decode_columns(schema, np.zeros(9, np.uint8), np.array([0]), np.array([9]), ['a'])
    with pytest.raises(InvalidData, match='the message ends early'):
        decode_message(schema, b'\0\1\0\0' + bytes(100))


@pytest.mark.parametrize(('text', 'wanted', 'words'), [
    ('string[] names\nint8 a', ['a'], 'names: sequences of texts or messages cannot be read in'),
    ('int8 a', ['b'], 'wanted the field b, the log has a; it was written with another version'),
    ('wstring a', ['a'], 'cannot be read in bulk'),
])
def test_what_cannot_be_read_in_bulk_is_refused_with_words(text, wanted, words):
    """No value is made up."""
    data = np.frombuffer(b'\0\1\0\0' + bytes(20), np.uint8)
    with pytest.raises(InvalidData, match=words):
        decode_columns(parse_schema(NAME, text), data, np.array([0]), np.array([24]), wanted)


@pytest.mark.parametrize(('data', 'words'), [
    (b'', r'wanted little-endian CDR \(00 01\), got nothing'),
    (b'\0\0\0\0\1', r'wanted little-endian CDR \(00 01\), got 00 00'),
    (b'\0\1\0\0', 'the message ends early, after 4 bytes'),
])
def test_single_messages_that_are_none_are_refused_with_words(data, words):
    """Big endian, empty, cut."""
    with pytest.raises(InvalidData, match=words):
        decode_message(parse_schema(NAME, 'int8 a'), data)
    with pytest.raises(InvalidData, match='wide texts'):
        decode_message(parse_schema(NAME, 'wstring a'), b'\0\1\0\0' + bytes(9))

# SPDX-License-Identifier: Apache-2.0
"""Messages with any value that their fields can hold, by the types of the fields."""

import array
import importlib
import re

from hypothesis import strategies as st

WHOLE = {
    'uint8': (0, 2**8 - 1), 'int8': (-(2**7), 2**7 - 1), 'uint16': (0, 2**16 - 1), 'int16': (-(2**15), 2**15 - 1),
    'uint32': (0, 2**32 - 1), 'int32': (-(2**31), 2**31 - 1), 'uint64': (0, 2**64 - 1),
    'int64': (-(2**63), 2**63 - 1),
}
ODD = [
    '', ' ', 'run', 'run_part2', 'run_part1', 'run_part999999999', '..', '.', '../run', '/etc', 'a/b', 'a\nb',
    '\r\n', '\x1b[2J', '\u202e', '\ufeff', 'x' * 300, 'ü' * 130, '\U0001f600' * 70, "'", '"; rm', '%s', '{}', 'nan',
    'machine', 'table', '/table', 'a/table', 'table/', 'diagonal', '-', '_', 'CON', '\x7f', '\u2028', '%n', '[red]',
    '0',
]
TEXTS = st.one_of(
    st.sampled_from(ODD), st.text(st.characters(exclude_categories=('Cs',), exclude_characters='\0'), max_size=20)
)
"""Texts as ROS can carry them: valid UTF-8 without a zero."""
REALS = st.one_of(
    st.floats(-1, 1),
    st.floats(),
    st.sampled_from(
        [0.0, -0.0, 1e-9, 0.1, 1e150, -1e150, 1e308, -1e308, 5e-324, float('nan'), float('inf'), float('-inf')]
    ),
)


def whole(low, high):
    """Return whole numbers of a range: small ones, its ends, any."""
    near = st.sampled_from([value for value in (0, 1, 2, 3, 4, low, low + 1, high - 1, high) if low <= value <= high])
    return st.one_of(st.integers(max(low, 0), min(high, 20)), near, st.integers(low, high))


def messages(kind, lists=4, **fields):
    """Return messages of a class.

    lists: most values in a sequence; fields: strategies by the name of a field, at whatever depth.
    """
    return st.fixed_dictionaries(parts_of(kind, lists, fields)).map(lambda found: with_values(kind(), found))


def changed(message, lists=4, **fields):
    """Return messages like one, of which up to three fields are any other value of theirs."""
    kind = type(message)
    parts, values = (
        parts_of(kind, lists, fields),
        {name: getattr(message, name) for name in kind.get_fields_and_field_types()},
    )
    return (
        st.sets(st.sampled_from(list(parts)), max_size=3)
        .flatmap(lambda names: st.fixed_dictionaries({name: parts[name] for name in sorted(names)}))
        .map(lambda found: with_values(kind(), {**values, **found}))
    )


def parts_of(kind, lists, fields):
    """Return the strategies of the fields of a class, by name."""
    return {
        name: fields[name] if name in fields else values(spelling, lists, fields)
        for name, spelling in kind.get_fields_and_field_types().items()
    }


def with_values(message, values):
    """Return a message whose fields have been set."""
    for name, value in values.items():
        setattr(message, name, value)
    return message


def values(spelling, lists, fields):
    """Return the values of a field of this type."""
    sequence = re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>|(.+)\[(\d+)\]', spelling)
    if sequence:
        element = sequence[1] or sequence[3]
        most = min(int(sequence[2] or lists), lists)
        exactly = None if sequence[4] is None else int(sequence[4])
        made = st.lists(
            values(element, lists, fields), min_size=exactly or 0, max_size=most if exactly is None else exactly
        )
        return made.map(lambda found: array.array('d', found)) if element == 'double' and exactly is None else made
    if spelling in WHOLE:
        return whole(*WHOLE[spelling])
    if spelling == 'boolean':
        return st.booleans()
    if spelling in ('double', 'float'):
        return REALS
    if spelling == 'octet':
        return st.binary(min_size=1, max_size=1)
    if spelling.startswith('string'):
        return TEXTS
    return messages(_class(*spelling.split('/')), lists, **fields)


def _class(package, name):
    """Return the class of a nested type, requests and responses of services included."""
    service, _, part = name.partition('_')
    if part in ('Request', 'Response'):
        return getattr(getattr(importlib.import_module(f'{package}.srv'), service), part)
    return getattr(importlib.import_module(f'{package}.msg'), name)


def is_plain(words):
    """Return whether words are one line that a terminal can show as it is."""
    return all(letter.isprintable() for letter in words)

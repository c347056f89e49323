# SPDX-License-Identifier: Apache-2.0
"""Messages of a log from their CDR bytes, by the schemas that it carries and mcap-ros2-support, within bounds."""

import contextlib
import re
import struct
from collections.abc import Callable
from functools import lru_cache
from io import StringIO
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from rosette_ros.core.run.errors import InvalidData, plain
from rosette_ros.io.safe_yaml import BAD_VALUE

MAX_MESSAGE, MAX_SCHEMA = 1 << 22, 1 << 16
"""Longer messages and schemas are not decoded, bytes: error motions of 10 000 balls take 1 MB."""
MAX_STRUCTURES, MOST_NESTED = 1 << 17, 12
"""The same of messages with arrays of messages, or with so many within: each takes 0.2 kB and 2 µs, at most one a byte
and level; a diagnosis of 100 candidates takes 30 kB. Types within a type are as many at most."""
_NESTED = re.compile(r'^[ \t]*(?:\w+/)*(?!MSG:)[A-Z]\w*(\[)?', re.MULTILINE)


class _Payload(bytes):
    """Bytes of a message: a slice of them is whole, or raises ValueError; text that is no UTF-8 is replaced."""

    def __getitem__(self, key: Any) -> Any:
        found = super().__getitem__(key)
        if isinstance(key, slice) and len(found) < key.stop - key.start:
            raise ValueError('ends early')
        return _Payload(found)

    def decode(self, encoding: str = 'utf-8', errors: str = 'replace') -> str:
        return super().decode(encoding, 'replace')


@lru_cache(maxsize=64)
def message_decoder(type_name: str, schema_text: str) -> Callable[[bytes], SimpleNamespace]:
    """Return the function that decodes the CDR bytes of a type by its ros2msg text.

    Raises InvalidData where the text is no definition; so does the function where bytes end early or are no CDR."""
    if not schema_text.strip():
        raise InvalidData(f'the log has no definition of {type_name}; record it where its package is installed')
    if len(schema_text) > MAX_SCHEMA:
        raise InvalidData(f'schema of {type_name}: expected at most {MAX_SCHEMA} bytes, found {len(schema_text)}')
    nested = _NESTED.findall(schema_text)
    most = MAX_STRUCTURES if any(nested) or len(nested) > MOST_NESTED else MAX_MESSAGE
    if (types := len(re.findall('^MSG:', schema_text, re.MULTILINE))) > MOST_NESTED:
        raise InvalidData(f'schema of {type_name}: expected at most {MOST_NESTED} types within it, found {types}')
    printed = StringIO()  # the parser of the library prints the line that is wrong
    try:
        with contextlib.redirect_stderr(printed):
            decoder = DecoderFactory().decoder_for('cdr', Schema(1, schema_text.encode(), 'ros2msg', type_name))
    except Exception as error:  # it has many errors of its own and no base of them
        raise InvalidData(f'schema of {type_name}: expected a ros2msg definition, found one that is none: '
                          f'{plain(printed.getvalue() or str(error), 200)}; the log was written wrongly') from error

    def decode(data: bytes) -> SimpleNamespace:
        if data[:2] not in (b'\0\0', b'\0\1'):
            got = data[:2].hex(' ') or 'nothing'
            raise InvalidData(f'{type_name}: expected CDR (00 00 or 00 01), found {got}')
        if len(data) > most:
            raise InvalidData(f'{type_name}: expected a message of at most {most} bytes, found {len(data)}')
        try:
            decoded: SimpleNamespace = decoder(_Payload(data))
            return decoded
        except (struct.error, IndexError) as error:
            raise InvalidData(f'{type_name}: ends early, after {len(data)} bytes') from error
        except (RuntimeError, *BAD_VALUE) as error:
            raise InvalidData(f'{type_name}: cannot be decoded: {plain(str(error), 200)}') from error

    return decode

# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can mend: each says what was expected, what was found, where, and what to do."""

import difflib
import json
import re
from collections.abc import Collection, Mapping
from typing import Any

MOST_LISTED = 24
"""Names that an error lists; of more it says the nearest."""
_CONTROL = re.compile('[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]')


class RosetteError(Exception):
    """Base of all errors that are reported to the user in one line."""


class InvalidData(RosetteError):
    """Readings, files or messages that do not mean what they should."""


class InvalidPlan(RosetteError):
    """A measuring scheme that cannot be carried out."""


class InvalidModel(RosetteError):
    """A model, effect or term that does not exist or cannot be used."""


class InvalidConfig(RosetteError):
    """A configuration value that is missing, misspelt or out of range."""


class NotDeterminable(RosetteError):
    """Too little data: the message names what cannot be determined."""


class CellError(RosetteError):
    """A running cell did not answer, refused, or stopped."""


def plain(text: str, most: int = 500) -> str:
    """Return text of outside origin as one line of at most `most` characters; what is not printable becomes a space."""
    kept = text if len(text) <= most else f'{text[:most]}...'
    if not kept.isprintable():
        kept = ''.join(letter if letter.isprintable() else ' ' for letter in kept)
    return ' '.join(kept.split())


def visible(text: str) -> str:
    """Return text for a terminal: what would control it, such as an escape in the name of a file, becomes '?'."""
    return _CONTROL.sub('?', text)


def visible_json(mapping: Mapping[str, Any]) -> str:
    """Return one JSON object, strict (no NaN, no Infinity), in which what would control a terminal is escaped."""
    text = json.dumps(mapping, allow_nan=False, ensure_ascii=False)
    return _CONTROL.sub(lambda found: f'\\u{ord(found[0]):04x}', text)


def unknown(name: str, known: Collection[str]) -> str:
    """Return the words for a name that is none of those known: these where they are few, and the nearest."""
    near = difflib.get_close_matches(name, known, 1) or [one for one in known if name and name in one]
    wanted = f'one of {", ".join(known)}' if len(known) <= MOST_LISTED else f'one of {len(known)} names'
    return f'expected {wanted}, found {name!r}{f"; did you mean {near[0]!r}?" if near else ""}'


def unknown_name(what: str, name: str, known: Collection[str], listed_by: str = '') -> str:
    """Return the words for a name that does not exist: the nearest one, else all of a few, else what lists them."""
    near = difflib.get_close_matches(name, known, 1) or [one for one in known if name and name in one]
    if near:
        return f'Unknown {what} {name!r}. Did you mean {near[0]}?'
    return f'Unknown {what} {name!r}. ' + (f'{listed_by} lists them.' if listed_by else f'Known: {", ".join(known)}.')


def counted(number: int, one: str, several: str = '') -> str:
    """Return a number with its noun: '1 answer', '3 answers'; several: the plural where it is not `one` with an s."""
    return f'{number} {one if number == 1 else several or f"{one}s"}'


KINDS = ((bool, 'true or false'), (str, 'a text'), (int, 'a whole number'), (float, 'a number'), (Mapping, 'a mapping'),
         ((list, tuple), 'a list'), (type(None), 'nothing'))
"""Kinds of values that a file may hold, as a user says them."""


def kind_of(value: object) -> str:
    """Return of which kind a value is, in words."""
    return next((words for kind, words in KINDS if isinstance(value, kind)), 'something else')


def one_line(error: Exception) -> str:
    """Return the words of an error as every interface prints them."""
    return ' '.join(str(error).split())

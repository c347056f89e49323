# SPDX-License-Identifier: Apache-2.0
"""The CSV form of plan and plate files: lines `# key: value`, the names of the columns, then the rows."""

import csv
import difflib
import re
from collections.abc import Collection

from rosette_ros.core.errors import RosetteError

_IS_TABLE = re.compile(rb'^"?#\s*schema\s*:', re.MULTILINE)


def is_keyed_table(data: bytes) -> bool:
    """Return whether the bytes of a file are such a table."""
    return _IS_TABLE.search(data) is not None


def meant(key: str, known: Collection[str]) -> str:
    """Return the known key that a misspelt one means, '' where it is another program's, or a remark."""
    return next(iter(difflib.get_close_matches(key, known, 1, 0.75)), '')


def keyed_table(data: bytes, source: str, known: Collection[str],
                wrong: type[RosetteError]) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Return the texts of the known keys and of the columns; other keys are skipped.

    Raises `wrong`, naming key or row, where it is no table, a key is given twice or misspelt: it would be ignored."""
    try:
        lines = [line for line in data.decode('utf-8-sig').splitlines() if line.strip(' \t,;')]
    except UnicodeDecodeError as error:
        raise wrong(f'{source}: wanted UTF-8 text, got byte {data[error.start]:#04x}') from None
    notes = [line.strip('",; \t')[1:].partition(':') for line in lines if line.startswith(('#', '"#'))]
    keys = dict[str, str]()
    for key, text in ((key.strip(), text.strip()) for key, separator, text in notes if separator):
        if key in keys:
            raise wrong(f'{source}: wanted the key {key} once, got it again: {text!r:.40}; remove one of them')
        if key in known:
            keys[key] = text
        elif near := meant(key, known):
            raise wrong(f'{source}: wanted the key {near}, got {key!r:.80}; correct it')
    head, *rows = list(csv.reader(line for line in lines if not line.startswith(('#', '"#')))) or [[]]
    head = [name.strip() for name in head]
    for number, row in enumerate(rows, 1):
        if len(row) != len(head):
            raise wrong(f'{source}: row {number}: wanted {len(head)} cells, {", ".join(head)}, got {len(row)}')
    if len({*head}) < len(head):
        raise wrong(f'{source}: wanted each column once, got {", ".join(head)}')
    if head and not rows:
        raise wrong(f'{source}: wanted rows below {", ".join(head)}, got none')
    return keys, {name: list(column) for name, column in zip(head, zip(*rows))}

# SPDX-License-Identifier: Apache-2.0
"""Tables that are there already, as a DataFrame or columns by name, and files that a laboratory's own reader opens."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.io.ball_centre_table import parse_csv
from rosette_ros.io.csv_parser import proposal_for, read_columns
from rosette_ros.io.table_heading import KEYS, SCHEMA
from rosette_ros.plugins import added

GROUP = 'rosette.readers'
KNOWN = ('', '.csv', '.mcap', '.txt')
"""Endings of files that need no reader of their own."""
Columns = Mapping[str, object]
"""What is which column, as of `--columns`, and what the heading of a table says, such as radius_mm."""
Reader = Callable[[Path], Any]
"""From the path of a file to a DataFrame or columns by name, or to (these, Columns)."""
READERS: dict[str, Reader] = {}
"""Readers that were added in this process, by the ending of their files without its dot."""


def own_reader(path: str | Path) -> Reader | None:
    """Return the reader for the ending of a file, None where nobody added one."""
    ending = Path(path).suffix.lower()
    if ending in KNOWN or Path(path).is_dir():
        return None
    return READERS.get(ending[1:]) or added(GROUP).get(ending[1:])


def read_own(read: Reader, path: str | Path) -> Run:
    """Return the Run of a file by its own reader; raises InvalidData as `run_of_table`."""
    made = read(Path(path))
    table, columns = made if isinstance(made, tuple) else (made, None)
    return run_of_table(table, columns, str(path))


def run_of_table(table: Any, columns: Columns | None = None, source: str = 'table') -> Run:
    """Return the Run of a table of ball centres, row by row in measuring order.

    table: a DataFrame of pandas or any other library, or a mapping of columns, each (N,); columns: what is which column
    where they have other names than in a ball-centre table, and keys of its heading, such as radius_mm; source: what
    errors call it. Raises InvalidData as for a file."""
    seen = getattr(table, 'columns', table)
    names = list(seen) if isinstance(seen, Iterable) else []
    if not names or not all(isinstance(name, str) for name in names):
        raise InvalidData(f'{source}: expected a DataFrame, or columns by name, found {type(table).__name__}')
    given = {key: str(value) for key, value in (columns or {}).items()}
    heading = {key: value for key, value in given.items() if key in KEYS or key.startswith('radius_')}
    mapped = given if len(given) > len(heading) else None
    text = io.StringIO()
    if not mapped:
        for key, value in {'schema': SCHEMA, **heading}.items():
            print(f'# {key}: {value}', file=text)
    rows = csv.writer(text, lineterminator='\n')
    rows.writerow(names)
    rows.writerows(zip(*(map(_cell, _values(table[name])) for name in names), strict=True))
    data = text.getvalue().encode()
    if not mapped and (proposal := proposal_for(data, source)):
        raise InvalidData(f'{source}: expected the columns and the radius of a ball-centre table, found '
                          f'{",".join(names):.200}; {proposal.advice(source)}')
    return parse_csv(data, source, read_columns(mapped))


def _values(column: Any) -> Iterable[Any]:
    return column.tolist() if hasattr(column, 'tolist') else column  # type: ignore[no-any-return]


def _cell(value: Any) -> str:
    """Return a value as a cell; what is missing (None, NaN, NaT) is empty."""
    return '' if value is None or value != value else repr(value) if isinstance(value, float) else str(value)

# SPDX-License-Identifier: Apache-2.0
"""The cells of a line of a table as text: the one place that meets the refusals of the module csv."""

import csv

from rosette_ros.core.run.errors import InvalidData, RosetteError


def cells_of(text: str, source: str, line: int, separator: str = ',', kind: type[RosetteError] = InvalidData
             ) -> list[str]:
    """Return the cells of a line; raises an error of a kind, which names file and line."""
    try:
        return next(csv.reader([text], delimiter=separator, strict=True)) if '"' in text else text.split(separator)
    except csv.Error as error:
        raise kind(f'{source}: line {line}: expected cells with closed quotes, of at most {csv.field_size_limit()} '
                   f'characters, found: {error}') from error

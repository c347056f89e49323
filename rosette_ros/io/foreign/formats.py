# SPDX-License-Identifier: Apache-2.0
"""The formats of other programs that are read: a format is a file beside this one, and a line here."""

from collections.abc import Callable

from rosette_ros.io.foreign import aqdef, calypso, qif
from rosette_ros.io.foreign.foreign_table import ForeignTable

READERS: dict[str, Callable[[str, str], ForeignTable | None]] = {
    'CALYPSO characteristics': calypso.read,
    'Q-DAS K-fields (AQDEF)': aqdef.read,
    'QIF results': qif.read,
}
"""Reader by name of the format. It takes the text of a file and what errors call it; it returns None where the text is
of another format, and raises InvalidData where it is of this one but cannot be read."""


def read_foreign(text: str, source: str) -> tuple[str, ForeignTable] | None:
    """Return the name of the format and the table of a text of another program; None for any other text.

    Raises InvalidData as the readers do."""
    for name, read in READERS.items():
        if (table := read(text, source)) is not None:
            return name, table
    return None

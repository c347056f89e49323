# SPDX-License-Identifier: Apache-2.0
"""The formats of other programs that are read: a format is a file beside this one, and a line here."""

from collections.abc import Callable
from pathlib import Path

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.foreign import aqdef, calypso, pcdmis, qif
from rosette_ros.io.foreign.foreign_table import ForeignTable

READERS: dict[str, Callable[[str, str], ForeignTable | None]] = {
    'CALYPSO characteristics': calypso.read,
    'Q-DAS K-fields (AQDEF)': aqdef.read,
    'QIF results': qif.read,
    'PC-DMIS report': pcdmis.read,
}
"""Reader by name of the format. It takes the text of a file and what errors call it; it returns None where the text is
of another format, and raises InvalidData where it is of this one but cannot be read."""


def pair_of(path: str | Path) -> tuple[Path, Path] | None:
    """Return the files with descriptions and values of a Q-DAS pair (.dfd, .dfx) of which one is named; None of others.

    Raises InvalidData where the other one is not beside it."""
    path = Path(path)
    if path.suffix.casefold() not in aqdef.PAIR:
        return None
    beside = {one.suffix.casefold(): one for one in path.parent.iterdir() if one.stem == path.stem} if (
        path.is_file()) else {}
    lacking = [end for end in aqdef.PAIR if end not in beside]
    if lacking and beside:
        raise InvalidData(f'{path}: expected a Q-DAS pair, descriptions (.dfd) and values (.dfx), found no '
                          f'{path.stem}{lacking[0]} beside it; put it there, or export one file (.dfq)')
    return None if lacking else (beside['.dfd'], beside['.dfx'])


def read_foreign(text: str, source: str) -> tuple[str, ForeignTable] | None:
    """Return the name of the format and the table of a text of another program; None for any other text.

    Raises InvalidData as the readers do."""
    for name, read in READERS.items():
        if (table := read(text, source)) is not None:
            return name, table
    return None

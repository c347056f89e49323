# SPDX-License-Identifier: Apache-2.0
"""Whether the messages of a source tree are those that were built: a node with other ones would end without a word."""

import os
from collections.abc import Mapping
from pathlib import Path

from rosette_ros.core.errors import CellError

DEFINITIONS = Path(__file__).parents[2] / 'msg_defs'
"""The definitions in the source tree; an installed package has none beside it."""


def check_messages(definitions: Path = DEFINITIONS, environ: Mapping[str, str] = os.environ) -> None:
    """Raise CellError where rosette_msgs was built from other definitions than those of the source tree.

    definitions: folder with msg, srv and action; environ: mapping with AMENT_PREFIX_PATH, of which the first prefix
    with rosette_msgs counts. Nothing is checked where one of both is not there."""
    prefixes = (Path(prefix) for prefix in environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if prefix)
    built = next((share for prefix in prefixes if (share := prefix / 'share' / 'rosette_msgs').is_dir()), None)
    if built is None:
        return
    for path in sorted(definitions.glob('*/*.*')):
        copy = built / path.relative_to(definitions)
        if not copy.exists() or copy.read_bytes() != path.read_bytes():
            raise CellError(f'messages: wanted rosette_msgs as {definitions} defines it, got a build in {built} in '
                            f'which {path.name} {"differs" if copy.exists() else "is missing"}: run make setup (in a '
                            'workspace: colcon build)')

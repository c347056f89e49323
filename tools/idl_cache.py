# SPDX-License-Identifier: Apache-2.0
"""Keeps parsed interface definitions on disk while the messages are built.

Every generator of code parses every definition, in a process of its own, and that is a third of the whole set-up.
"""

import hashlib
import os
import pickle
from pathlib import Path

FOLDER = 'ROSETTE_IDL_CACHE'


def cached(parse):
    """Return `parse`, a function of a text, that looks first into the folder that the environment names, if any."""
    folder = os.environ.get(FOLDER)
    if not folder:
        return parse

    def look_up_or_parse(text):
        path = Path(folder, hashlib.sha256(text.encode()).hexdigest())
        try:
            return pickle.loads(path.read_bytes())
        except FileNotFoundError:
            tree = parse(text)
            beside = path.with_suffix(f'.{os.getpid()}')
            beside.write_bytes(pickle.dumps(tree))
            beside.replace(path)
            return tree

    return look_up_or_parse

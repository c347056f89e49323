# SPDX-License-Identifier: Apache-2.0
"""Searches for what models lack, kept for all workers: what interfaces say of a run is told of one search.

A search is kept without its run and completed with the run at hand, whose file and name, on which no number depends,
may be others. Tests of the search itself (core, blind) search.
"""

import hashlib
import io
import pickle
from dataclasses import fields, replace
from pathlib import Path

from rosette_ros.core.diagnosis import diagnosis
from rosette_ros.core.effects.library import EFFECTS

_SEARCH = diagnosis.RunDiagnosis


class _Pickler(pickle.Pickler):
    def __init__(self, stream, run):
        super().__init__(stream, protocol=5)
        self._names = {id(one): name for name, one in _given(run).items()}

    def reducer_override(self, one):
        """Name what is given; unlike persistent_id, this is not asked about every number and text."""
        return (_known, (self._names[id(one)],)) if id(one) in self._names else NotImplemented


def _known(name):
    """Stand in a file for what is given under a name."""
    raise NotImplementedError(name)


class _Unpickler(pickle.Unpickler):
    def __init__(self, stream, run):
        super().__init__(stream)
        self._given = _given(run)

    def find_class(self, module, name):
        return self._given.__getitem__ if name == _known.__name__ else super().find_class(module, name)


def _given(run):
    """Return what no search owns: the run, the library, and the class, which has another in its place."""
    return {**EFFECTS, 'the run': run, 'the class': _SEARCH}


def _content(records):
    """Return the content of records as bytes, which do not tell whether equal parts of them are one object."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream)
    pickler.fast = True
    pickler.dump(records)
    return stream.getvalue()


class KnownSearches:
    """A folder of searches; `search` stands for the class of the package."""

    def __init__(self, folder: Path):
        folder.mkdir(exist_ok=True)
        self._folder, self._kept = folder, {}

    def search(self, run, model, without=''):
        """Return the search on a run, made or known."""
        numbers = [getattr(run, one.name) for one in fields(run) if one.name not in ('source', 'run_id', 'notes')]
        stated = replace(model, experience=model.experience and replace(model.experience))  # without what is derived
        about = _content((numbers, stated, without))
        path = self._folder / hashlib.sha256(about).hexdigest()
        if known := self._kept.get(path):
            if known[0] == run:
                return known[1]
            self.keep()
        if path.exists():
            with open(path, 'rb') as stream:
                search = _Unpickler(stream, run).load()
        else:
            search = _SEARCH(run, model, without)
        self._kept[path] = run, search, len(vars(search)) if path.exists() else 0
        return search

    def keep(self):
        """Write what has been made, and what is known more of a search than was read."""
        for path, (run, search, known) in self._kept.items():
            if len(vars(search)) > known:
                new = path.with_suffix(f'.{id(self)}')
                with open(new, 'wb') as stream:
                    _Pickler(stream, run).dump(search)
                new.replace(path)
        self._kept.clear()

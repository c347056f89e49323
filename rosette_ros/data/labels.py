# SPDX-License-Identifier: Apache-2.0
"""Texts of many rows where few differ: run ids, frame ids, remarks."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Labels:
    """N texts: names holds each different text once, code (N,) tells which name each row has."""

    names: tuple
    code: np.ndarray

    def __post_init__(self):
        """Freeze the codes."""
        code = np.array(self.code, dtype=np.int64)
        code.setflags(write=False)
        object.__setattr__(self, 'code', code)

    @staticmethod
    def of(texts):
        """Return the Labels of texts; Labels are returned as they are."""
        if isinstance(texts, Labels):
            return texts
        known = {}
        code = [known.setdefault(text, len(known)) for text in texts]
        return Labels(tuple(known), np.array(code, dtype=np.int64))

    @staticmethod
    def concatenate(parts):
        """Return the Labels of several, one after the other."""
        known = {}
        codes = [np.zeros(0, dtype=np.int64)]
        for part in parts:
            own = [known.setdefault(name, len(known)) for name in part.names]
            codes.append(np.array(own, dtype=np.int64)[part.code])
        return Labels(tuple(known), np.concatenate(codes))

    def __len__(self):
        """N."""
        return self.code.size

    def __getitem__(self, row):
        """Return the text of one row."""
        return self.names[self.code[row]]

    def take(self, rows):
        """Return the Labels of some rows (mask or positions)."""
        return Labels(self.names, self.code[rows])

    def equal(self, text):
        """Return where the text is `text`, (N,) bool."""
        return self.matching(lambda name: name == text)

    def matching(self, condition):
        """Return where `condition` holds for the text, (N,) bool."""
        holds = np.array([bool(condition(name)) for name in self.names], dtype=bool)
        return holds[self.code] if holds.size else np.zeros(len(self), dtype=bool)

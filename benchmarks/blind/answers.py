# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says of a run, read from its result alone."""

import re
import time
from dataclasses import dataclass
from typing import Any

from rosette_ros.analysis import diagnose
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.records import Run

Record = dict[str, Any]
"""One run of a table and what was said of it, by name."""


@dataclass(frozen=True)
class Claim:
    """One claimed effect: its name, its setting, and the names that it is said to look like."""

    effect: str
    setting: dict[str, float | str]
    alike: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """The claims of a diagnosis; unexplained: whether it says that something is left; text: what it depends on.

    rms: what is left, m; seconds: how long it took.
    """

    claims: tuple[Claim, ...]
    unexplained: bool
    text: str
    outcome: str
    sentence: str
    rms: float
    seconds: float

    @property
    def names(self) -> str:
        """The claimed names in their order, or '' for none."""
        return ' + '.join(claim.effect for claim in self.claims)


def ask(run: Run) -> tuple[Answer, Diagnosis]:
    """Return the Answer of the diagnosis of a run, and the diagnosis."""
    began = time.perf_counter()
    found = diagnose(run)
    seconds = time.perf_counter() - began
    claims = tuple(Claim(one.effect, {name: value if isinstance(value, str) else float(value)
                                      for name, value in one.setting.items()}, tuple(one.look_alikes))
                   for one in found.candidates if one.claimed)
    return Answer(claims, bool(found.unexplained), found.unexplained_text, found.verdict.outcome.value,
                  found.verdict.sentence, float(found.final.rms), seconds), found


VARIABLES = {
    'time': r'\btime\b', 'temperature': r'temperature', 'ball': r'\bballs?\b',
    'angle': r'table angle|table position|angle of the table', 'line': r'encoder|interpolation', 'travel': r'travel',
    'position': r'CMM position|place in the machine', 'machine': r'fixed in the machine|machine axes',
    'table_sense': r'sense of the (last )?table|table turns|backlash', 'cmm_sense': r"sense of the (last )?CMM|CMM's",
    'direction': r'direction of (the )?(last )?(approach|move|CMM)'}
"""Variables by the words with which a text tells them."""
PLACE = frozenset(('angle', 'ball', 'position'))
"""Any two of these are what all three are: the CMM position is the sum of the other two."""


def told_variables(text: str) -> set[str]:
    """Return the variables that a text tells; names of effects that it refuses are not among them."""
    text = re.sub(r', not as .*?(;|$)', r'\1', text)
    told = {name for name, words in VARIABLES.items() if re.search(words, text, re.IGNORECASE)}
    return told | PLACE if len(told & PLACE) > 1 else told


def told_axes(text: str) -> tuple[str, set[str]]:
    """Return the frame of the axes that a text tells ('machine', 'plate', 'polar' or '', any), and the axes.

    Radial and tangential are x and y of the polar frame.
    """
    axes = set(re.findall(r'\b([xyz])\b', text))
    polar = {axis for axis, word in (('x', 'radial'), ('y', 'tangential')) if word in text}
    axes |= polar | ({'z'} if re.search(r'\b(axial|vertical)', text) else set())
    return 'polar' if polar else 'plate' if re.search(r'plate.s (x|y)|plate (x|y)', text) else '', axes

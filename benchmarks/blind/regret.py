# SPDX-License-Identifier: Apache-2.0
"""What the search missed: the log evidence of what is hidden less that of the best hypothesis that was visited."""

from collections.abc import Sequence
from itertools import permutations
from math import log

from rosette_ros.core.diagnosis.diagnosis import search_of
from rosette_ros.core.diagnosis.hypotheses import Search
from rosette_ros.core.diagnosis.log_evidence import Member, State
from rosette_ros.core.diagnosis.noise_kinds import NOT_WHITE
from rosette_ros.core.run.records import Run

SETTLED = 1e-3
"""Log evidence by which the members of the truth have to gain for them to be refined in turn once more."""


def regret(run: Run, hidden: Sequence[str]) -> float | None:
    """Return it in white noise; None where nothing of the library is hidden, or this order hides a part of it."""
    found = search_of(run)
    search = Search(found.readings.white)
    visited = max(found.posterior.log_evidence(key) for key in found.posterior.keys if not key[1])
    visited -= log(1 - NOT_WHITE)  # which a hypothesis in white noise has as its prior
    made = [state for order in dict.fromkeys(permutations(hidden)) if (state := _of(search, order)) is not None]
    if not hidden or not made:
        return None
    return max(one.log_evidence for one in made) - visited


def _of(search: Search, names: Sequence[str]) -> State | None:
    """Return the State of some effects, which join in their order and are then searched again beside the others."""
    state = State(search.evidence, ())
    for name in names:
        member = _best(search, state, name)
        if member is None:
            return None
        state = State(search.evidence, (*state.members, member))
    while (better := search.settled(state)).log_evidence > state.log_evidence + SETTLED:
        state = better
    return better


def _best(search: Search, state: State, name: str) -> Member | None:
    """Return an effect at its best setting beside others, None where it cannot be seen."""
    offers = [one for one in state.offers(is_open=False) if one.family.name == name]
    return search.refined(state, offers[0]) if offers else None

# SPDX-License-Identifier: Apache-2.0
"""Effects that are not claimed, and what each would be worth beside all that is."""

from collections.abc import Sequence

from rosette_ros.core.diagnosis.cause import MissingEffect
from rosette_ros.core.diagnosis.log_evidence import Member, State
from rosette_ros.core.diagnosis.run_search import RunSearch
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import NotDeterminable

MOST_OTHERS = 8
"""Effects that are not claimed and are fitted to be shown."""


def candidates_of(search: RunSearch, claimed: Sequence[Member],
                  final: Fit) -> tuple[tuple[MissingEffect, ...], tuple[tuple[str, str], ...]]:
    """Return the best candidates that are not claimed, best first, and the names of those that have no fit, with the
    reason; final: the fit with all that is claimed."""
    if search.noiseless:
        return (), ()
    before = State(search.evidence, claimed)
    known = {one.name for one in claimed}
    out, refused = [], []
    for member in [one for one in before.offers(is_open=False) if one.family.name not in known][:MOST_OTHERS]:
        if search.evidence.dof <= len(before.basis) + len(member.rows):
            continue
        try:
            fitted = search.with_members([*claimed, member])
        except NotDeterminable:
            refused.append((member.name, 'its fit to these readings does not converge'))
            continue
        out.append(MissingEffect(
            member.name, member.setting, parameters=fitted.effects[-1].parameters, before=final.rms, after=fitted.rms,
            time_unit=search.run.time_unit, is_there=search.posterior.of(member.name), p=search.p(member.gain),
            visible_fraction=member.sensitivity, claimed=False))
    return tuple(out), tuple(refused)

# SPDX-License-Identifier: Apache-2.0
"""The table of names: every effect that files, messages and the screen may name."""

from rosette_ros.core.effects import ball_effects as ball
from rosette_ros.core.effects import frame_effects as frame
from rosette_ros.core.effects import plate_effects as plate
from rosette_ros.core.effects import reading_effects as reading
from rosette_ros.core.effects import table_effects as table
from rosette_ros.core.effects.effect import Effect
from rosette_ros.core.effects.free_forms import FREE_FORMS
from rosette_ros.core.errors import InvalidModel, unknown
from rosette_ros.core.records import Run

EFFECTS: dict[str, Effect] = {one.name: one for one in (
    *frame.FRAME_EFFECTS, *table.TABLE_EFFECTS, *plate.PLATE_EFFECTS, ball.BallSlip(), ball.BallCreep(),
    ball.BallRattle(), ball.BallMachineOffset(), ball.BallSag(), ball.BallForm(), *frame.CMM_EFFECTS,
    reading.CmmReversal(), reading.CmmReversalPosition(), reading.ProbeApproach(), reading.Outlier())}
"""By name; their order is that of every table and page."""


OF_ANY_TABLE = sum(not one.needs_tilt for one in EFFECTS.values())
"""How many of them any table can have, whichever way its axis points."""


def effects_of(run: Run) -> dict[str, Effect]:
    """Return the effects that the cell of a run can have, by name."""
    return {name: one for name, one in EFFECTS.items() if one.can_be_in(run)}


def effect(name: str) -> Effect:
    """Return the effect or free form of a name; raise InvalidModel, listing the known ones, if there is none."""
    if name not in EFFECTS and name not in FREE_FORMS:
        raise InvalidModel(f'effect: {unknown(name, (*EFFECTS, *FREE_FORMS))}')
    return EFFECTS.get(name) or FREE_FORMS[name]


class BaseEffect(Effect):
    """A term of the base model, which has no columns: what it is called and what it means."""

    carries = 'all'

    def __init__(self, name: str, plain: str, meaning: str, look: str, formula: str, depends_on: str,
                 source: str) -> None:
        self.name, self.plain, self.meaning = name, plain, meaning
        self.look, self.formula, self.source = look, formula, source
        self.depends_on = (depends_on,)


BASE_EFFECTS = (
    BaseEffect('table_motions', 'error motions of the table',
               'The six error motions of the table: the result of a calibration.',
               'The bearing, the encoder and the correction tables of the rotary table.',
               'T_i + Theta_i x R_z(phi_i) b_j', 'table_position', 'Kniel et al. (2019), equations (1) to (16)'),
    BaseEffect('plate_deviations', 'deviations of the plate',
               'The balls are not at their nominal positions; the plate need not be calibrated.',
               'No fault: every plate has them, and they turn with it.', 'R_z(phi_i) P_j', 'ball',
               'Kniel et al. (2019), section 2.1'),
    BaseEffect('cmm_deviations', 'deviations of the CMM',
               'At each of its positions the CMM has a constant measuring error.',
               'Correction of the linear axes; squareness and scales of the CMM.', 'M_k', 'cmm_position',
               'Kniel et al. (2019), section 2.1'))

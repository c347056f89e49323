# SPDX-License-Identifier: Apache-2.0
"""The table of names: every effect that files, messages and the screen may name."""

from rosette_ros.core.effects.frame import FRAME_EFFECTS
from rosette_ros.core.effects.plate import PLATE_EFFECTS
from rosette_ros.core.effects.reading import READING_EFFECTS
from rosette_ros.core.effects.table import TABLE_EFFECTS
from rosette_ros.core.errors import InvalidModel

EFFECTS = {effect.name: effect
           for effect in (*FRAME_EFFECTS, *TABLE_EFFECTS, *PLATE_EFFECTS, *READING_EFFECTS)}


def effect(name):
    """Return the effect of a name; raise InvalidModel, listing the known ones, if there is none."""
    if name not in EFFECTS:
        raise InvalidModel(f'effect: wanted one of {", ".join(EFFECTS)}, got {name!r}')
    return EFFECTS[name]

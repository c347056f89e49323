# SPDX-License-Identifier: Apache-2.0
"""What every group of settings shares: frozen, no unknown keys, no infinities."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Strict(), Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(gt=0, allow_inf_nan=False)]
Vector = Annotated[tuple[Number, Number, Number], Strict(False)]
Pair = Annotated[tuple[Number, Number], Strict(False)]
Seed = Annotated[int, Strict(), Field(ge=0, lt=2**63)]


class Settings(BaseModel):
    """A group of settings."""

    model_config = ConfigDict(frozen=True, extra='forbid', strict=True, allow_inf_nan=False)

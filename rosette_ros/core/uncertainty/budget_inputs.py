# SPDX-License-Identifier: Apache-2.0
"""What an uncertainty budget needs besides the readings: typed entries, each with words; what is missing stays open."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rosette_ros.core.model.experience import Experience
from rosette_ros.core.run.records import Floats, Run
from rosette_ros.core.run.touches import TOUCHES, USUAL
from rosette_ros.core.uncertainty.stated_environment import Environment


class Entry(NamedTuple):
    """A number of a section: what it is, the factor to SI units, its default, None where it has to be given.

    signed: whether it may be negative; chosen: the numbers that it may be, empty for any."""

    words: str
    factor: float = 1e-6
    default: float | None = None
    signed: bool = False
    chosen: tuple[int, ...] = ()


_RANGE = Entry('largest change of temperature in the run, K; needed where no temperature is recorded', 1.0, 0.0)
SECTIONS: dict[str, tuple[str, dict[str, Entry]]] = {
    'touches': ('scatter of single touches, where the log holds none', {
        'u_um': Entry('standard deviation of a touch along its normal'),
        'number': Entry('touches of a ball', 1.0, float(USUAL), chosen=TOUCHES)}),
    'ball_form': ('form of the balls', {
        'form_um': Entry('form deviation of a ball, as its certificate or grade states it'),
        'touches': Entry('touches of a ball; those of the log take its place', 1.0, float(USUAL), chosen=TOUCHES)}),
    'plate_expansion': ('thermal expansion of the plate relative to the scales of the CMM', {
        'coefficient_um_per_m_K': Entry('coefficient, plate less scales', default=0.0, signed=True),
        'u_um_per_m_K': Entry('standard uncertainty of the coefficient'), 'range_K': _RANGE}),
    'frame_expansion': ('thermal motion of the table in the machine', {
        'u_um_per_K': Entry('standard uncertainty of the motion along each axis'), 'range_K': _RANGE}),
    'alignment': ('table frame as it was found', {
        'origin_um': Entry('standard uncertainty of the origin, each axis', default=0.0),
        'tilt_urad': Entry('standard uncertainty of the direction of the axis, each component', default=0.0),
        'azimuth_urad': Entry('standard uncertainty of the direction to ball 1', default=0.0)}),
    'radius': ('mean radius of the circle of ball centres', {'u_um': Entry('standard uncertainty')})}
"""Sections of an inputs file: what they are, and their numbers."""
BOUNDS = 'hidden_effects'
"""The section of largest sizes of effects, rms over the readings."""
ENVIRONMENT = 'environment'
"""The section of what may move in a run, as standard deviations from run to run."""


@dataclass(frozen=True)
class BudgetInputs:
    """What is stated: values by section and entry, SI units; words by section, whence they are; dof by section.

    bounds: largest size by effect, m rms over the readings; environment: what may move in a run."""

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    dof: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, float] = field(default_factory=dict)
    environment: Environment | None = None

    @property
    def is_stated(self) -> bool:
        """Whether U is that of the budget: something is stated that is no bound."""
        return bool(self.values) or self.environment is not None

    def knowing(self, experience: Experience | None) -> 'BudgetInputs':
        """Return the same with what earlier runs of the cell have taught of its environment, where one is stated."""
        if self.environment is None or experience is None:
            return self
        return replace(self, environment=replace(self.environment, experience=experience))

    def __contains__(self, section: str) -> bool:
        return section in self.values

    def value(self, section: str, entry: str) -> float:
        """Return a value, SI unit; its default where it is not stated, 0 where the section is not."""
        if section not in self.values:
            return 0.0
        known = SECTIONS[section][1][entry]
        return self.values[section].get(entry, known.factor * (known.default or 0.0))


def temperature_course(run: Run) -> tuple[Floats, bool]:
    """Return the temperatures of a run less their mean, (N,), K, gaps filled along time, and True.

    Where none is known a steady course that changes by one in all, and False.
    """
    known = np.isfinite(run.temperature)
    is_recorded = bool(np.count_nonzero(known) >= 2)
    if is_recorded:
        order = np.argsort(run.time[known], kind='stable')
        course = np.interp(run.time, run.time[known][order], run.temperature[known][order])
    else:
        course = (run.time - run.time.min()) / (float(np.ptp(run.time)) or 1.0)
    return np.asarray(course - course.mean()), is_recorded

# SPDX-License-Identifier: Apache-2.0
"""Effects of the machine frame: the probe moves relative to the table."""

import numpy as np

from rosette_ros.core.effects.effect import Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.factored_effect import Cycle, Drift, FactoredEffect, Step, Temperature, WarmUp
from rosette_ros.core.effects.run_functions import unit
from rosette_ros.core.records import Floats, Run

_AXES = Searched('axes', '', 'which axes move: all three together or one alone')


class FrameEffect(FactoredEffect):
    """The machine frame moves along one axis or all three; quantities: of one axis, without its letter."""

    searched: tuple[Searched, ...] = (_AXES,)
    choices = grid(axes=('xyz', 'x', 'y', 'z'))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(one for quantity in self.quantities for one in per_axis(setting.word('axes'), quantity))

    def directions(self, run: Run) -> Floats:
        return np.stack([unit(axis, run.size) for axis in range(3)])

    def which(self, setting: Setting) -> tuple[int, ...]:
        return tuple('xyz'.index(axis) for axis in setting.word('axes'))


class FrameDrift(FrameEffect):
    name = 'frame_drift'
    plain = 'drift of the probe against the table'
    meaning = 'The probe drifts steadily relative to the table, in the frame of the machine.'
    look = ('Temperature of the hall and of the quill, time since switching on, draughts; '
            'let the machine soak or measure faster.')
    formula = 'd t'
    source = 'ISO 230-3 (drift over a stated period); GUM F.1.1.2'
    depends_on = ('time',)
    carries = 'all'
    quantities = (Quantity('d', 'm/s', 'drift rate along'),)
    function = Drift()


class FrameWarmup(FrameEffect):
    name = 'frame_warmup'
    plain = 'warm-up of the machine'
    meaning = 'The probe moves relative to the table while the machine warms up, and settles.'
    look = 'Drives, spindle and controller since switching on; start after a warm-up cycle.'
    formula = 'd (1 - exp(-t/tau))'
    source = 'ISO 230-3 (warm-up of the structure)'
    depends_on = ('time',)
    quantities = (Quantity('d', 'm', 'final displacement along'),)
    searched = (_AXES, Searched('tau', 's', 'time constant', 'scale'))
    function = WarmUp()


class FrameTemperature(FrameEffect):
    name = 'frame_temperature'
    plain = 'machine follows the temperature'
    meaning = 'The probe moves relative to the table with the measured temperature.'
    look = 'Air conditioning, sunlight, doors; the scales and the quill expand.'
    formula = 'd (T - T0)'
    source = 'ISO 230-3 (environmental temperature variation error)'
    depends_on = ('temperature',)
    carries = 'all'
    quantities = (Quantity('d', 'm/K', 'displacement per kelvin along'),)
    function = Temperature()


class FrameCycle(FrameEffect):
    name = 'frame_cycle'
    plain = 'periodic motion of the machine'
    meaning = 'The probe oscillates relative to the table with a fixed period in time.'
    look = 'Air conditioning that switches, cooling units, hydraulic or compressed air cycles.'
    formula = 'a cos(2 pi t/P) + b sin(2 pi t/P)'
    source = 'ISO 230-3 (environmental temperature variation error)'
    depends_on = ('time',)
    quantities = (Quantity('a', 'm', 'cosine amplitude along'), Quantity('b', 'm', 'sine amplitude along'))
    searched = (_AXES, Searched('period', 's', 'period', 'scale'))
    function = Cycle()


class FrameStep(FrameEffect):
    name = 'frame_step'
    plain = 'sudden shift of the machine'
    meaning = 'At one moment the probe shifted relative to the table, and stayed there.'
    look = 'A collision, an exchanged or requalified probe, an axis that was referenced again.'
    formula = 'd H(t - t0)'
    source = 'physics of probe requalification'
    depends_on = ('time',)
    carries = 'nothing'
    quantities = (Quantity('d', 'm', 'step along'),)
    searched = (_AXES, Searched('t0', 's', 'moment of the step, since the first reading', 'instant'))
    function = Step()

# SPDX-License-Identifier: Apache-2.0
"""Effects of the machine frame: the probe moves relative to the table."""

import numpy as np

from rosette_ros.core.effects.effect import Effect, Quantity, Searched, Setting, grid, per_axis
from rosette_ros.core.effects.factored_effect import (
    Curve,
    Cycle,
    Drift,
    FactoredEffect,
    LaggedTemperature,
    Onset,
    Pulse,
    Recovery,
    Step,
    Temperature,
    WarmUp,
    shortest,
)
from rosette_ros.core.effects.run_functions import along_machine, cmm_axes, cmm_axes_names, radial
from rosette_ros.core.records import Floats, Run


class FrameEffect(FactoredEffect):
    """The machine frame moves along one axis or all three; quantities: of one axis, without its letter."""

    chosen = (Searched('axes', '', 'which axes move: all three together or one alone'),)
    choices = grid(axes=('xyz', 'x', 'y', 'z'))

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(one for quantity in super().amplitudes(run, setting)
                     for one in per_axis(setting.word('axes'), quantity))

    def directions(self, run: Run) -> Floats:
        """Return the axes of the machine, (3, N, 3)."""
        return along_machine(run)

    def which(self, setting: Setting) -> tuple[int, ...]:
        return tuple(['xyz'.index(axis) for axis in setting.word('axes')])


class FramePulse(FrameEffect):
    name = 'frame_pulse'
    plain = 'shift of the probe for some time'
    meaning = 'For some time the probe was shifted relative to the table, and came back.'
    look = 'A door, a load on the table, a person or vehicle near the machine, a magnet or valve that was on.'
    formula = 'd (H(t - t0) - H(t - t1))'
    source = 'physics of loads'
    repeatable = True
    quantities = (Quantity('d', 'm', 'shift along'),)
    function = Pulse()

    def instants(self, run: Run, setting: Setting, name: str = 't0') -> Floats:
        """Return the instants beside that of a setting that leave the pulse readings enough."""
        other, found = setting.number('t1' if name == 't0' else 't0'), super().instants(run, setting, name)
        return found[np.abs(found - other) > shortest(run, np.minimum(found, other))]


class FrameRecovery(FrameEffect):
    name = 'frame_recovery'
    plain = 'shift of the probe that goes back'
    meaning = 'At one moment the probe shifted relative to the table, and went back ever more slowly.'
    look = 'A knock, a load or warm air that was there for a moment; a joint that springs back.'
    formula = 'd H(t - t0) exp(-(t - t0)/tau)'
    source = 'physics of loads and of thermal disturbances'
    quantities = (Quantity('d', 'm', 'shift at first along'),)
    function = Recovery()

    def instants(self, run: Run, setting: Setting, name: str = 't0') -> Floats:
        """Return the instants beside that of a setting from which the way back has readings enough."""
        found, tau = super().instants(run, setting, name), setting.number('tau')
        return found[tau >= shortest(run, found)]


class CmmScale(FactoredEffect):
    """The scales of the two axes of the CMM across the table axis change; quantities: of one, without its letter."""

    acts = 0, 1

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        return tuple(one for quantity in super().amplitudes(run, setting)
                     for one in per_axis(cmm_axes_names(run), quantity))

    def directions(self, run: Run) -> Floats:
        """Return the displacement of every reading along each axis, (2, N, 3)."""
        along = cmm_axes(run)
        return np.asarray(run.radius * (along @ radial(run.alpha).T)[..., None] * along[:, None])


class CmmSquareness(FactoredEffect):
    """The angle between these two axes changes."""

    def amplitudes(self, run: Run, setting: Setting) -> tuple[Quantity, ...]:
        """Return the rate of the angle between the two axes."""
        first, second = tuple(cmm_axes_names(run))
        return (Quantity('s', 'rad/s', f'rate of the squareness error of {second} to {first}'),)

    def directions(self, run: Run) -> Floats:
        """Return the displacement of every reading along the first axis, (1, N, 3)."""
        first, second = cmm_axes(run)
        return np.asarray((run.radius * radial(run.alpha) @ second)[:, None] * first)[None]


FRAME_EFFECTS: tuple[Effect, ...] = (
    FrameEffect('frame_drift', Drift(), Quantity('d', 'm/s', 'drift rate along'),
        plain='drift of the probe relative to the table',
        meaning='The probe drifts steadily relative to the table, in the frame of the machine.',
        look='Temperature of the hall and of the quill, time since switching on, draughts; '
             'let the machine soak or measure faster.',
        formula='d t',
        source='ISO 230-3 (drift over a stated period); GUM F.1.1.2'),
    FrameEffect('frame_drift_onset', Onset(), Quantity('d', 'm/s', 'drift rate along'),
        plain='drift of the probe from a moment',
        meaning='At one moment the probe begins to drift steadily relative to the table.',
        look='What was switched on, opened or loaded at that moment: a lamp, a door, a cooling unit, a workpiece.',
        formula='d max(0, t - t0)',
        source='ISO 230-3 (drift over a stated period)'),
    FrameEffect('frame_drift_curved', Curve(), Quantity('d', 'm/s', 'rate at the first reading along'),
        Quantity('c', 'm/s^2', 'half the change of the rate along'),
        plain='drift of the probe along a curve',
        meaning='The probe drifts relative to the table, and its rate changes steadily.',
        look='Temperature of the hall and of the quill; let the machine soak or measure faster.',
        formula='d t + c t^2',
        source='ISO 230-3 (drift over a stated period)'),
    FrameEffect('frame_warmup', WarmUp(), Quantity('d', 'm', 'final displacement along'),
        plain='warm-up of the machine',
        meaning='The probe moves relative to the table while the machine warms up, and settles.',
        look='Drives, spindle and controller since switching on; start after a warm-up cycle.',
        formula='d (1 - exp(-t/tau))',
        source='ISO 230-3 (warm-up of the structure)'),
    FrameEffect('frame_temperature', Temperature('m', ' along'),
        Quantity('d', 'm/K', 'displacement per kelvin along'),
        plain='machine follows the temperature',
        meaning='The probe moves relative to the table with the measured temperature.',
        look='Air conditioning, sunlight, doors; the scales and the quill expand.',
        formula='d (T - T0)',
        source='ISO 230-3 (environmental temperature variation error)'),
    FrameEffect('frame_temperature_lag', LaggedTemperature('m', ' along'),
        Quantity('d', 'm/K', 'displacement per kelvin along'),
        plain='drift of the probe behind the temperature',
        meaning='The probe moves relative to the table with the measured temperature, but later.',
        look='Parts with a large heat capacity: bed, columns, table; where the sensor of the temperature is.',
        formula="d T', where tau dT'/dt = T - T0 - T'",
        source='ISO 230-3 (environmental temperature variation error)'),
    FrameEffect('frame_cycle', Cycle(), Quantity('a', 'm', 'cosine amplitude along'),
        Quantity('b', 'm', 'sine amplitude along'),
        plain='periodic motion of the machine',
        meaning='The probe oscillates relative to the table with a fixed period in time.',
        look='Air conditioning that switches, cooling units, hydraulic or compressed air cycles.',
        formula='a cos(2 pi t/P) + b sin(2 pi t/P)',
        source='ISO 230-3 (environmental temperature variation error)',
        repeatable=True),
    FrameEffect('frame_step', Step('step'), Quantity('d', 'm', 'step along'),
        plain='sudden shift of the machine',
        meaning='At one moment the probe shifted relative to the table, and stayed there.',
        look='A collision, an exchanged or requalified probe, an axis that was referenced again.',
        formula='d H(t - t0)',
        source='physics of probe requalification',
        repeatable=True),
    FramePulse(), FrameRecovery())
"""In the order of tables and pages."""

CMM_EFFECTS: tuple[Effect, ...] = (
    CmmScale('cmm_scale_drift', Drift(), Quantity('e', '1/s', 'rate of the scale of'),
        plain='growth of the scales of the CMM',
        meaning="The scales of the CMM's x and y grow or shrink steadily.",
        look='Temperature of the scales; heat from drives beside one axis.',
        formula='e_x x t along x, e_y y t along y',
        source='ISO 230-3; ISO 10360-2 (thermal expansion of the scales)'),
    CmmScale('cmm_scale_temperature', Temperature('m/m', ' of the scale of'),
        Quantity('e', '1/K', 'relative growth of the scale of'),
        plain='scales of the CMM follow the temperature',
        meaning="The scales of the CMM's x and y grow with the measured temperature, each by its own coefficient.",
        look='Expansion coefficients and temperatures of the scales, each to be corrected by a sensor of its own; '
             'air that reaches one axis only.',
        formula='e_x x (T - T0) along x, e_y y (T - T0) along y',
        source='ISO 10360-2 (thermal expansion of the scales); ISO 230-3'),
    CmmScale('cmm_scale_lag', LaggedTemperature('m/m', ' of the scale of'),
        Quantity('e', '1/K', 'relative growth of the scale of'),
        plain='scales of the CMM behind the temperature',
        meaning="The scales of the CMM's x and y grow with the measured temperature, each by its own coefficient, "
                'but later.',
        look='Carriers of the scales, whose heat capacity is large; where the sensor of the temperature is.',
        formula="e_x x T' along x, e_y y T' along y, where tau dT'/dt = T - T0 - T'",
        source='ISO 10360-2 (thermal expansion of the scales); ISO 230-3'),
    CmmSquareness('cmm_squareness_drift', Drift(),
        plain='drift of the squareness of the CMM',
        meaning="The angle between the CMM's x and y changes steadily.",
        look='Uneven temperature of the bed or of the portal; a guideway that settles.',
        formula='s y t along x',
        source='ISO 230-1 (squareness error); ISO 230-3'))

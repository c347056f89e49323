# SPDX-License-Identifier: Apache-2.0
"""The library: every effect that files, messages and the screen may name, an entry each: motion, course and words.

A Quantity is the amplitude of a function of the course; the motion adds its axes to name and meaning.
"""

from collections.abc import Collection

from rosette_ros.core.effects import ball_courses as of_ball
from rosette_ros.core.effects import courses as of
from rosette_ros.core.effects import motions as move
from rosette_ros.core.effects.effect import Effect, PhysicalEffect, Quantity
from rosette_ros.core.effects.free import FREE
from rosette_ros.core.run.errors import InvalidModel, unknown_name
from rosette_ros.core.run.records import Run
from rosette_ros.plugins import added

EFFECTS: dict[str, PhysicalEffect] = {one.name: one for one in (
    PhysicalEffect('frame_drift', move.FrameAxes(), of.Drift(), Quantity('d', 'm/s', 'drift rate along'),
        plain='linear probe drift',
        meaning='The probe drifts steadily relative to the table, in the frame of the machine.',
        look='Temperature of the hall and of the quill, time since switching on, draughts; let the machine soak or '
             'measure faster.',
        formula='d t', source='ISO 230-3 (drift over a stated period); GUM F.1.1.2'),
    PhysicalEffect('frame_drift_onset', move.FrameAxes(), of.Onset(), Quantity('d', 'm/s', 'drift rate along'),
        plain='probe drift with an onset',
        meaning='At one moment the probe begins to drift steadily relative to the table.',
        look='What was switched on, opened or loaded at that moment: a lamp, a door, a cooling unit, a workpiece.',
        formula='d max(0, t - t0)', source='ISO 230-3 (drift over a stated period)'),
    PhysicalEffect('frame_drift_curved', move.FrameAxes(), of.Curve(),
        Quantity('d', 'm/s', 'rate at the first reading along'),
        Quantity('c', 'm/s^2', 'half the change of the rate along'),
        plain='non-linear probe drift',
        meaning='The probe drifts relative to the table, and its rate changes steadily.',
        look='Temperature of the hall and of the quill; let the machine soak or measure faster.', formula='d t + c t^2',
        source='ISO 230-3 (drift over a stated period)'),
    PhysicalEffect('frame_warmup', move.FrameAxes(), of.WarmUp(), Quantity('d', 'm', 'final displacement along'),
        plain='warm-up of the machine',
        meaning='The probe moves relative to the table while the machine warms up, and settles.',
        look='Drives, spindle and controller since switching on; start after a warm-up cycle.',
        formula='d (1 - exp(-t/tau))', source='ISO 230-3 (warm-up of the structure)'),
    PhysicalEffect('frame_temperature', move.FrameAxes(), of.Temperature('m', ' along'),
        Quantity('d', 'm/K', 'displacement per kelvin along'),
        plain='thermal drift proportional to air temperature',
        meaning='The probe moves relative to the table with the measured temperature.',
        look='Air conditioning, sunlight, doors; the scales and the quill expand.', formula='d (T - T0)',
        source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('frame_temperature_lag', move.FrameAxes(), of.LaggedTemperature('m', ' along'),
        Quantity('d', 'm/K', 'displacement per kelvin along'),
        plain='thermally lagged probe drift',
        meaning='The probe moves relative to the table with the measured temperature, but later.',
        look='Parts with a large heat capacity: bed, columns, table; where the sensor of the temperature is.',
        formula="d T', where tau dT'/dt = T - T0 - T'", source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('frame_cycle', move.FrameAxes(), of.Cycle(), Quantity('a', 'm', 'cosine amplitude along'),
        Quantity('b', 'm', 'sine amplitude along'),
        plain='periodic drift of the machine',
        meaning='The probe oscillates relative to the table with a fixed period in time.',
        look='Air conditioning that switches, cooling units, hydraulic or compressed air cycles.',
        formula='a cos(2 pi t/P) + b sin(2 pi t/P)', source='ISO 230-3 (environmental temperature variation error)',
        repeatable=True),
    PhysicalEffect('frame_step', move.FrameAxes(), of.Step('step'), Quantity('d', 'm', 'step along'),
        plain='step in the machine coordinate system',
        meaning='At one moment the probe shifted relative to the table, and stayed there: a zero-point shift.',
        look='A collision, an exchanged or requalified probe, an axis that was referenced again.',
        formula='d H(t - t0)', source='physics of probe requalification', repeatable=True),
    PhysicalEffect('frame_pulse', move.FrameAxes(), of.Pulse(), Quantity('d', 'm', 'shift along'),
        plain='temporary step in the machine coordinate system',
        meaning='For some time the probe was shifted relative to the table, and came back.',
        look='A door, a load on the table, a person or vehicle near the machine, a magnet or valve that was on.',
        formula='d (H(t - t0) - H(t - t1))', source='physics of loads', repeatable=True),
    PhysicalEffect('frame_recovery', move.FrameAxes(), of.Recovery(), Quantity('d', 'm', 'shift at first along'),
        plain='decaying step in the machine coordinate system',
        meaning='At one moment the probe shifted relative to the table, and went back ever more slowly.',
        look='A knock, a load or warm air that was there for a moment; a joint that springs back.',
        formula='d H(t - t0) exp(-(t - t0)/tau)', source='physics of loads and of thermal disturbances'),
    PhysicalEffect('table_zero_drift', move.TableTurn(), of.Drift(),
        Quantity('omega', 'rad/s', 'rate of turn of the zero'),
        plain="angular drift of the table", meaning="The table's angle drifts steadily relative to its encoder.",
        look='Encoder mount, coupling between encoder and table, heat of the torque motor.', formula='omega t R e_t',
        source='ISO 230-3 (distortion caused by rotary motion)'),
    PhysicalEffect('table_zero_warmup', move.TableTurn(), of.WarmUp(),
        Quantity('omega', 'rad', 'final turn of the zero'),
        plain="angular warm-up drift of the table",
        meaning="The table's angle drifts relative to its encoder while the table warms up, and settles.",
        look='Encoder mount, coupling, heat of the torque motor; a plate that turns on the table until it rests.',
        formula='omega R e_t (1 - exp(-t/tau))', source='ISO 230-3 (distortion caused by rotary motion)'),
    PhysicalEffect('table_zero_temperature', move.TableTurn(), of.Temperature('rad'),
        Quantity('omega', 'rad/K', 'turn of the zero per kelvin'),
        plain="angular drift proportional to air temperature",
        meaning="The table's angle moves relative to its encoder with the measured temperature.",
        look='Encoder mount and coupling, air conditioning, sunlight on one side of the table.',
        formula='omega R e_t (T - T0)', source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('table_zero_lag', move.TableTurn(), of.LaggedTemperature('rad'),
        Quantity('omega', 'rad/K', 'turn of the zero per kelvin'),
        plain="thermally lagged angular drift",
        meaning="The table's angle moves relative to its encoder with the measured temperature, but later.",
        look='Housing of the table and encoder mount, whose heat capacity is large; sunlight on one side of the table.',
        formula="omega R e_t T', where tau dT'/dt = T - T0 - T'",
        source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('table_zero_step', move.TableTurn(), of.Step('jump'), Quantity('omega', 'rad', 'jump of the angle'),
        plain="angular step of the table", meaning="At one moment the table's angle jumped relative to its encoder.",
        look='Encoder: lost counts, referencing again, a coupling that slipped; a collision.',
        formula='omega R e_t H(t - t0)', source='physics of incremental encoders'),
    PhysicalEffect('axis_tilt_drift', move.AxisTilt(), of.Drift(), Quantity('theta', 'rad/s', 'tilt rate about'),
        plain="axis tilt drift", meaning='The table axis tilts steadily in the machine.',
        look='Foundation, levelling feet, one-sided heat on the machine bed.',
        formula='R (theta_x sin alpha - theta_y cos alpha) t along z', source='ISO 230-3 (thermal distortion)'),
    PhysicalEffect('axis_tilt_warmup', move.AxisTilt(), of.WarmUp(), Quantity('theta', 'rad', 'final tilt about'),
        plain="axis tilt during warm-up",
        meaning='The table axis tilts in the machine while the machine warms up, and settles.',
        look='One-sided heat on the machine bed, coolant, time since switching on; start after a warm-up cycle.',
        formula='R (theta_x sin alpha - theta_y cos alpha) (1 - exp(-t/tau)) along z',
        source='ISO 230-3 (thermal distortion)'),
    PhysicalEffect('axis_tilt_temperature', move.AxisTilt(), of.Temperature('rad', ' about'),
        Quantity('theta', 'rad/K', 'tilt per kelvin about'),
        plain="axis tilt proportional to air temperature",
        meaning='The table axis tilts in the machine with the measured temperature.',
        look='Air conditioning, sunlight or a wall on one side of the machine bed; layers of warm air.',
        formula='R (theta_x sin alpha - theta_y cos alpha) (T - T0) along z',
        source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('axis_tilt_lag', move.AxisTilt(), of.LaggedTemperature('rad', ' about'),
        Quantity('theta', 'rad/K', 'tilt per kelvin about'),
        plain="thermally lagged axis tilt",
        meaning='The table axis tilts in the machine with the measured temperature, but later.',
        look='Machine bed and columns, whose heat capacity is large; sunlight or a wall on one side of them.',
        formula="R (theta_x sin alpha - theta_y cos alpha) T' along z, where tau dT'/dt = T - T0 - T'",
        source='ISO 230-3 (environmental temperature variation error)'),
    PhysicalEffect('axis_tilt_step', move.AxisTilt(), of.Step('tilt'), Quantity('theta', 'rad', 'tilt about'),
        plain="sudden axis tilt",
        meaning='At one moment the table axis tilted in the machine, and stayed so.',
        look='Levelling feet and foundation that settle, a load set on the machine bed, a collision.',
        formula='R (theta_x sin alpha - theta_y cos alpha) H(t - t0) along z', source='physics of machine beds'),
    PhysicalEffect('table_backlash', move.TableTurn(), of.TableSense(),
        Quantity('b', 'rad', 'reversal error of the table angle'),
        plain='backlash of the table',
        meaning='The angle at which the table stops depends on the sense in which it turned.',
        look='Worm gear, clamping, friction between drive and encoder.', formula='1/2 b approach R e_t',
        source='ISO 230-2 (reversal error: from the positive sense less from the negative)'),
    PhysicalEffect('table_backlash_angle', move.TableTurn(), of.TableSenseByAngle(),
        Quantity('bc', 'rad', 'cosine of the reversal error'), Quantity('bs', 'rad', 'sine'),
        plain='angle-dependent backlash of the table',
        meaning='The backlash of the table differs from angle to angle.',
        look='Worm gear: wear, eccentricity and mesh; unequal friction or load around the table.',
        formula='1/2 approach R e_t (b_c cos(m phi) + b_s sin(m phi))',
        source='ISO 230-2 (reversal error at each position)', repeatable=True),
    PhysicalEffect('encoder_interpolation', move.TableTurn(), of.EncoderLines(),
        Quantity('a', 'rad', 'cosine amplitude'),
        Quantity('b', 'rad', 'sine amplitude'),
        plain='interpolation error of the encoder',
        meaning="The table's angle has an error that repeats with every period of its encoder.",
        look='Amplitudes, offsets and phase of the encoder signals; dirt on the graduation; interpolation electronics.',
        formula='R e_t (a cos(L theta) + b sin(L theta)), theta the actual angle of the table',
        source='ISO 230-2 (positioning); interpolation error of incremental encoders', repeatable=True),
    PhysicalEffect('asynchronous_motion', move.AxisShiftAndTilt(), of.TableOrder(),
        Quantity('a', 'm', 'cosine amplitude of'),
        Quantity('b', 'm', 'sine amplitude of'),
        plain='asynchronous error motion of the axis',
        meaning='The axis moves at no integer multiple of its rotation frequency: the motion does not repeat every '
                'turn.',
        look='Cage and rolling elements of the bearing (about 0.4 per turn), belt or worm drive.',
        formula='(radial x, y; axial z; tilt) cos(nu Psi), sin(nu Psi)', source='ISO 230-7 (asynchronous error motion)',
        repeatable=True),
    PhysicalEffect('table_warmup', move.TableAxial(), of.TableHeat(), Quantity('a', 'm', 'final axial growth'),
        plain='axial thermal growth of the bearing',
        meaning='The table grows along its axis as turning warms the bearing, and settles.',
        look='Bearing friction and preload, torque motor; warm the table up by turning it before measuring.',
        formula='a (1 - exp(-Psi/Psi0)) along z',
        source='ISO 230-3 (thermal distortion caused by rotating components)'),
    PhysicalEffect('plate_creep', move.PlateSlide(), of.Drift(), Quantity('d', 'm/s', "creep rate along the plate's"),
        plain='creep of the plate', meaning='The plate slides slowly on the table.',
        look='Clamps, wax or magnets that hold the plate; forces of cables on the plate.', formula='R_z(phi) d t',
        source='physics of clamping'),
    PhysicalEffect('plate_creep_settling', move.PlateSlide(), of.WarmUp(),
        Quantity('d', 'm', "final shift along the plate's"),
        plain='decaying creep of the plate',
        meaning='The plate slides on the table ever more slowly, until it rests.',
        look='Wax, glue or magnets that hold the plate; let the plate rest after clamping.',
        formula='R_z(phi) d (1 - exp(-t/tau))', source='physics of clamping'),
    PhysicalEffect('plate_slip', move.PlateSlideAndTurn(), of.Step('slip'),
        Quantity('d', 'm', "shift along the plate's"),
        plain='slip of the plate', meaning='At one moment the whole plate slipped on the table.',
        look='Clamps; a collision with the plate; acceleration of the table.',
        formula='(R_z(phi) d + gamma R e_t) H(t - t0)', source='physics of clamping', repeatable=True),
    PhysicalEffect('plate_tilt_step', move.PlateOnSupports(), of.Step('tilt'),
        Quantity('theta', 'rad', "tilt about the plate's"),
        plain='sudden tilt of the plate', meaning='At one moment the plate tilted on the table, and stayed so.',
        look='Feet, shims and clamps of the plate: one that was not seated, a chip that broke, a clamp that let go.',
        formula='R_z(phi) (d_z e_z + theta x (b + h e_z)) H(t - t0), theta in x and y',
        source='kinematics of a plate on three supports', repeatable=True),
    PhysicalEffect('plate_tilt_settling', move.PlateOnSupports(), of.WarmUp(),
        Quantity('theta', 'rad', "tilt about the plate's"),
        plain='settling of the plate on its supports',
        meaning='The plate tilts on the table ever more slowly, until it rests.',
        look='Feet on soft or warm ground, wax, pads, shims; clamp the plate and let it rest before measuring.',
        formula='R_z(phi) (d_z e_z + theta x (b + h e_z)) (1 - exp(-t/tau)), theta in x and y',
        source='kinematics of a plate on three supports'),
    PhysicalEffect('plate_expansion', move.PlateGrowth(), of.TimeOrTemperature(),
        Quantity('epsilon', '1', 'relative growth'),
        plain='thermal expansion of the plate', meaning='The plate grows or shrinks.',
        look='Temperature of the plate: handling, lamps, soaking time, warm table top.',
        formula='epsilon R e_r (t or T - T0)', source='ISO 1 and ISO 10360 (thermal expansion)'),
    PhysicalEffect('plate_expansion_lag', move.PlateGrowth(), of.LaggedTemperature('m/m'),
        Quantity('epsilon', '1/K', 'relative growth'),
        plain='thermally lagged expansion of the plate',
        meaning='The plate grows and shrinks with the measured temperature, but later.',
        look='A thick plate, or a sensor that is not on the plate: measure the temperature of the plate itself.',
        formula="epsilon R e_r T', where tau dT'/dt = T - T0 - T'", source='ISO 1 and ISO 10360 (thermal expansion)'),
    PhysicalEffect('plate_soaking', move.PlateGrowth(), of.WarmUp(),
        Quantity('epsilon', 'm/m', 'final relative growth'),
        plain='plate not acclimatised',
        meaning='The plate grows or shrinks towards a size as it takes the temperature of the cell (temperature '
                'equalisation).',
        look='A plate from a store, a washer or warm hands; let it soak before measuring.',
        formula='epsilon R e_r (1 - exp(-t/tau))', source='ISO 1 and ISO 10360 (thermal expansion)'),
    PhysicalEffect('plate_warp', move.PlateSaddle(), of.Drift(), Quantity('', 'm/s', 'rate'),
        plain='warping of the plate', meaning='The plate warps into a saddle with time.',
        look='Uneven temperature of the plate, over-tight clamps, stress in the material.',
        formula='(a cos(m beta) + b sin(m beta)) t along z', source='physics of plates'),
    PhysicalEffect('plate_support', move.PlateBending(), of_ball.PlateWaves(),
        Quantity('', 'm', 'amplitude, c cosine and s sine, of the table angle first'),
        plain='bending of the plate on its supports',
        meaning='The plate bends on its supports as it turns: in waves of the table angle times waves of the ball.',
        look='Feet and clamps of the plate, flatness of the table top, an axis that is not vertical.',
        formula='(cos, sin)(p phi) (cos, sin)(m beta), or (cos, sin)(m beta +- p phi), along z, radially or '
                'tangentially',
        source='physics of plates on supports', repeatable=True),
    PhysicalEffect('ball_slip', move.BallInPlate(), of_ball.BallStep(), Quantity('d', 'm', "shift along the plate's"),
        plain='slip of one ball', meaning='At one moment one ball moved on the plate.',
        look='The joint of that ball: glue, thread, magnet; a collision of the stylus.',
        formula='R_z(phi) d H(t - t0) for one ball', source='physics of the artefact', repeatable=True),
    PhysicalEffect('ball_creep', move.BallInPlate(), of_ball.BallCreep(),
        Quantity('d', 'm', "displacement at the end of the run along the plate's"),
        plain='creep of one ball', meaning='One ball moves gradually on the plate, steadily or ever more slowly.',
        look='The joint of that ball: glue that creeps, a thread or magnet that settles; heat of a hand.',
        formula='R_z(phi) d (1 - exp(-(t - t0)/tau)) for one ball from t0 on, d reached at the end of the run',
        source='physics of the artefact', repeatable=True),
    PhysicalEffect('ball_rattle', move.BallInPlate(), of_ball.BallSeats(),
        Quantity('d', 'm', "distance of the seats along the plate's"),
        plain='loose ball',
        meaning='One ball has two stable seatings: it moved and came back, or sits by the sense of the last table '
                'move.',
        look='The joint of that ball: a loose thread, a magnet with dirt under it, cracked glue.',
        formula='R_z(phi) d for one ball between t0 and t1, or 1/2 R_z(phi) d approach',
        source='physics of the artefact', repeatable=True),
    PhysicalEffect('ball_machine_offset', move.AlongTableFrame('plate', 'ball', 'xy'), of_ball.EachBall(),
        Quantity('d', 'm', "offset along the machine's"),
        plain='ball stem deflection fixed in machine coordinates',
        meaning='A ball stands off by an amount that does not turn with the plate: its direction is fixed in the '
                'machine.',
        look='The stem of that ball: bending under gravity or probing force; probing from one side, a magnetic ball.',
        formula='d along x and y of the machine for one ball', source='physics of stems and probing', repeatable=True),
    PhysicalEffect('ball_sag', move.BallInPlate(), of_ball.GravityInPlate(),
        Quantity('c', 'm', "cosine amplitude along the plate's"),
        Quantity('s', 'm', "sine amplitude along the plate's"),
        plain='sag of the balls',
        meaning='Balls sag under gravity as the plate turns about an axis that is not vertical.',
        look='Stems and arms that carry the balls, loose seats; measure with the axis vertical. Stems that bend '
             'alike to all sides look like ball_machine_offset, waves around the plate like plate_support.',
        formula='R_z(phi) (c cos(phi) + s sin(phi)) for one ball, or for each',
        source='physics of beams under their weight: gravity turns in the plate', needs_tilt=True),
    PhysicalEffect('ball_form', move.BallForm(), of_ball.EachForm(), Quantity('', 'm', ''),
        plain='form deviation of the balls',
        meaning='A ball is not round, so its measured centre moves as the table turns it.',
        look='Grade and damage of the ball, dirt on it, number and place of the touches.',
        formula='a (cos(m phi + psi), -sin(m phi + psi)) in x, y and c cos(m phi + psi_z) in z',
        source='Kniel et al. (2019), section 2.1: the form must be as accurate as possible', repeatable=True),
    PhysicalEffect('cmm_scale_drift', move.CmmScales(), of.Drift(), Quantity('e', '1/s', 'rate of the scale of'),
        plain='drift of the CMM scales', meaning="The scales of the CMM's x and y grow or shrink steadily.",
        look='Temperature of the scales; heat from drives beside one axis.', formula='e_x x t along x, e_y y t along y',
        source='ISO 230-3; ISO 10360-2 (thermal expansion of the scales)'),
    PhysicalEffect('cmm_scale_temperature', move.CmmScales(), of.Temperature('m/m', ' of the scale of'),
        Quantity('e', '1/K', 'relative growth of the scale of'),
        plain='CMM scale expansion proportional to air temperature',
        meaning="The scales of the CMM's x and y grow with the measured temperature, each by its own coefficient.",
        look='Expansion coefficients and temperatures of the scales, each to be corrected by a sensor of its own; '
             'air that reaches one axis only.',
        formula='e_x x (T - T0) along x, e_y y (T - T0) along y',
        source='ISO 10360-2 (thermal expansion of the scales); ISO 230-3'),
    PhysicalEffect('cmm_scale_lag', move.CmmScales(), of.LaggedTemperature('m/m', ' of the scale of'),
        Quantity('e', '1/K', 'relative growth of the scale of'),
        plain='thermally lagged expansion of the CMM scales',
        meaning="The scales of the CMM's x and y grow with the measured temperature, each by its own coefficient, "
                'but later.',
        look='Carriers of the scales, whose heat capacity is large; where the sensor of the temperature is.',
        formula="e_x x T' along x, e_y y T' along y, where tau dT'/dt = T - T0 - T'",
        source='ISO 10360-2 (thermal expansion of the scales); ISO 230-3'),
    PhysicalEffect('cmm_squareness_drift', move.CmmSquareness(), of.Drift(),
        Quantity('s', 'rad/s', 'rate of the squareness error of'),
        plain='drift of the CMM squareness', meaning="The angle between the CMM's x and y changes steadily.",
        look='Uneven temperature of the bed or of the portal; a guideway that settles.', formula='s y t along x',
        source='ISO 230-1 (squareness error); ISO 230-3'),
    PhysicalEffect('cmm_reversal', move.CmmReversal(), of.Constant(), Quantity('r', 'm', 'reversal error of'),
        plain='reversal error of the CMM',
        meaning="The position of the CMM's axes depends on the side from which they approach.",
        look='Guideways, friction, drives and scales of the CMM; always approach from one side.',
        formula="1/2 r_x sense_x, 1/2 r_y sense_y along the CMM's own axes; y and z about a table along x",
        source='ISO 230-2 (reversal error: from the positive sense less from the negative)'),
    PhysicalEffect('cmm_reversal_position', move.CmmReversalByPosition(), of.Constant(),
        Quantity('r', 'm', 'reversal error at R less that in the middle of'),
        plain='position-dependent reversal error of the CMM',
        meaning="The reversal error of the CMM's axes grows along the axis.",
        look='Screws, belts and friction of the drives: lost motion that differs along the travel.',
        formula='1/2 r_x sense_x x/R, 1/2 r_y sense_y y/R', source='ISO 230-2 (reversal error at each position)'),
    PhysicalEffect('probe_approach', move.ProbeDeflection(), of_ball.Lobes(), Quantity('', 'm', 'deviation'),
        plain='direction-dependent probing error',
        meaning='The ball centre depends on the direction from which the probe came.',
        look='Lobing and hysteresis of the probe head, bent or loose stylus, clearance moves; come from one direction.',
        formula='c u or (a cos(m theta) + b sin(m theta)) u, theta the direction of the last move, u along, across '
                'or z',
        source='ISO 10360-5 (probing error by direction)'),
    PhysicalEffect('outlier', move.AlongTableFrame('machine', 'reading', 'xyz'), of_ball.OneReading(),
        Quantity('d', 'm', 'deviation along'),
        plain='single wrong reading', meaning='A single ball centre is wrong.',
        look='Dirt on the ball or stylus, a false trigger; measure that ball again.', formula='d for one reading',
        source='GUM 3.4.7 (blunders)', repeatable=True))}
"""By name; their order is that of every table and page."""


def add_effect(own: object) -> None:
    """Add an effect of a laboratory to the library: files may name it, and every diagnosis searches for it.

    Raises InvalidModel where it is none, or another one has its name."""
    if not isinstance(own, PhysicalEffect):
        raise InvalidModel(f'own effect: wanted a PhysicalEffect, got {type(own).__name__}')
    if EFFECTS.get(own.name, own) is not own:
        raise InvalidModel(f'own effect {own.name}: wanted another name; the library has one of this name')
    EFFECTS[own.name] = own


for _own in added('rosette.effects').values():
    add_effect(_own)


def effects_of(run: Run) -> dict[str, Effect]:
    """Return the effects that the cell of a run can have, by name."""
    return {name: one for name, one in EFFECTS.items() if one.can_be_in(run)}


def effect(name: str, others: Collection[str] = ()) -> Effect:
    """Return the effect or free course of a name; raise InvalidModel, with the nearest one or other, if there is none.

    others: names of what is no effect and would have done, too."""
    if name not in EFFECTS and name != FREE.name:
        raise InvalidModel(unknown_name('effect', name, (*EFFECTS, *others), 'rosette effects'))
    return EFFECTS.get(name) or FREE


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
    BaseEffect('plate_deviations', 'ball centre deviations',
               'The balls are not at their nominal positions, those of the clamping included; the plate need not be '
               'calibrated.',
               'No fault: every plate has them, and they turn with it.', 'R_z(phi_i) P_j', 'ball',
               'Kniel et al. (2019), section 2.1'),
    BaseEffect('cmm_deviations', 'CMM measurement errors',
               'At each of its probing positions the CMM has a constant measurement error.',
               'Correction of the linear axes; squareness and scales of the CMM.', 'M_k', 'cmm_position',
               'Kniel et al. (2019), section 2.1'))

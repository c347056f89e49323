# SPDX-License-Identifier: Apache-2.0
"""Every kind of hidden effect: of the frame, the table, the plate and its balls, the CMM; last, those not named."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, Union

import numpy as np
from pydantic import Field, model_validator

from rosette_ros.core.run.geometry import TWO_PI, rotate_z
from rosette_ros.core.run.records import Floats
from rosette_ros.simulation.hidden_effect import UM, Draw, Drawn, HiddenEffect, Situation, along
from rosette_ros.simulation.motion import Moment
from rosette_ros.simulation.probing import TouchPattern
from rosette_ros.simulation.setting_types import NotNegative, Number, Pair, Positive, Seed, Settings, Vector

MOST_PPM_PER_K = 30.0
"""Thermal expansion that no material of a plate exceeds: that of zinc."""
BallNumber = Annotated[int, Field(ge=1)]
Undulations = Annotated[int, Field(ge=2, le=12)]
SizeVector = Annotated[Vector, Drawn(lambda by: by.vector(by.size_um))]
PlaneVector = Annotated[Vector, Drawn(lambda by: by.vector(by.size_um, axes=2))]
TimeInRun = Annotated[NotNegative, Drawn(Draw.time)]


class HiddenFrameDrift(HiddenEffect):
    """The table drifts steadily relative to the probe: rate * t."""

    kind: Literal['frame_drift'] = 'frame_drift'
    rate_um_per_h: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um / by.run.duration_h))]

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.rate_um_per_h, moment.hours)


class HiddenFrameWarmup(HiddenEffect):
    """Something was switched on too late: amplitude * (1 - exp(-(t - from) / tau)), nothing before."""

    kind: Literal['frame_warmup'] = 'frame_warmup'
    amplitude_um: SizeVector
    time_constant_h: Annotated[Positive, Drawn(lambda by: by.run.duration_h * by.between(0.1, 0.5))]
    from_h: Annotated[NotNegative, Drawn(lambda by: 0.95 * by.run.start_h)] = 0.0

    def frame_shift(self, moment: Moment) -> Floats:
        since = np.maximum(moment.hours - self.from_h, 0.0)
        return along(self.amplitude_um, -np.expm1(-since / self.time_constant_h))


class HiddenFrameTemperature(HiddenEffect):
    """The machine's frame follows the ambient temperature: coefficient * (T - T at power-on)."""

    kind: Literal['frame_temperature'] = 'frame_temperature'
    coefficient_um_per_K: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um / 0.1))]

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.coefficient_um_per_K, moment.warming)


class HiddenFrameCycle(HiddenEffect):
    """Air conditioning or coolant: cosine * cos(2 pi t / P) + sine * sin(2 pi t / P)."""

    kind: Literal['frame_cycle'] = 'frame_cycle'
    cosine_um: SizeVector
    sine_um: SizeVector = (0.0, 0.0, 0.0)
    period_min: Annotated[Positive, Drawn(lambda by: 60 * by.run.duration_h / by.between(3, 12))]

    def frame_shift(self, moment: Moment) -> Floats:
        phase = TWO_PI * moment.time / (60.0 * self.period_min)
        return along(self.cosine_um, np.cos(phase)) + along(self.sine_um, np.sin(phase))


class HiddenFrameStep(HiddenEffect):
    """Somebody bumped into the table, or the probe was requalified: a step at one time."""

    kind: Literal['frame_step'] = 'frame_step'
    step_um: SizeVector
    at_h: TimeInRun

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.step_um, moment.hours >= self.at_h)


class HiddenTableZeroDrift(HiddenEffect):
    """The zero of the angle encoder drifts: rate * t."""

    kind: Literal['table_zero_drift'] = 'table_zero_drift'
    rate_urad_per_h: Annotated[Number, Drawn(lambda by: by.sign() * (by.angle_urad / by.run.duration_h))]

    def table_turn(self, moment: Moment) -> Floats:
        return self.rate_urad_per_h * UM * moment.hours


class HiddenAxisTiltDrift(HiddenEffect):
    """The bed bends: the table's axis tilts steadily about x and y, rate * t."""

    kind: Literal['axis_tilt_drift'] = 'axis_tilt_drift'
    rate_urad_per_h: Annotated[Pair, Drawn(lambda by: by.vector(by.angle_urad / by.run.duration_h, axes=2)[:2])]

    def axis_tilt(self, moment: Moment) -> Floats:
        return along((*self.rate_urad_per_h, 0.0), moment.hours)


class HiddenTableBacklash(HiddenEffect):
    """The table stops elsewhere when it comes from the other side: half the width in the sense of the last move."""

    kind: Literal['table_backlash'] = 'table_backlash'
    width_urad: Annotated[Number, Drawn(lambda by: by.sign() * by.angle_urad)]

    def table_turn(self, moment: Moment) -> Floats:
        return np.multiply(0.5 * self.width_urad * UM, moment.approach)


class HiddenAsynchronousMotion(HiddenEffect):
    """The bearing's cage turns at its own rate, `order` times the travel: an orbit, a cone, or up and down."""

    kind: Literal['asynchronous_motion'] = 'asynchronous_motion'
    order: Annotated[float, Field(gt=0, le=50, description='periods per turn, not whole')]
    radial_um: Number = 0.0
    axial_um: Number = 0.0
    tilt_urad: Number = 0.0
    phase_deg: Number = 0.0

    def _turning(self, moment: Moment, size: float, axial: float = 0.0) -> Floats:
        phase = self.order * moment.travel + np.deg2rad(self.phase_deg)
        return along((size, 0.0, axial), np.cos(phase)) + along((0.0, size, 0.0), np.sin(phase))

    def table_shift(self, moment: Moment) -> Floats:
        return self._turning(moment, self.radial_um, self.axial_um)

    def table_tilt(self, moment: Moment) -> Floats:
        return self._turning(moment, self.tilt_urad)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        """Draw one of the three motions with an order as cages have it."""
        sizes = {'radial_um': by.size_um, 'axial_um': by.size_um, 'tilt_urad': by.angle_urad}
        motion = str(by.rng.choice(list(sizes)))
        order, phase_deg = by.between(0.37, 0.47), by.between(0, 360)
        return cls.model_validate({'order': order, 'phase_deg': phase_deg, motion: sizes[motion]})


class HiddenTableWarmup(HiddenEffect):
    """The bearing warms as it turns, in either sense, and lifts: growth * (1 - exp(-turned / scale))."""

    kind: Literal['table_warmup'] = 'table_warmup'
    growth_um: Annotated[Number, Drawn(lambda by: by.sign() * by.size_um)]
    scale_turns: Annotated[Positive, Drawn(lambda by: by.run.balls * by.between(0.1, 0.5))]

    def table_shift(self, moment: Moment) -> Floats:
        turns = moment.turned / TWO_PI
        return along((0.0, 0.0, self.growth_um), -np.expm1(-turns / self.scale_turns))


class HiddenPlateCreep(HiddenEffect):
    """The clamping lets the plate slide steadily: rate * t."""

    kind: Literal['plate_creep'] = 'plate_creep'
    rate_um_per_h: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um / by.run.duration_h, axes=2))]

    def plate_shift(self, moment: Moment) -> Floats:
        return along(self.rate_um_per_h, moment.hours)


class HiddenPlateSlip(HiddenEffect):
    """The plate slips once: a shift, and a turn about the axis, from one time on."""

    kind: Literal['plate_slip'] = 'plate_slip'
    shift_um: PlaneVector
    turn_urad: Annotated[Number, Drawn(lambda by: by.sign() * 0.5 * by.angle_urad)] = 0.0
    at_h: TimeInRun

    def plate_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, moment.hours >= self.at_h)

    def plate_turn(self, moment: Moment) -> Floats:
        return np.multiply(self.turn_urad * UM, moment.hours >= self.at_h)


class HiddenPlateExpansion(HiddenEffect):
    """The plate grows in its plane, with time or with the temperature."""

    kind: Literal['plate_expansion'] = 'plate_expansion'
    rate_ppm_per_h: Number = 0.0
    coefficient_ppm_per_K: Number = 0.0

    def plate_growth(self, moment: Moment) -> Floats:
        return UM * (self.rate_ppm_per_h * moment.hours + self.coefficient_ppm_per_K * moment.warming)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        ppm = by.sign() * by.angle_urad
        if by.rng.random() < 0.5 or abs(ppm / 0.1) > MOST_PPM_PER_K:
            return cls(rate_ppm_per_h=ppm / by.run.duration_h)
        return cls(coefficient_ppm_per_K=ppm / 0.1)


class HiddenPlateWarp(HiddenEffect):
    """The plate warps like a saddle: z grows with cos(order * (beta - phase)) * t."""

    kind: Literal['plate_warp'] = 'plate_warp'
    rate_um_per_h: Annotated[Number, Drawn(lambda by: by.size_um / by.run.duration_h)]
    order: Undulations = 2
    phase_deg: Annotated[Number, Drawn(lambda by: by.between(0, 180))] = 0.0

    def ball_shift(self, moment: Moment) -> Floats:
        shape = np.cos(self.order * (moment.azimuth - np.deg2rad(self.phase_deg)))
        return along((0.0, 0.0, self.rate_um_per_h), shape * moment.hours)


class HiddenBallSlip(HiddenEffect):
    """One ball comes loose and moves on the plate, from one time on; axes of the turning frame."""

    kind: Literal['ball_slip'] = 'ball_slip'
    ball: Annotated[BallNumber, Drawn(Draw.ball)]
    shift_um: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um * np.sqrt(by.run.balls)))]
    at_h: TimeInRun

    def ball_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, (moment.hours >= self.at_h) & (moment.ball == self.ball))


class HiddenBallForm(HiddenEffect):
    """One ball is lobed and turns under touches that do not turn with it.

    `order` lobes of the surface, at Q touches evenly spaced on each horizontal circle, move the found centre in x-y
    where order + 1 or order - 1 is a multiple of Q, and in z where order is. Such orders are a true surface in the
    ball's frame. An order that even touches cannot see stands for touches spaced unevenly: at the touch points the ball
    then stands out as if its centre had moved by centre_um * (cos(m phi + psi), -sin(m phi + psi)). The motion has the
    form (cos, -sin) where order + 1 is a multiple of Q (order 3 for four touches), (cos, +sin) where order - 1 is
    (order 5).
    """

    kind: Literal['ball_form'] = 'ball_form'
    ball: BallNumber
    order: Annotated[int, Field(ge=2, le=30)]
    centre_um: Number = Field(description='amplitude of the apparent motion of the centre')
    direction: Literal['xy', 'z'] = 'xy'
    phase_deg: Number = 0.0

    def surface(self, moment: Moment, direction: Floats, touches: TouchPattern) -> Floats:
        height = UM * self.centre_um * (moment.ball == self.ball)
        turn = self.order * moment.angle + np.deg2rad(self.phase_deg)
        azimuth = np.arctan2(direction[..., 1], direction[..., 0])
        around = np.sqrt(direction[..., 0]**2 + direction[..., 1]**2)
        spacing = touches.points_per_circle
        if self.direction == 'z':
            lobes = turn - self.order * azimuth if self.order % spacing == 0 else turn
            return height * direction[..., 2] * np.cos(lobes)
        is_seen = (self.order + 1) % spacing == 0 or (self.order - 1) % spacing == 0
        return height * around * np.cos(turn - self.order * azimuth if is_seen else azimuth + turn)

    @classmethod
    def draw(cls, by: Draw) -> Self:
        """Draw what four touches a circle can see; few readings see it, so it is larger."""
        is_vertical = bool(by.rng.integers(2))
        return cls(ball=by.ball(), direction='z' if is_vertical else 'xy', order=4 if is_vertical else 3,
                   centre_um=by.size_um * np.sqrt(by.run.balls), phase_deg=by.between(0, 360))


class HiddenBallSag(HiddenEffect):
    """A stem bends under gravity as the plate turns it: by `sag_um` where gravity pulls fully along `along_deg`.

    Both count from the ball's own radial direction on the plate: sag_um radial, tangential and axial, along_deg 90 for
    an arm that bends around the plate and is stiff along itself.
    """

    needs_tilt: ClassVar[bool] = True
    kind: Literal['ball_sag'] = 'ball_sag'
    ball: Annotated[int, Field(ge=0, description='0: every ball'), Drawn(Draw.ball)] = 0
    sag_um: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um * np.sqrt(by.run.balls)))]
    along_deg: Annotated[Number, Drawn(lambda by: by.between(0, 360))] = 90.0

    def ball_shift(self, moment: Moment) -> Floats:
        turned = moment.angle + moment.azimuth + np.deg2rad(self.along_deg)
        pull = moment.gravity[0] * np.cos(turned) + moment.gravity[1] * np.sin(turned)
        bent = pull * (moment.ball == self.ball) if self.ball else pull
        return rotate_z(moment.azimuth, along(self.sag_um, bent))


class HiddenCmmReversal(HiddenEffect):
    """An axis leans to the side it came from: half the value before, half after, in the sense of its last move."""

    kind: Literal['cmm_reversal'] = 'cmm_reversal'
    value_um: PlaneVector

    def probe_shift(self, moment: Moment) -> Floats:
        return 0.5 * UM * np.asarray(self.value_um) * moment.cmm_sense


class HiddenOutlier(HiddenEffect):
    """The reading that is being made at one time is off: something shook."""

    kind: Literal['outlier'] = 'outlier'
    shift_um: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um * by.run.balls))]
    at_h: TimeInRun

    def probe_shift(self, moment: Moment) -> Floats:
        return along(self.shift_um, moment.is_made_at(self.at_h))


class HiddenTouchDust(HiddenEffect):
    """A speck of dust under one touch of the reading that is being made at one time."""

    is_named: ClassVar[bool] = False
    kind: Literal['touch_dust'] = 'touch_dust'
    # a twentieth of it reaches the centre of a single reading
    thickness_um: Annotated[Number, Drawn(lambda by: 5 * by.size_um * by.run.balls)]
    touch: Annotated[int, Field(ge=1, description='number of the touch'), Drawn(lambda by: int(by.rng.integers(1, 21)))]
    at_h: TimeInRun

    def surface(self, moment: Moment, direction: Floats, touches: TouchPattern) -> Floats:
        number = np.arange(1, touches.size + 1)
        return UM * self.thickness_um * (moment.is_made_at(self.at_h) & (number == self.touch))


def lobes(direction: Floats, order: int, phase: Floats | float) -> Floats:
    """Return lobes of height 1 at the equator, by unit vectors (..., 3), turned by a phase, rad."""
    azimuth = np.arctan2(direction[..., 1], direction[..., 0]) - phase
    return np.sqrt(direction[..., 0]**2 + direction[..., 1]**2) * np.cos(order * azimuth)


class HiddenBallLobes(HiddenEffect):
    """One ball is lobed, a true surface: height * cos(order * (azimuth on the plate - phase)), most at its equator."""

    is_named: ClassVar[bool] = False
    kind: Literal['ball_lobes'] = 'ball_lobes'
    ball: Annotated[BallNumber, Drawn(Draw.ball)]
    height_um: Annotated[Number, Drawn(lambda by: by.size_um)]
    order: Undulations = 2
    phase_deg: Annotated[Number, Drawn(lambda by: by.between(0, 180))] = 0.0

    def surface(self, moment: Moment, direction: Floats, touches: TouchPattern) -> Floats:
        height = UM * self.height_um * (moment.ball == self.ball)
        return height * lobes(direction, self.order, moment.angle + np.deg2rad(self.phase_deg))


class HiddenProbeLobing(HiddenEffect):
    """The probe triggers earlier from some sides, on every ball: height * cos(order * (azimuth - phase))."""

    is_named: ClassVar[bool] = False
    kind: Literal['probe_lobing'] = 'probe_lobing'
    height_um: Annotated[Number, Drawn(lambda by: by.size_um)]
    order: Undulations = 2
    phase_deg: Annotated[Number, Drawn(lambda by: by.between(0, 180))] = 0.0

    def surface(self, moment: Moment, direction: Floats, touches: TouchPattern) -> Floats:
        return UM * self.height_um * lobes(direction, self.order, np.deg2rad(self.phase_deg))


class HiddenBedRipple(HiddenEffect):
    """The bed swells in ripples around the table: z grows with t * cos(order * alpha) where the ball stands."""

    is_named: ClassVar[bool] = False
    kind: Literal['bed_ripple'] = 'bed_ripple'
    rate_um_per_h: Annotated[Number, Drawn(lambda by: by.size_um / by.run.duration_h)]
    order: Undulations = 3

    def frame_shift(self, moment: Moment) -> Floats:
        shape = np.cos(self.order * (moment.angle + moment.azimuth))
        return along((0.0, 0.0, self.rate_um_per_h), shape * moment.hours)


class HiddenFrameAcceleration(HiddenEffect):
    """The table drifts faster and faster relative to the probe: acceleration * t^2."""

    is_named: ClassVar[bool] = False
    kind: Literal['frame_acceleration'] = 'frame_acceleration'
    acceleration_um_per_h2: Annotated[Vector, Drawn(lambda by: by.vector(by.size_um / by.run.duration_h**2))]

    def frame_shift(self, moment: Moment) -> Floats:
        return along(self.acceleration_um_per_h2, moment.hours**2)


class HiddenUnevenNoise(HiddenEffect):
    """The readings scatter more at some CMM positions: 1 + excess * (1 + cos(alpha - at)) / 2."""

    is_named: ClassVar[bool] = False
    kind: Literal['uneven_noise'] = 'uneven_noise'
    excess: Annotated[NotNegative, Drawn(lambda by: min(by.size_um / by.run.scale_um, 3.0))]
    at_deg: Annotated[Number, Drawn(lambda by: by.between(0, 360))] = 0.0

    def noise_factor(self, moment: Moment) -> Floats:
        alpha = (moment.angle + moment.azimuth) % TWO_PI
        return 1.0 + 0.5 * self.excess * (1.0 + np.cos(alpha - np.deg2rad(self.at_deg)))


KINDS = {effect.model_fields['kind'].default: effect for effect in HiddenEffect.__subclasses__()}
"""Every kind by its name in the configuration; the order, that of the classes, decides what a seed draws."""
NAMED = tuple(kind for kind, effect in KINDS.items() if effect.is_named and not effect.needs_tilt)
"""Kinds that are drawn unless others are asked for."""

if TYPE_CHECKING:
    AnyHidden = HiddenEffect
    KindName = str
else:
    AnyHidden = Annotated[Union[tuple(KINDS.values())], Field(discriminator='kind')]  # noqa: UP007
    KindName = Literal[tuple(KINDS)]
HiddenList = Annotated[tuple[AnyHidden, ...], Field(strict=False, max_length=100)]


class HiddenDraw(Settings):
    """The order `hidden: {seed: N, ...}`: number, kinds and sizes of the effects to draw.

    Sizes are drawn evenly on a logarithmic scale between `smallest_sigma` and `largest_sigma` times the repeatability
    (0.1 um where that is zero). `readings_before`: number of readings before the run, so that steps fall into it
    (default: repeatability check and alignment).
    """

    seed: Seed
    kinds: Annotated[tuple[KindName, ...], Field(strict=False)] = ()
    fewest: Annotated[int, Field(ge=0, le=10)] = 1
    most: Annotated[int, Field(ge=0, le=10)] = 3
    smallest_sigma: Positive = 0.3
    largest_sigma: Positive = 30.0
    readings_before: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode='after')
    def _ordered(self) -> Self:
        if self.fewest > self.most:
            raise ValueError(f'fewest: expected at most most = {self.most}, found {self.fewest}')
        if self.smallest_sigma > self.largest_sigma:
            raise ValueError(f'smallest_sigma: expected at most largest_sigma = {self.largest_sigma:g}, '
                             f'found {self.smallest_sigma:g}')
        return self


def draw_hidden(order: HiddenDraw, situation: Situation) -> tuple[HiddenEffect, ...]:
    """Return effects that show in a situation, each kind at most once; the same for the same seed."""
    classes = [KINDS[kind] for kind in order.kinds or NAMED]
    rng = np.random.default_rng([order.seed, 0x61])
    most = min(order.most, len(classes))
    count = int(rng.integers(min(order.fewest, most), most + 1))
    chosen = rng.permutation(len(classes))[:count]
    low, high = np.log(order.smallest_sigma), np.log(order.largest_sigma)
    return tuple(classes[place].draw(Draw(rng, situation.scale_um * float(np.exp(rng.uniform(low, high))), situation))
                 for place in chosen)

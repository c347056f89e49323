# SPDX-License-Identifier: Apache-2.0
"""The parts of the simulated cell as they were made: ball plate, rotary table, CMM, climate.

Each is drawn from the seed by its settings, and states its true errors in the conventions of the measurement equation,
T and Theta at the origin of the frame asked for:

    p = R_z(phi) (b + P) + T + Theta x R_z(phi) b + M
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rosette_ros.core.run.geometry import TWO_PI, Frame, rotate_z, rotation_matrix
from rosette_ros.core.run.records import CURVES, Floats, Ints
from rosette_ros.core.run.scheme import nominal_places
from rosette_ros.io.correction_file import read_correction
from rosette_ros.simulation.random_streams import part_generator
from rosette_ros.simulation.setting_types import NotNegative, Number, Positive, Settings, Share

_ANGLES_OF_PEAK = 2048
"""Number of angles at which the peak of a curve is found."""


class PlateSettings(Settings):
    """The ball plate: an uncalibrated one within usual tolerances."""

    balls: Annotated[int, Field(ge=3, le=720, description='n, also of table positions')] = 12
    circle_radius_mm: Positive = 182.5
    ball_radius_mm: Annotated[float, Field(gt=2.0, le=50.0)] = 7.5
    deviation_um: NotNegative = Field(20.0, description='sd of each ball coordinate')
    number: Annotated[int, Field(ge=1)] = Field(1, description='another number is another plate of this kind')


class ClampingSettings(Settings):
    """How a person clamped the plate: sizes; directions are drawn from the seed."""

    eccentricity_mm: Annotated[float, Field(ge=0, le=2)] = 0.2
    tilt_mrad: Annotated[float, Field(ge=0, le=10)] = 0.2
    turn_mrad: Annotated[float, Field(ge=-10, le=10)] = Field(0.3, description='ball 1 is off the x axis by this angle')
    height_mm: Annotated[float, Field(ge=-5, le=5)] = 0.1
    plate_turn_deg: Number = Field(
        0.0, description='whole ball pitches: the plate was put on turned, the ball next to +x is counted as ball 1')


class BallPlate:
    """A rigid plate as it was clamped on the table.

    balls: (n, 3) ball centres in the plate's own frame, in the order in which the operator counts them, m; attitude:
    (3, 3) as it was clamped; shift: (3,) of the plate's centre on the table, m.
    """

    def __init__(self, settings: PlateSettings, clamping: ClampingSettings, seed: int) -> None:
        n, another = settings.balls, f' {settings.number}' * (settings.number > 1)
        own = 1e-6 * settings.deviation_um * part_generator(seed, f'plate{another}').standard_normal((n, 3))
        # The plate was put on turned by whole pitches: its ball m is now counted as ball m + pitches.
        pitches = round(clamping.plate_turn_deg * n / 360)
        deviation = rotate_z(TWO_PI * pitches / n, np.roll(own, pitches, axis=0))
        # Clamped again, it lies elsewhere by the same amounts.
        rng = part_generator(seed, f'clamping {pitches % n}{another}')
        aside, tilted = rng.uniform(0, TWO_PI, 2)
        tilt = 1e-3 * clamping.tilt_mrad * np.array([np.cos(tilted), np.sin(tilted), 0.0])
        off = clamping.eccentricity_mm
        self.balls = nominal_places(n, settings.circle_radius_mm * 1e-3, 1, np.arange(1, n + 1)) + deviation
        self.attitude = rotation_matrix(tilt) @ rotation_matrix([0.0, 0.0, 1e-3 * clamping.turn_mrad])
        self.shift = 1e-3 * np.array([off * np.cos(aside), off * np.sin(aside), clamping.height_mm])

    def on_table(self, ball: Ints, growth: Floats | float = 0.0) -> Floats:
        """Return the centres of balls (N, 1), one-based, in the table's turning frame, (N, 1 or Q, 3), m.

        growth: relative growth of the plate in its plane, scalar or (N, Q).
        """
        centre = self.balls[ball - 1]
        if isinstance(growth, np.ndarray):
            centre = centre + growth[..., None] * (centre * np.array([1.0, 1.0, 0.0]))
        return centre @ self.attitude.T + self.shift


class AddedError(Settings):
    """A harmonic of one error, as wear or a collision leaves it: amplitude cos(per_turn angle - phase)."""

    error: Literal['ctx', 'cty', 'ctz', 'crx', 'cry', 'crz']
    per_turn: Annotated[int, Field(ge=1, le=10000)]
    amplitude: Number = Field(description='of ctx, cty, ctz in um, of crx, cry, crz in urad')
    phase_deg: Number = 0.0


class TableSettings(Settings):
    """The rotary table: peak values of its six smooth error curves, and its correction tables."""

    translation_um: NotNegative = Field(0.05, description='peak of ctx, cty, ctz')
    rotation_urad: NotNegative = Field(0.3, description='peak of crx, cry, crz')
    harmonics: Annotated[int, Field(ge=1, le=360)] = 5
    fine_orders: Annotated[tuple[Annotated[int, Field(ge=1, le=10000)], ...],
                           Field(strict=False, description='extra harmonics, e.g. above n/2')] = ()
    fine_share: Share = Field(0.2, description='amplitude of each extra harmonic as a share of the peak')
    added_errors: Annotated[tuple[AddedError, ...], Field(strict=False)] = ()
    axial_correction: bool = True
    axial_raw_um: NotNegative = Field(0.5, description='peak of the ctz correction table')
    angular_correction: bool = True
    angular_raw_urad: NotNegative = Field(2.0, description='peak of the crz correction table')
    positioning_urad: NotNegative = Field(0.0, description='sd of the stopping angle; the encoder shows it')
    correction_file: str = Field('', description='what the machine takes off (rosette correct), beside this file')


@dataclass(frozen=True, eq=False)
class PeriodicCurves:
    """Fourier sums without a constant; orders: (h,); cosine, sine: (h, 6), m and rad as core.records.CURVES."""

    orders: Ints
    cosine: Floats
    sine: Floats

    def __call__(self, angle: Floats) -> Floats:
        """Return the six curves at angles (...), as (..., 6)."""
        phase = np.asarray(angle, dtype=float)[..., None] * self.orders
        return np.cos(phase) @ self.cosine + np.sin(phase) @ self.sine


class RotaryTable:
    """A table with what its corrections leave (`residual`) and what they take out (`maker`)."""

    def __init__(self, settings: TableSettings, seed: int) -> None:
        rng = part_generator(seed, 'table')
        smooth = np.arange(1, settings.harmonics + 1)
        peaks = 1e-6 * np.array([settings.translation_um] * 3 + [settings.rotation_urad] * 3)
        maker_peaks = 1e-6 * np.array([0, 0, settings.axial_raw_um, 0, 0, settings.angular_raw_urad])
        drawn, self.maker = _drawn_curves(rng, smooth, peaks), _drawn_curves(rng, smooth, maker_peaks)
        parts = [(drawn.orders, drawn.cosine, drawn.sine)]
        if fine := settings.fine_orders:
            phase, size = part_generator(seed, 'fine').uniform(0, TWO_PI, (len(fine), 6)), settings.fine_share * peaks
            parts.append((np.array(fine), size * np.cos(phase), size * np.sin(phase)))
        if settings.added_errors:
            added = [1e-6 * one.amplitude * np.exp(1j * np.deg2rad(one.phase_deg)) *
                     (np.array(CURVES) == one.error) for one in settings.added_errors]
            parts.append((np.array([one.per_turn for one in settings.added_errors]), np.real(added), np.imag(added)))
        self.residual = PeriodicCurves(*map(np.concatenate, zip(*parts)))
        self.switched_off = np.array([0, 0, not settings.axial_correction, 0, 0, not settings.angular_correction], bool)
        self._correction = read_correction(settings.correction_file)[0] if settings.correction_file else None

    def error(self, angle: Floats, approach: Ints | None = None) -> Floats:
        """Return (ctx, cty, ctz, crx, cry, crz) of the table as it is set, (..., 6).

        approach: sense of the last move at each angle; None: positive."""
        error = self.residual(angle) + self.switched_off * self.maker(angle)
        if self._correction is not None:
            flat, back = np.ravel(angle), np.zeros(1) if approach is None else np.ravel(approach) < 0
            error = error - np.where(np.reshape(back, (-1, 1)), self._correction.errors(flat, -1),
                                     self._correction.errors(flat)).reshape(error.shape)
        return error

    def curves(self, angle: Floats, true: Frame, frame: Frame) -> Floats:
        """Return the six curves at angles (m,) in a frame, (m, 6), m and rad.

        true: frame of the bearing; frame: asked for, both in the machine frame. Seen in another frame, an error-free
        table has an offset and once-per-turn parts: those that eccentricity and tilt look like.
        """
        error, between = self.error(angle), frame_between(true, frame)
        nominal = np.swapaxes(rotate_z(np.asarray(angle)[:, None], np.eye(3)), 1, 2)
        body = rotation_matrix(error[:, 3:]) @ nominal
        body = between.rotation @ body @ between.rotation.T
        shift = error[:, :3] @ between.rotation.T + between.origin - body @ between.origin
        tilt = _rotation_vector(body @ np.swapaxes(nominal, 1, 2))
        return np.concatenate([shift, tilt], axis=1)


def _drawn_curves(rng: np.random.Generator, orders: Ints, peaks: Floats) -> PeriodicCurves:
    """Return random curves whose amplitudes fall with the order and whose peaks are given."""
    raw = rng.standard_normal((2, orders.size, 6)) / orders[:, None]
    angle = TWO_PI * np.arange(_ANGLES_OF_PEAK) / _ANGLES_OF_PEAK
    scale = peaks / np.abs(PeriodicCurves(orders, *raw)(angle)).max(axis=0)
    return PeriodicCurves(orders, raw[0] * scale, raw[1] * scale)


class CmmSettings(Settings):
    """The coordinate measuring machine: peak volumetric errors of the uncorrected axes."""

    correction: bool = True
    residual_share: Share = Field(0.05, description='share of the errors that the correction leaves')
    scale_ppm: NotNegative = 5.0
    squareness_urad: NotNegative = 10.0
    straightness_um: NotNegative = 1.5
    volume_mm: Positive = Field(1000.0, description='edge of the working volume')
    reversal_deadband_mm: Positive = Field(1.0, description='a shorter move of an axis does not change its side')


class VolumetricErrors:
    """What a CMM of three linear axes shows beside the true coordinates, around the table's origin (3,), m.

        e(p) = linear d + bow q(u) + wave sin(pi u + phase),  d = p - centre,  u = d / half

    taken per coordinate of u, with q(u) = u^2 - 1/3: `linear` (3, 3) holds scale on its diagonal and squareness above
    it; `bow` and `wave` (3, 3) [m] hold straightness off their diagonals (row: direction of the error, column: moving
    axis) and uneven scales on them.
    """

    def __init__(self, settings: CmmSettings, origin: Floats, seed: int) -> None:
        rng = part_generator(seed, 'cmm')
        share = settings.residual_share if settings.correction else 1.0
        drawn = rng.uniform(0.5, 1.0, (3, 3, 3)) * rng.choice([-1.0, 1.0], (3, 3, 3))
        scale = np.diag(settings.scale_ppm * np.diag(drawn[0]))
        straight = 1e-6 * settings.straightness_um * drawn[1:]
        self.centre, self.half = origin, 0.5e-3 * settings.volume_mm
        self.linear = share * (1e-6 * (scale + np.triu(settings.squareness_urad * drawn[0], 1)))
        self.bow, self.wave = share * straight[0], share * 0.5 * straight[1]
        self.phase = rng.uniform(0, TWO_PI, 3)

    def error(self, point: Floats) -> Floats:
        """Return the error at true points (..., 3) in the machine frame, (..., 3), m."""
        off = point - self.centre
        unit = off / self.half
        return (off @ self.linear.T + (unit * unit - 1 / 3) @ self.bow.T
                + np.sin(np.pi * unit + self.phase) @ self.wave.T)


class ClimateSettings(Settings):
    """Temperature at the plate."""

    start_degC: Annotated[float, Field(ge=0, le=50)] = 20.0
    drift_K_per_h: Number = 0.05
    daily_K: NotNegative = Field(0.1, description='amplitude of the daily cycle')
    cycle_K: NotNegative = Field(0.02, description='amplitude of the air conditioning')
    cycle_min: Positive = Field(18.0, description='period of the air conditioning')
    sensor_K: NotNegative = Field(0.002, description='sd of the thermometer')


class Climate:
    """Temperature at the plate: start, °C; rate, K/s; amplitude [K], pace [rad/s], phase [rad] of day and cooling."""

    def __init__(self, settings: ClimateSettings, seed: int) -> None:
        self.start, self.rate = settings.start_degC, settings.drift_K_per_h / 3600.0
        self.amplitude = np.array([settings.daily_K, settings.cycle_K])
        self.pace = TWO_PI / np.array([86400.0, 60.0 * settings.cycle_min])
        self.phase = part_generator(seed, 'climate').uniform(0, TWO_PI, 2)

    def warming(self, time: Floats) -> Floats:
        """Return the temperature relative to power-on at times (...) [s], same shape, K."""
        warming = self.rate * time
        for amplitude, pace, phase in zip(self.amplitude, self.pace, self.phase, strict=True):
            warming = warming + amplitude * (np.sin(pace * time + phase) - np.sin(phase))
        return warming


def frame_between(true: Frame, frame: Frame) -> Frame:
    """Return the bearing's frame in the frame asked for."""
    return Frame(frame.rotation.T @ true.rotation, frame.to_inner(true.origin))


def _rotation_vector(rotation: Floats) -> Floats:
    """Return the rotation vectors (m, 3) of small rotations (m, 3, 3), rad."""
    twice = rotation - np.swapaxes(rotation, 1, 2)
    sine = 0.5 * twice[:, (2, 0, 1), (1, 2, 0)]
    size = np.linalg.norm(sine, axis=-1, keepdims=True)
    return sine / np.sinc(np.arcsin(size) / np.pi)

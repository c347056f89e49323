# SPDX-License-Identifier: Apache-2.0
"""Causes that machines have and single shapes do not describe, by name."""

from benchmarks.blind import frame_causes, further_causes, machine_causes, plate_causes, support_causes
from benchmarks.blind.cause import Cause

CAUSES: dict[str, type[Cause]] = {
    'plate_on_three_feet': plate_causes.PlateOnThreeFeet,
    'stems_under_gravity': plate_causes.StemsUnderGravity,
    'ball_creep_exponential': plate_causes.BallCreep,
    'ball_creep_linear': plate_causes.BallCreepLinear,
    'ball_rattle': plate_causes.BallRattle,
    'temperature_coarse': frame_causes.TemperatureCoarse,
    'temperature_missing': frame_causes.TemperatureMissing,
    'temperature_gap': frame_causes.TemperatureGap,
    'temperature_lagged': frame_causes.TemperatureLagged,
    'drift_from': frame_causes.DriftFrom,
    'drift_quadratic': frame_causes.DriftQuadratic,
    'pulse': frame_causes.FramePulse,
    'backlash_by_angle': machine_causes.BacklashByAngle,
    'probe_direction': machine_causes.ProbeDirection,
    'probe_lobes': machine_causes.ProbeLobes,
    'scale_drift': machine_causes.ScaleDrift,
    'squareness_drift': machine_causes.SquarenessDrift,
    'encoder_interpolation': machine_causes.EncoderInterpolation,
    'encoder_harmonics': machine_causes.EncoderHarmonics,
    'ball_fixed_in_machine': plate_causes.BallFixedInMachine,
    'product_2phi_3beta_z': plate_causes.PlateProduct,
    'product_2phi_3beta_radial': plate_causes.PlateProductRadial,
}

BEYOND: dict[str, type[Cause]] = {
    'plate_creep_settles': further_causes.PlateCreepSettles,
    'table_zero_step': further_causes.TableZeroStep,
    'axis_tilt_step': further_causes.AxisTiltStep,
    'spring_back': further_causes.SpringBack,
    'unsteady_cycle': further_causes.UnsteadyCycle,
    'expansion_lagged': further_causes.ExpansionLagged,
    'two_balls_creep': further_causes.TwoBallsCreep,
    'foot_settles': support_causes.FootSettles,
    'foot_drops': support_causes.FootDrops,
    'plate_soaks': support_causes.PlateSoaks,
    'plate_turns_settling': support_causes.PlateTurnsSettling,
}
"""Causes that no family had been written for when they were drawn first."""

EVERY = {**CAUSES, **BEYOND}

# SPDX-License-Identifier: Apache-2.0
"""A simulated cell without any error or noise."""

from rosette_ros.simulation import MachineConfig

_SILENT = {
    'plate': {'deviation_um': 0.0},
    'clamping': {'eccentricity_mm': 0.0, 'tilt_mrad': 0.0, 'turn_mrad': 0.0, 'height_mm': 0.0},
    'placement': {'origin_mm': (0.0, 0.0, 0.0), 'origin_error_mm': 0.0, 'axis_tilt_mrad': 0.0},
    'table': {'translation_um': 0.0, 'rotation_urad': 0.0},
    'cmm': {'scale_ppm': 0.0, 'squareness_urad': 0.0, 'straightness_um': 0.0},
    'probing': {'repeatability_um': 0.0},
    'climate': {'drift_K_per_h': 0.0, 'daily_K': 0.0, 'cycle_K': 0.0, 'sensor_K': 0.0},
    'timing': {'jitter_s': 0.0},
}


def ideal_cell(**groups) -> MachineConfig:
    """Return its configuration, in which single settings differ."""
    return MachineConfig().changed(**_SILENT).changed(**groups)

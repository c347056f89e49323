# SPDX-License-Identifier: Apache-2.0
"""A calibration without ROS: plan, state machine, goal, resume, settings."""

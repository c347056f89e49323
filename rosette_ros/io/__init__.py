# SPDX-License-Identifier: Apache-2.0
"""A run in and out of files: MCAP logs and CSV tables. No ROS is needed here."""

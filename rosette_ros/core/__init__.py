# SPDX-License-Identifier: Apache-2.0
"""Three-rosette error separation and its statistics: numpy and scipy only, no ROS, no files."""

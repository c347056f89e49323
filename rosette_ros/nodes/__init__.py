# SPDX-License-Identifier: Apache-2.0
"""The cell on ROS 2: nodes translate messages and call the other packages; they calculate nothing."""

# SPDX-License-Identifier: Apache-2.0
"""What a process finishes before it ends, however it is asked to: its cell. Loads nothing of ROS."""

import threading

ENDING = threading.RLock()
"""Held while nodes are ended, which is bounded in time; who ends the process by force takes it before."""

# SPDX-License-Identifier: Apache-2.0
"""A CMM through I++ DME: the protocol, safe paths, the table, and the measurement of one ball. No ROS."""

# SPDX-License-Identifier: Apache-2.0
"""A run as measured: its records, frames, axes, orders, reduced sets, touches and their spheres; errors."""

# SPDX-License-Identifier: Apache-2.0
"""Plans of measurement: what they show, and what to measure next."""

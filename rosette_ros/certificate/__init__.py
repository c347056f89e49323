# SPDX-License-Identifier: Apache-2.0
"""Calibration certificates of runs: what they state, the DCC, its check against the run, pages for people."""

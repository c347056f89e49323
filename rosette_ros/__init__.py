# SPDX-License-Identifier: Apache-2.0
"""Calibrates rotary tables by the three-rosette method, and finds what a model of the cell leaves out."""

__version__ = '0.1.0'

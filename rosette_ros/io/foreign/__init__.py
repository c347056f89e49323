# SPDX-License-Identifier: Apache-2.0
"""Results of other programs: a file for each format, listed in formats.py."""

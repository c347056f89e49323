# SPDX-License-Identifier: Apache-2.0
"""The command line: one error door, one file per verb."""

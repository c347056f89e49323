# SPDX-License-Identifier: Apache-2.0
"""The command line: errors are printed in one place; one file per verb."""

# SPDX-License-Identifier: Apache-2.0
"""What follows for the table: correction, its check, trend."""

# SPDX-License-Identifier: Apache-2.0
"""Several runs evaluated as one, and plates of any pitch."""

# SPDX-License-Identifier: Apache-2.0
"""The coverage factor of all expanded uncertainties."""

COVERAGE_FACTOR = 2
"""k of expanded uncertainties, about 95 % (GUM 6.2)."""

# SPDX-License-Identifier: Apache-2.0
"""Which physical effect is missing: candidates, search, significance, cross-validation."""

# SPDX-License-Identifier: Apache-2.0
"""The uncertainty of the curves: mixtures, environment, hidden effects, ISO 230-7 lines, budget."""

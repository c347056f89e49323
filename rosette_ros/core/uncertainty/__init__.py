# SPDX-License-Identifier: Apache-2.0
"""What is not known of the curves: mixtures, environment, hidden effects, ISO 230-7 lines, budget."""

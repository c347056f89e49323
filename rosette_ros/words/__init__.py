# SPDX-License-Identifier: Apache-2.0
"""What every interface says in the same words: verdicts, noise, effects and their settings."""

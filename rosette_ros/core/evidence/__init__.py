# SPDX-License-Identifier: Apache-2.0
"""The diagnosis by one score: the log evidence of every hypothesis about a run, members and noise together."""

# SPDX-License-Identifier: Apache-2.0
"""Figures of results, made from records, without a window."""

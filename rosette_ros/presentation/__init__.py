# SPDX-License-Identifier: Apache-2.0
"""Results for people and programs: formatting, JSON, tables, plots, report."""

# SPDX-License-Identifier: Apache-2.0
"""The report: one page with a run, its verdict, and all that is needed to repeat it."""

from rosette_ros.presentation.report.provenance import Source, open_source
from rosette_ros.presentation.report.run_page import pictures_of, report_html

__all__ = ['Source', 'open_source', 'pictures_of', 'report_html']

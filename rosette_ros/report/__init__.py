# SPDX-License-Identifier: Apache-2.0
"""The report: one page that holds a run, what is wrong with it, and all that is needed to repeat it."""

from rosette_ros.report.page import report_html, write_report
from rosette_ros.report.parts import Overlay, pictures_of
from rosette_ros.report.sources import Source, open_source
from rosette_ros.report.tables import tables_of
from rosette_ros.report.verification import verify
from rosette_ros.report.verification_page import verification_html

__all__ = ['Overlay', 'Source', 'open_source', 'pictures_of', 'report_html', 'tables_of',
           'verification_html', 'verify', 'write_report']

# SPDX-License-Identifier: Apache-2.0
"""The page of a trend: what changed when, when tolerances are reached, errors over time."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.identity_words import simulated_words
from rosette_ros.presentation.plots.trend_plots import Dates
from rosette_ros.presentation.report.page_parts import PAGES, inline_svgs
from rosette_ros.presentation.report.provenance import software
from rosette_ros.presentation.table_format import Table


def trend_html(serial: str, model_hash: str, dates: Dates, sentences: Sequence[str], tables: Sequence[Table],
               pictures: Mapping[str, Figure], command: str = '', simulated: Sequence[str] = ()) -> str:
    """Return the trend of a table as one HTML text. sentences: what it says;
    tables: changes, forecast; pictures: ranges; simulated: names of the runs that were."""
    return PAGES.get_template('trend.html.j2').render(
        serial=serial, model_hash=model_hash, dates=dates, sentences=sentences,
        tables={table.name: table for table in tables}, pictures=inline_svgs(pictures), command=command,
        simulated=simulated_words(simulated, len(dates)), software=software(), k=text.COVERAGE_FACTOR,
        iso=text.iso_range(None),
        numbers={name: place for place, name in enumerate(pictures, 1)},
        running=f'Table {serial or "without serial number"}, {len(dates)} runs{" (SIMULATED)" * bool(simulated)}')

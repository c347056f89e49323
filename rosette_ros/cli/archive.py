# SPDX-License-Identifier: Apache-2.0
"""rosette archive: many runs of many cells, a row each."""

from rosette_ros.cli import archive_add, archive_query, archive_reanalyse

WHAT = {
    'add': ('evaluate the logs in folders and keep a row of each run; what is known is not done again',
            archive_add.add_arguments, archive_add.run),
    'query': ('what an archive says, by SQL or by ready questions', archive_query.add_arguments, archive_query.run),
    'reanalyse': ('evaluate all runs under another model and compare: residuals, curves, which runs had the effect',
                  archive_reanalyse.add_arguments, archive_reanalyse.run),
}
"""Word: what it does, its arguments, its function. Another one is a line here."""

# SPDX-License-Identifier: Apache-2.0
"""An engine without other processes."""


class PlainLoop:
    """One after the other, in this process."""

    def results(self, function, items):
        """See archive.run_adding.Engine."""
        for item in items:
            yield item, function(item)

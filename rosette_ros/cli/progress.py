# SPDX-License-Identifier: Apache-2.0
"""Progress of a calibration: a bar on a terminal, and a line per phase everywhere."""

import sys
import time

from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

from rosette_ros.cli.screen import console
from rosette_ros.nodes.programme import Phase

WORDS = {
    Phase.REPEATABILITY: 'repeatability check',
    Phase.ALIGNMENT: 'table axis and frame',
    Phase.RUN: 'run',
    Phase.DRIFT_CHECK: 'drift check',
    Phase.EVALUATION: 'evaluation',
}
"""What a phase does, for a person; phases that are no work have no words."""


class ProgressDisplay:
    """Shows the Progress of a CellClient on stderr; a context manager."""

    def __init__(self):
        """Prepare; nothing is shown before the context is entered."""
        out = console(sys.stderr)
        self._out = out
        self._bar = Progress(
            SpinnerColumn(), TextColumn('{task.description:<22}'), BarColumn(bar_width=32),
            MofNCompleteColumn(), TextColumn('{task.fields[rate]}'), console=out,
            transient=True, disable=not out.is_terminal)
        self._phase, self._began, self._from, self._done = None, 0.0, 0, 0

    def __enter__(self):
        """Start showing."""
        self._bar.start()
        self._task = self._bar.add_task('waiting for the cell', total=None, rate='')
        return self

    def __exit__(self, *_):
        """Stop showing; what was done stays in lines."""
        self._end_phase()
        self._bar.stop()

    def show(self, progress):
        """Take the Progress and show it."""
        self._done = max(self._done, progress.done)
        if progress.phase is not self._phase:
            self._end_phase()
            self._phase, self._began = progress.phase, time.monotonic()
            self._from = self._done
        self._bar.update(self._task, completed=self._done, total=progress.total,
                         description=WORDS.get(progress.phase, ''), rate=self._rate())

    def _rate(self):
        balls, spent = self._done - self._from, time.monotonic() - self._began
        return f'{balls / spent:.0f} balls/s' if balls > 1 and spent > 0.2 else ''

    def _end_phase(self):
        if self._phase in WORDS:
            balls, spent = self._done - self._from, time.monotonic() - self._began
            what = f'{balls:4d} balls' if balls else ' ' * 10
            self._out.print(f'  {WORDS[self._phase]:<22}{what}  {spent:5.1f} s')
        self._phase = None

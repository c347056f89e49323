# SPDX-License-Identifier: Apache-2.0
"""Results beside the truth of the simulated machine, for the demonstrations."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rosette_ros.analysis import Report
from rosette_ros.cli.screen import table
from rosette_ros.core.records import CURVES, remove_gauge
from rosette_ros.machine import Machine
from rosette_ros.words import fixed


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results against the truth of the simulated machine, both freed of the gauge.

    truth: (n, 6), m and rad; error: (n, 6) differences in units of the standard uncertainty.
    """

    truth: np.ndarray
    error: np.ndarray

    @property
    def rms(self):
        """Root mean square of the normalised errors; 1 is expected."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def rms_spread(self):
        """Standard deviation expected of the rms: 6 n values, ten of them fixed by the gauge."""
        return float(1 / np.sqrt(2 * (self.error.size - 10)))


def compare(report: Report, config, frame):
    """Return the Comparison of a report with the machine's truth in the frame that was found."""
    motions = report.error_motions
    truth = remove_gauge(Machine(config).table_truth(motions.angle, frame))
    return Comparison(truth, (motions.values - truth) / motions.u)


def truth_table(comparison):
    """Return the table of differences to the truth, by curve."""
    made = table('difference to the truth', *CURVES)
    for name, values in (('rms in u', np.sqrt(np.mean(comparison.error**2, axis=0))),
                         ('largest in u', np.abs(comparison.error).max(axis=0))):
        made.add_row(name, *(fixed(float(value), 2) for value in values))
    return made


def shown(path):
    """Return a path as short as it can be typed from here."""
    path = Path(path).absolute()
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)

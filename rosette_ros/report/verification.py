# SPDX-License-Identifier: Apache-2.0
"""The paper's verification: runs under other conditions must give the same error motions.

Kniel et al. (2019), section 3: (i) everything corrected, (ii) the plate turned by 90°, (iii) the
correction of the CMM's axes off, (iv) that and the table's axial correction off. Two more runs, with
the table's angular correction off and on again, stand for what the paper shows of crz alone.
"""

import csv
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy import special

from rosette_ros.analysis import Report
from rosette_ros.core.errors import InvalidData
from rosette_ros.core.records import CURVES
from rosette_ros.report.sources import Source
from rosette_ros.story import BAD, GOOD, Verdict

ROLES = (('(i) all corrected', ()), ('(ii) plate turned', ()), ('(iii) CMM correction off', ()),
         ('(iv) CMM and table axial correction off', ('ctz',)), ('table angular correction off', ('crz',)),
         ('angular correction on again', ()))
"""Name of each run in order, and the curves in which it must not agree with the others."""
PAPER = (0.02e-6, 0.2e-6)
"""Reproducibility that the paper states for translations, m, and rotations, rad."""
PAPER_CRZ = 0.4e-6
"""Largest difference to the maker's crz table that the paper states, rad."""
SURE = 0.001
"""Chance of noise making the runs differ as much below which they are said to differ."""
MAKER_COLUMNS = ('table_angle_deg', 'ctz_um', 'crz_urad')
LARGEST_FILE = 10_000_000


@dataclass(frozen=True, eq=False)
class Member:
    """One run of a verification: its role, what it says, and the curves that must not agree."""

    label: str
    report: Report
    source: Source
    apart: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MakerTable:
    """Correction tables of the table's maker: angle (m,), rad; ctz, m; crz, rad."""

    angle: np.ndarray
    ctz: np.ndarray
    crz: np.ndarray

    def at(self, curve, angle):
        """Return a curve at angles, rad, interpolated, freed of its mean over them, m or rad."""
        value = np.interp(angle, self.angle, getattr(self, curve), period=2 * np.pi)
        return value - value.mean()


@dataclass(frozen=True, eq=False)
class Verification:
    """Runs that must agree, and how well they do.

    members: Member each, the first with everything corrected; maker: MakerTable or None.
    """

    members: tuple[Member, ...]
    maker: MakerTable | None = None

    @property
    def angle(self):
        """Nominal table angles, (n,), rad."""
        return self.members[0].report.error_motions.angle

    @cached_property
    def values(self):
        """Curves of all runs, (m, n, 6), m and rad; NaN where a run must not agree."""
        out = np.array([one.report.error_motions.values for one in self.members])
        for place, one in enumerate(self.members):
            out[place][:, [CURVES.index(curve) for curve in one.apart]] = np.nan
        return out

    @cached_property
    def mean(self):
        """Mean of the curves that must agree, (n, 6)."""
        return np.nanmean(self.values, axis=0)

    @property
    def differences(self):
        """Curves of all runs less their mean, (m, n, 6), NaN where a run must not agree."""
        return self.values - self.mean

    @cached_property
    def counts(self):
        """How many runs must agree in each curve, (6,)."""
        return np.isfinite(self.values[:, 0]).sum(axis=0)

    @cached_property
    def reproducibility(self):
        """Reproducibility of each curve, (6,), m and rad.

            s = mean over table angles of sqrt(sum over runs (x - mean)^2 / (m - 1))
        """
        return np.nanstd(self.values, axis=0, ddof=1).mean(axis=0)

    @cached_property
    def expected(self):
        """What noise alone would give for `reproducibility`, (6,): mean u times c4(m)."""
        u = np.array([one.report.error_motions.u for one in self.members])
        u = np.where(np.isfinite(self.values), u, np.nan)
        return np.nanmean(u, axis=(0, 1)) * np.array([_c4(count) for count in self.counts])

    @property
    def overall(self):
        """Reproducibility of translations, m, and of rotations, rad: means over three curves each."""
        return float(self.reproducibility[:3].mean()), float(self.reproducibility[3:].mean())

    @cached_property
    def p(self):
        """Chance that noise of the stated uncertainties makes the runs differ as much.

        Of the 6 n values of a run ten are fixed by the gauge.
        """
        u = np.array([one.report.error_motions.u for one in self.members])
        free = 1 - 10 / self.mean.size
        chi = free * float(np.nansum((self.differences / u)**2))
        dof = free * float(np.sum(self.counts - 1)) * len(self.angle)
        return float(special.chdtrc(dof, chi))

    @property
    def agrees(self):
        """Whether noise explains how the runs differ."""
        return self.p >= SURE

    def switched(self, curve):
        """Return what a switched-off correction puts on a curve, (n,), None where no run has it off."""
        runs = [one for one in self.members if curve in one.apart]
        return runs[0].report.error_motions[curve] - self.mean[:, CURVES.index(curve)] if runs else None

    def remainder(self, curve):
        """Return a curve with its correction off less the maker's table, (n,), None without both."""
        off = self.switched(curve)
        if off is None or self.maker is None:
            return None
        return off + self.mean[:, CURVES.index(curve)] - self.maker.at(curve, self.angle)

    @property
    def verdict(self):
        """The Verdict: do the runs agree, and how well."""
        shift, turn = (1e6 * value for value in self.overall)
        size = f'{shift:.3f} µm and {turn:.2f} µrad (the paper: 0.02 µm and 0.2 µrad)'
        if self.agrees:
            return Verdict(GOOD, f'The error motions come out the same under all conditions: they '
                           f'reproduce within {size}.', 'Nothing needs to be done.')
        worst = self.members[int(np.nanargmax(np.nanmax(self._sizes, axis=(1, 2))))].label
        curve = CURVES[int(np.nanargmax(np.nanmax(self._sizes, axis=(0, 1))))]
        return Verdict(BAD, f'The runs differ by more than their noise: they reproduce within {size}.',
                       f'Look at {worst} and at {curve} first; rosette report of each run says what its '
                       'model lacks.')

    @cached_property
    def _sizes(self):
        u = np.array([one.report.error_motions.u for one in self.members])
        return np.abs(self.differences) / u


def verify(runs, maker=None):
    """Return the Verification of (Report, Source) of four or six runs in the order of ROLES.

    Raises InvalidData for another number of runs, and where their plates differ.
    """
    if len(runs) not in (4, 6):
        raise InvalidData(f'--compare: wanted four runs or six, got {len(runs)}: (i) all corrected, (ii) plate '
                          'turned, (iii) CMM correction off, (iv) axial correction off too, and perhaps '
                          'table angular correction off and on again')
    first = runs[0][0].run
    for report, source in runs[1:]:
        if report.run.n != first.n or not math.isclose(report.run.radius, first.radius, rel_tol=1e-9):
            raise InvalidData(f'{source.path}: wanted {first.n} balls on R = {1e3 * first.radius:g} mm as in '
                              f'{runs[0][1].path}, got {report.run.n} on {1e3 * report.run.radius:g} mm')
    members = tuple(Member(label, report, source, apart)
                    for (label, apart), (report, source) in zip(ROLES, runs, strict=False))
    return Verification(members, maker)


def read_maker(path):
    """Return the MakerTable of a CSV file with the columns of MAKER_COLUMNS.

    Raises InvalidData, naming file and row, for what is none.
    """
    try:
        if Path(path).stat().st_size > LARGEST_FILE:
            raise InvalidData(f'{path}: wanted a table of at most {LARGEST_FILE} bytes, got more')
        with open(path, encoding='utf-8-sig', newline='') as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidData(f"{path}: wanted a readable table of the maker's corrections, got: {error}") from error
    if not rows or tuple(rows[0]) != MAKER_COLUMNS:
        raise InvalidData(f'{path}: row 1: wanted the columns {",".join(MAKER_COLUMNS)}, got '
                          f'{",".join(rows[0]) if rows else "an empty file"!r:.80}')
    numbers = np.array([_numbers(row, path, place) for place, row in enumerate(rows[1:], 2)]).reshape(-1, 3)
    if len(numbers) < 3:
        raise InvalidData(f'{path}: wanted at least 3 rows of corrections, got {len(numbers)}')
    return MakerTable(np.deg2rad(numbers[:, 0]), 1e-6 * numbers[:, 1], 1e-6 * numbers[:, 2])


def _numbers(row, path, place):
    try:
        numbers = [float(cell) for cell in row]
    except ValueError:
        numbers = []
    if len(numbers) != len(MAKER_COLUMNS) or not all(map(math.isfinite, numbers)):
        raise InvalidData(f'{path}: row {place}: wanted {len(MAKER_COLUMNS)} finite numbers, got '
                          f'{",".join(row)!r:.80}')
    return numbers


def _c4(count):
    """Return the mean of a standard deviation of `count` normal values, in units of the true one."""
    return math.sqrt(2 / (count - 1)) * math.exp(math.lgamma(count / 2) - math.lgamma((count - 1) / 2))

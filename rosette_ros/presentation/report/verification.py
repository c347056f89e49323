# SPDX-License-Identifier: Apache-2.0
"""The verification of the method, and its page: runs under different conditions must give the same error motions.

Kniel et al. (2019), section 3: (i) everything corrected, (ii) the plate turned by 90°, (iii) the correction of the
CMM's axes off, (iv) that and the table's axial correction off. Two more runs, with the table's angular correction off
and on again, stand for what the paper shows of crz alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import scipy  # which loads its parts where they are used
from matplotlib.figure import Figure

from rosette_ros.core.diagnosis.run_result import RunResult
from rosette_ros.core.diagnosis.verdict import Level
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.geometry import same_angles
from rosette_ros.core.run.number_words import p_value
from rosette_ros.core.run.records import CURVES, SI_UNITS, ErrorMotions, Floats, Ints
from rosette_ros.core.uncertainty.error_summary import peak_to_valley
from rosette_ros.io.csv_cells import cells_of
from rosette_ros.io.text_file import read_limited
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.identity_words import simulated_words
from rosette_ros.presentation.plots.result_plots import Extra, Series, differences, six_curves
from rosette_ros.presentation.report.page_parts import PAGES, inline_svgs
from rosette_ros.presentation.report.provenance import Source, software
from rosette_ros.presentation.table_format import Column, Table, column, micrometre_column, words
from rosette_ros.words.effect_words import fixed, scale_of
from rosette_ros.words.result_words import ConclusionText

ROLES = (('(i) all corrected', ()), ('(ii) plate turned', ()), ('(iii) CMM correction off', ()),
         ('(iv) CMM and table axial correction off', ('ctz',)), ('table angular correction off', ('crz',)),
         ('angular correction on again', ()))
"""Name of each run in order, and the curves in which it must not agree with the others."""
PAPER = (0.02e-6, 0.2e-6)
"""Reproducibility that the paper states for translations, m, and rotations, rad."""
SURE = 0.001
"""Runs differ where noise makes such differences with a smaller probability."""
MAKER_COLUMNS = ('table_angle_deg', 'ctz_um', 'crz_urad')
LARGEST_FILE = 10_000_000
DIGITS = 3, 3, 3, 2, 2, 2


@dataclass(frozen=True, eq=False)
class VerificationRun:
    """One run of a verification: its role, its result, where it is from, and the curves that must not agree."""

    label: str
    result: RunResult
    source: Source
    apart: tuple[str, ...] = ()

    @property
    def fit(self) -> Fit:
        """That of the curves."""
        return self.result.curves.fit

    @property
    def motions(self) -> ErrorMotions:
        """The curves of the result, with U."""
        return self.result.curves.motions


@dataclass(frozen=True, eq=False)
class MakerTable:
    """Correction tables of the table's maker: angle (m,), rad; ctz, m; crz, rad."""

    angle: Floats
    ctz: Floats
    crz: Floats

    def at(self, curve: str, angle: Floats) -> Floats:
        """Return a curve at angles, rad, interpolated, freed of its mean over them, m or rad."""
        value: Floats = np.interp(angle, self.angle, getattr(self, curve), period=2 * np.pi)
        return value - value.mean()


@dataclass(frozen=True, eq=False)
class Verification:
    """Runs that must agree, the first with everything corrected, and how well they do."""

    members: tuple[VerificationRun, ...]
    maker: MakerTable | None = None

    @property
    def angle(self) -> Floats:
        """Nominal table angles, (n,), rad."""
        return self.members[0].motions.angle

    @property
    def rotation(self) -> Floats | None:
        """Rotation of the table frame of the first run, as of Run."""
        return self.members[0].fit.run.rotation

    @cached_property
    def values(self) -> Floats:
        """Curves of all runs, (m, n, 6), m and rad; NaN where a run must not agree."""
        out = np.array([one.motions.values for one in self.members])
        for place, one in enumerate(self.members):
            out[place][:, [CURVES.index(curve) for curve in one.apart]] = np.nan
        return out

    @cached_property
    def mean(self) -> Floats:
        """Mean of the curves that must agree, (n, 6)."""
        return np.nanmean(self.values, axis=0)

    @cached_property
    def differences(self) -> Floats:
        """Curves of all runs less their mean, (m, n, 6), NaN where a run must not agree."""
        return self.values - self.mean

    @cached_property
    def u(self) -> Floats:
        """Standard uncertainties of all runs, (m, n, 6), m and rad."""
        return np.array([one.motions.u for one in self.members])

    @cached_property
    def counts(self) -> Ints:
        """How many runs must agree in each curve, (6,)."""
        return np.isfinite(self.values[:, 0]).sum(axis=0)

    @cached_property
    def reproducibility(self) -> Floats:
        """Reproducibility, (6,), m and rad: mean over table angles of sqrt(sum over runs (x - mean)^2 / (m - 1))."""
        return np.nanstd(self.values, axis=0, ddof=1).mean(axis=0)

    @cached_property
    def expected(self) -> Floats:
        """What noise alone would give for `reproducibility`, (6,): mean u times c4(m)."""
        u = np.where(np.isfinite(self.values), self.u, np.nan)
        return np.nanmean(u, axis=(0, 1)) * np.array([_c4(count) for count in self.counts])

    @property
    def overall(self) -> tuple[float, float]:
        """Reproducibility of translations, m, and of rotations, rad: means over three curves each."""
        return float(self.reproducibility[:3].mean()), float(self.reproducibility[3:].mean())

    @cached_property
    def p(self) -> float:
        """Probability that noise alone makes the runs differ as much; ten of 6 n values are fixed by the gauge."""
        free = 1 - 10 / self.mean.size
        chi = free * float(np.nansum((self.differences / self.u)**2))
        dof = free * float(np.sum(self.counts - 1)) * len(self.angle)
        return float(scipy.special.chdtrc(dof, chi))

    @property
    def agrees(self) -> bool:
        """Whether noise explains the differences of the runs."""
        return self.p >= SURE

    def switched(self, curve: str) -> Floats | None:
        """Return what a switched-off correction adds to a curve, (n,), None where no run has it off."""
        runs = [one for one in self.members if curve in one.apart]
        return runs[0].motions[curve] - self.mean[:, CURVES.index(curve)] if runs else None

    def remainder(self, curve: str) -> Floats | None:
        """Return a curve with its correction off less the maker's table, (n,), None without both."""
        off = self.switched(curve)
        if off is None or self.maker is None:
            return None
        return off + self.mean[:, CURVES.index(curve)] - self.maker.at(curve, self.angle)

    @property
    def verdict(self) -> ConclusionText:
        """The conclusion: do the runs agree, and how well."""
        size = '{} (the paper: {})'.format(*(
            f'{text.sized(one, "m", places)} and {text.sized(other, places=places - 1)}'
            for (one, other), places in ((self.overall, 3), (PAPER, 2))))
        if self.agrees:
            return ConclusionText(Level.GOOD, 'The error motions are the same under all conditions: they reproduce '
                                  f'within {size}.', 'Nothing needs to be done.')
        sizes = np.abs(self.differences) / self.u
        worst = self.members[int(np.nanargmax(np.nanmax(sizes, axis=(1, 2))))].label
        curve = CURVES[int(np.nanargmax(np.nanmax(sizes, axis=(0, 1))))]
        return ConclusionText(Level.BAD, f'The runs differ by more than their noise: they reproduce within {size}.',
                              f'Check {worst} and {curve} first, and diagnose each run.')


def verify(runs: Sequence[tuple[RunResult, Source]], maker: MakerTable | None = None) -> Verification:
    """Return the Verification of runs in the order of ROLES; raises InvalidData where number, plates or table
    angles are wrong."""
    if len(runs) not in (4, 6):
        raise InvalidData(f'--compare: expected four runs or six, found {len(runs)}: (i) all corrected, (ii) plate '
                          'turned, (iii) CMM correction off, (iv) axial correction off too, and perhaps '
                          'table angular correction off and on again')
    members = tuple(VerificationRun(label, result, source, apart)
                    for (label, apart), (result, source) in zip(ROLES, runs, strict=False))
    first, angle = members[0].fit.run, members[0].motions.angle
    for one in members[1:]:
        run, path = one.fit.run, one.source.path
        if run.n != first.n or not math.isclose(run.radius, first.radius, rel_tol=1e-9):
            raise InvalidData(f'{path}: expected {first.n} balls on R = {text.millimetres(first.radius)} as in '
                              f'{members[0].source.path}, found {run.n} on {text.millimetres(run.radius)}')
        if not same_angles(one.motions.angle, angle):
            raise InvalidData(f'{path}: expected table angles from {np.rad2deg(angle[0]):.6g} deg on as in '
                              f'{members[0].source.path}, found them from {np.rad2deg(one.motions.angle[0]):.6g} deg '
                              'on; '
                              'take runs at the same angles')
    return Verification(members, maker)


def read_maker(path: Path | str) -> MakerTable:
    """Return the MakerTable of a CSV file with the columns of MAKER_COLUMNS; raises InvalidData with file and row."""
    data = read_limited(path, "a table of the maker's corrections", LARGEST_FILE)
    try:
        lines = data.decode('utf-8-sig').splitlines()
    except UnicodeDecodeError as error:
        raise InvalidData(f"{path}: expected a readable table of the maker's corrections, found: {error}") from error
    rows = [cells_of(line, str(path), number) for number, line in enumerate(lines, 1)]
    if not rows or tuple(rows[0]) != MAKER_COLUMNS:
        raise InvalidData(f'{path}: row 1: expected the columns {",".join(MAKER_COLUMNS)}, found '
                          f'{",".join(rows[0]) if rows else "an empty file"!r:.80}')
    numbers = np.array([_row_numbers(row, path, place) for place, row in enumerate(rows[1:], 2)]).reshape(-1, 3)
    if len(numbers) < 3:
        raise InvalidData(f'{path}: expected at least 3 rows of corrections, found {len(numbers)}')
    return MakerTable(np.deg2rad(numbers[:, 0]), 1e-6 * numbers[:, 1], 1e-6 * numbers[:, 2])


def _row_numbers(row: list[str], path: Path | str, place: int) -> list[float]:
    try:
        numbers = [float(cell) for cell in row]
    except ValueError:
        numbers = []
    if len(numbers) != len(MAKER_COLUMNS) or not all(map(math.isfinite, numbers)):
        raise InvalidData(f'{path}: row {place}: expected {len(MAKER_COLUMNS)} finite numbers, found '
                          f'{",".join(row)!r:.80}')
    return numbers


def _c4(count: int) -> float:
    return math.sqrt(2 / (count - 1)) * math.exp(math.lgamma(count / 2) - math.lgamma((count - 1) / 2))


# The page


def verification_html(verification: Verification, command: str = '',
                      pictures: Mapping[str, Figure] | None = None, annexed: bool = False) -> str:
    """Return the report of a Verification as one HTML text; pictures: where they are drawn already; annexed: as of
    `report_html`."""
    pictures = pictures or verification_pictures(verification, annexed)
    members = verification.members
    files = {(file.path, file.sha256): file for one in members for file in one.source.files}
    simulated = [one.label for one in members if one.fit.run.simulated]
    return PAGES.get_template('verification.html.j2').render(
        verification=verification, iso=text.iso_range(verification.rotation),
        sizes=_bars(verification), files=tuple(files.values()), command=command,
        pictures=inline_svgs(pictures), tables={table.name: table for table in verification_tables(verification)},
        p=f'{text.P_VALUE} of the differences: {p_value(verification.p)}', maker=maker_rows(verification),
        sized=text.sized,
        counts=dict(zip(CURVES, verification.counts.tolist(), strict=True)),
        numbers={name: place for place, name in enumerate(pictures, 1)}, software=software(), annexed=annexed,
        simulated=simulated_words(simulated, len(members)), model=text.model_words(members[0].result.fit.model),
        running=f'Verification, {len(members)} runs, the first {_name(members[0])}{" (SIMULATED)" * bool(simulated)}')


def verification_pictures(verification: Verification, annexed: bool = True) -> dict[str, Figure]:
    """Return the figures of a verification by name; annexed: with those of the annex."""
    members = verification.members
    series = [Series(one.label, one.motions, place == 0) for place, one in enumerate(members)]
    curves = {'verification_curves': six_curves(series, extras=_extras(verification))}
    return curves | ({'differences': differences(
        [one.label for one in members], verification.angle, verification.differences, verification.expected,
        np.repeat(PAPER, 3), verification.rotation)} if annexed else {})


def _extras(verification: Verification) -> list[Extra]:
    """Return the maker's tables and the remainder beyond them: curves (v) and (vi) of the paper."""
    out = []
    names = "(v) maker's table", "(vi) correction off minus maker's table"
    for curve in ('ctz', 'crz'):
        left = verification.remainder(curve)
        if left is not None and verification.maker is not None:
            values = verification.maker.at(curve, verification.angle), left
            out += [Extra(curve, name, value) for name, value in zip(names, values, strict=True)]
    return out


def _bars(verification: Verification) -> list[tuple[str, list[tuple[str, float, str, str]]]]:
    """Return two groups of bars, this cell, noise alone, the paper: label, size, text, class of colour."""
    expected = verification.expected[:3].mean(), verification.expected[3:].mean()
    groups = []
    for place, (heading, si, digits) in enumerate((('Translations', 'm', 3), ('Rotations', 'rad', 2))):
        values = (('Reproducibility of these runs', verification.overall[place], 'after'),
                  ('Expected of noise', expected[place], 'noise'), ('Kniel et al. (2019)', PAPER[place], 'before'))
        groups.append((f'{heading}, {scale_of(si).unit}', [
            (label, value, text.sized(value, si, digits), kind) for label, value, kind in values]))
    return groups


def maker_rows(verification: Verification) -> list[tuple[str, ...]]:
    """Return correction, curve, and the changes when it is switched off: whole, minus the maker's table, remainder."""
    out, names = [], text.curve_names(verification.rotation)
    for what, place in (('axial', 2), ('angular', 5)):
        curve = CURVES[place]
        off, left = verification.switched(curve), verification.remainder(curve)
        if off is not None:
            changes = [off, *([left, left - verification.mean[:, place]] if left is not None else [])]
            out.append((what, names[place], *(
                text.sized(float(np.abs(one).max()), SI_UNITS[curve]) for one in changes)))
    return out


def verification_tables(verification: Verification) -> tuple[Table, ...]:
    """Return the tables of a verification: reproducibility, conditions of the runs, their curves."""
    sizes = np.nanmax(np.abs(verification.differences), axis=(0, 1))
    rows = (('reproducibility', 'these runs', verification.reproducibility),
            ('expected', 'expected of noise', verification.expected), ('paper', 'the paper', np.repeat(PAPER, 3)),
            ('largest_difference', 'largest difference to the mean', sizes))
    reproducibility = Table('reproducibility', 'Reproducibility of each curve: standard deviation over the runs', (
        words('curve', 'curve', text.curve_names(verification.rotation)),
        column('runs', 'runs', verification.counts, str),
        words('unit', 'unit', text.curve_units()),
        *(Column(f'{key}_in_unit', name, tuple((text.curve_factors() * values).tolist()),
                 tuple(map(text.sized, values, SI_UNITS.values(), DIGITS)))
          for key, name, values in rows)))
    members, fits = verification.members, [one.fit for one in verification.members]
    conditions = Table('runs', 'The runs and their conditions', (
        words('run', 'run', [one.label for one in members]),
        words('run_id', 'name', map(_name, members)),
        *([words('curves', 'curves', [one.result.curves.which for one in members])]
          if any(one.result.beside for one in members) else []),
        micrometre_column('residual_rms_um', 'residual', [one.rms for one in fits]),
        micrometre_column('cmm_rms_um', 'CMM measurement errors, rms', [_rms(one.cmm) for one in fits]),
        micrometre_column('plate_rms_um', 'ball centre deviations, rms', [_rms(one.plate) for one in fits], 1)))
    spans = Table('run_spans', 'Peak to valley of the curves of each run', (
        words('run', 'run', [one.label for one in members]),
        *(column(f'span_{curve}_{text.file_unit(unit)}', curve, [
            factor * float(peak_to_valley(one.motions[curve])) for one in members],
                 partial(fixed, places=3 - (unit == 'µrad')), unit)
          for curve, (factor, unit) in zip(CURVES, text.curve_scales(), strict=True))))
    columns = [column('table_angle_deg', 'angle', np.rad2deg(verification.angle), partial(fixed, places=1), '°')]
    for place, one in enumerate(members, 1):
        columns += [column(f'run{place}_{curve}_{text.file_unit(unit)}', curve, factor * one.motions[curve],
                           partial(text.signed, places=3 - (unit == 'µrad')) if place == 1 else None, unit)
                    for curve, (factor, unit) in zip(CURVES, text.curve_scales(), strict=True)]
    curves = Table('verification_curves', f'The curves of run {members[0].label}', tuple(columns))
    return reproducibility, conditions, spans, curves


def _name(member: VerificationRun) -> str:
    return member.fit.run.run_id or member.source.path


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean((values - values.mean(axis=0))**2)))

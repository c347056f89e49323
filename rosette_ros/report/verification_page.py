# SPDX-License-Identifier: Apache-2.0
"""The page of a verification: runs beside one another, how well they agree, and beside the paper."""

from functools import partial

import numpy as np

from rosette_ros.core.records import CURVES, ISO_NAMES
from rosette_ros.pictures.curves import Extra, Series, six_curves
from rosette_ros.pictures.verification import differences
from rosette_ros.report.page import PAGES, drawn
from rosette_ros.report.parts import MARKS, Bar, Picture
from rosette_ros.report.sources import software
from rosette_ros.report.table import Table, column, words
from rosette_ros.report.tables import SHOWN_UNITS, UM, UNITS
from rosette_ros.report.verification import PAPER, PAPER_CRZ
from rosette_ros.story import BAD, GOOD
from rosette_ros.words import chance, fixed, signed

SECTIONS = (('verdict', 'Verdict'), ('curves', 'Error motions'), ('differences', 'Differences'),
            ('reproducibility', 'Reproducibility'), ('runs', 'Runs'), ('conditions', 'Conditions'))
"""Name and title of every section, in order."""
WORDS = {GOOD: 'the runs agree', BAD: 'the runs differ'}


def verification_html(verification, command='', pictures=None):
    """Return the report of a Verification as one HTML text; pictures: where they have been drawn."""
    pictures = pictures or verification_pictures(verification)
    files = {(file.path, file.sha256): file for one in verification.members for file in one.source.files}
    return PAGES.get_template('verification.html.j2').render(
        sections=SECTIONS, verification=verification, verdict=verification.verdict,
        mark=(MARKS[verification.verdict.level][0], WORDS[verification.verdict.level]),
        bars=_bars(verification), pictures={name: drawn(one) for name, one in pictures.items()},
        tables={table.name: table for table in verification_tables(verification)},
        p=chance(verification.p), how=how(verification), maker=maker_words(verification),
        gauge=verification.members[0].report.gauge, files=tuple(files.values()), command=command,
        software=software(), run=verification.members[0].report.run)


def verification_pictures(verification):
    """Return the Pictures of a Verification by name."""
    members = verification.members
    series = [Series(one.label, one.report.error_motions, place == 0) for place, one in enumerate(members)]
    reference = np.repeat(PAPER, 3)
    every = (
        Picture('verification_curves', 'The six error motions under all conditions, as in Figure 5 of the paper; '
                'the band is the expanded uncertainty (k = 2) of the first run, and about that of every other. '
                'All lines of a panel must agree but those whose correction was switched off.',
                six_curves(series, extras=_extras(verification))),
        Picture('differences', 'Each run less the mean of those that must agree. Grey: what noise explains (twice '
                'the standard deviation). Dashed: the reproducibility that the paper states, 0.02 µm and '
                '0.2 µrad.', differences([one.label for one in members], verification.angle,
                                         verification.differences, verification.expected, reference)))
    return {picture.name: picture for picture in every}


def _extras(verification):
    """Return the maker's tables and what is left beyond them: curves (v) and (vi) of the paper."""
    out = []
    for curve, names in (('ctz', ("maker's table", "axial correction off less maker's table")),
                         ('crz', ("(v) maker's table", '(vi) angular correction off less (v)'))):
        left = verification.remainder(curve)
        if left is not None:
            angle = verification.angle
            out += [Extra(curve, names[0], angle, verification.maker.at(curve, angle)),
                    Extra(curve, names[1], angle, left)]
    return out


def _bars(verification):
    """Return two groups of bars, µm and µrad: this cell, noise alone, the paper."""
    expected = verification.expected[:3].mean(), verification.expected[3:].mean()
    groups = []
    for what, unit, digits, values in zip(
            ('Translations', 'Rotations'), ('µm', 'µrad'), (3, 2),
            zip(verification.overall, expected, PAPER, strict=True), strict=True):
        top = max(values)
        groups.append((f'{what}, {unit}', [
            Bar(label, f'{fixed(1e6 * value, digits)} {unit}', float(value / top), kind)
            for label, value, kind in zip(('Reproducibility of these runs', 'what noise alone would give',
                                           'Kniel et al. (2019)'), values, ('after', 'noise', 'before'),
                                          strict=True)]))
    return groups


def how(verification):
    """Return how the reproducibility is worked out, in words."""
    counts = dict(zip(CURVES, verification.counts.tolist(), strict=True))
    others = sorted({count for curve, count in counts.items() if curve not in ('ctz', 'crz')})
    return ('For each curve and each table angle the standard deviation over the runs that must agree is taken, '
            'with m − 1 in its denominator, and then its mean over all angles; the numbers for µm and µrad are the '
            f'means over three curves each. m is {others[0]}, for ctz {counts["ctz"]} and for crz '
            f'{counts["crz"]}, because runs whose correction of a curve is off do not count for it.')


def maker_words(verification):
    """Return sentences on what switching off a correction brought, beside the maker's table."""
    out = []
    for curve, unit, what in (('ctz', 'µm', 'axial'), ('crz', 'µrad', 'angular')):
        off, left = verification.switched(curve), verification.remainder(curve)
        if off is None:
            continue
        text = (f'With the {what} correction of the table off, {curve} ({ISO_NAMES[curve]}) changes by up to '
                f'{1e6 * np.abs(off).max():.2f} {unit}')
        if left is not None:
            rest = 1e6 * np.abs(left).max()
            text += (f"; less the maker's table at most {rest:.2f} {unit} is left: the error that the correction "
                     'leaves anyway')
            if curve == 'crz':
                text += f' (the paper: {1e6 * PAPER_CRZ:g} µrad)'
            rest = 1e6 * np.abs(left - verification.mean[:, CURVES.index(curve)]).max()
            text += f', and it is within {rest:.2f} {unit} of what the corrected runs show'
        out.append(f'{text}.')
    return out


def verification_tables(verification):
    """Return the Tables of a Verification."""
    return (_reproducibility(verification), _runs(verification), _curves(verification))


def _reproducibility(verification):
    digits = [3 if unit == 'um' else 2 for unit in UNITS]
    sizes = 1e6 * np.nanmax(np.abs(verification.differences), axis=(0, 1))
    rows = [1e6 * verification.reproducibility, 1e6 * verification.expected, 1e6 * np.repeat(PAPER, 3), sizes]
    shown = [[f'{fixed(float(value), places)} {SHOWN_UNITS[unit]}'
              for value, places, unit in zip(row, digits, UNITS, strict=True)] for row in rows]
    heads = (('reproducibility', 'these runs'), ('expected', 'noise alone'), ('paper', 'the paper'),
             ('largest_difference', 'largest difference to the mean'))
    return Table('reproducibility', 'Reproducibility of each curve, standard deviation over the runs', (
        words('curve', 'curve', [f'{curve} ({ISO_NAMES[curve]})' for curve in CURVES]),
        column('runs', 'runs', verification.counts, str), words('unit', 'unit', [SHOWN_UNITS[u] for u in UNITS]),
        *(_column(f'{key}_in_unit', head, row, texts) for (key, head), row, texts
          in zip(heads, rows, shown, strict=True))))


def _column(key, head, values, texts):
    texts = iter(texts)
    return column(key, head, values, lambda _: next(texts))


def _runs(verification):
    members = verification.members
    reports = [one.report for one in members]
    def rms(values):
        return 1e6 * float(np.sqrt(np.mean((values - values.mean(axis=0))**2)))
    return Table('runs', 'The runs, and what their conditions changed', (
        words('run', 'run', [one.label for one in members]),
        words('run_id', 'name', [one.report.run.run_id or one.source.path for one in members]),
        column('residual_rms_um', 'residual / µm', [1e6 * one.fit.rms for one in reports], UM),
        column('cmm_rms_um', 'CMM deviations, rms / µm', [rms(one.cmm) for one in reports], UM),
        column('plate_rms_um', 'plate deviations, rms / µm', [rms(one.plate) for one in reports],
               partial(fixed, places=1)),
        *(column(f'span_{curve}_{unit}', f'{curve} peak to valley / {SHOWN_UNITS[unit]}',
                 [1e6 * float(np.ptp(one.error_motions[curve])) for one in reports],
                 partial(fixed, places=3 if unit == 'um' else 2))
          for curve, unit in zip(CURVES, UNITS, strict=True))))


def _curves(verification):
    angle = np.rad2deg(verification.angle)
    columns = [column('table_angle_deg', 'angle / °', angle, partial(fixed, places=1))]
    for place, one in enumerate(verification.members, 1):
        for curve, unit in zip(CURVES, UNITS, strict=True):
            columns.append(column(f'run{place}_{curve}_{unit}', f'{curve} / {SHOWN_UNITS[unit]}',
                                  1e6 * one.report.error_motions[curve],
                                  partial(signed, places=3 if unit == 'um' else 2) if place == 1 else None))
    return Table('verification_curves', f'The curves of run {verification.members[0].label}', tuple(columns))

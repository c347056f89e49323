# SPDX-License-Identifier: Apache-2.0
"""What a report is made of besides tables: pictures with captions, tiles, conditions."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from rosette_ros.analysis import Report
from rosette_ros.core.spectrum import spectrum
from rosette_ros.pictures import residuals as residual_pictures
from rosette_ros.pictures import stages
from rosette_ros.pictures.curves import Series, six_curves
from rosette_ros.pictures.deviations import deviations
from rosette_ros.pictures.spectrum import SpectrumRow, spectrum_maps
from rosette_ros.report.sources import order_of
from rosette_ros.report.tables import base_name, rung_names
from rosette_ros.report_json import COVERAGE_FACTOR
from rosette_ros.story import BAD, DOUBTFUL, GOOD
from rosette_ros.words import MEANINGS, chance, decimals, duration, exact, fixed, names, pauses

MARKS = {GOOD: ('✓', 'fits'), DOUBTFUL: ('?', 'open'), BAD: ('✗', 'does not fit')}
"""Level of a verdict: sign and word, so that nobody has to see the colour."""
MOST_CANDIDATES = 8
MOST_SPECTRA = 3
KINDS = {'radial': (0, 2, 'µm'), 'axial': (2, 3, 'µm'), 'tilt': (3, 5, 'µrad'),
         'angular positioning': (5, 6, 'µrad')}
"""Columns of the six curves by what they are for the table."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with the name of its file, and what it shows, in words."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True, eq=False)
class Overlay:
    """Another run whose curves are drawn over those of the report."""

    label: str
    report: Report


@dataclass(frozen=True)
class Bar:
    """A bar of the first glance: label, size in µm, share of the longest, what kind it is."""

    label: str
    size: str
    share: float
    kind: str


def pictures_of(story, overlays=()):
    """Return every Picture of a Story by name; overlays: Overlay each."""
    rows = _residual_rows(story)
    noise = story.run.repeatability
    every = (
        Picture('curves', _curve_caption(story, overlays), six_curves(_series(story, overlays))),
        Picture('deviations', 'Deviations of the ball plate and of the CMM. Arrows: x and y, each panel at '
                'its own scale; colour: z. Both come from the same readings and need no calibration; '
                'the plate was found as it was clamped.',
                deviations(story.final.plate, story.final.cmm, story.run.radius)),
        Picture('residual_maps', 'Residuals of every reading by table position and ball, all maps on one '
                'scale. Dashed lines join readings at one CMM position, whose number stands at the left. '
                'Noise looks like salt and pepper; rows, columns, diagonals or patches are what the model '
                'does not explain.', residual_pictures.residual_maps(rows)),
        Picture('residuals_against', 'Residuals against time, table angle and, where it is known, '
                'temperature, with the mean of neighbours. The mean at a table angle is zero by itself: '
                'the table motions take it up.', residual_pictures.against(rows, noise)),
        Picture('histogram', _histogram_caption(noise), residual_pictures.histogram(
            rows, noise, [one.fit.dof for one in _reports(story)])),
        *_spectrum_picture(story), _ladder_picture(story), *_candidate_picture(story),
        _visibility_picture(story))
    return {picture.name: picture for picture in every}


def model_label(story, report):
    """Return what a model is called in legends."""
    if report is story.report:
        return base_name(report.model) if not report.model.terms else 'model as given'
    added = report.model.names[len(story.model.names):]
    return f'with {names(dict.fromkeys(added))}'


def _reports(story):
    """Return the reports before and after what is claimed; one where nothing is."""
    changed = story.final.model.names != story.report.model.names
    return (story.report, story.final) if changed else (story.report,)


def _series(story, overlays):
    reports = _reports(story)[::-1]
    own = [Series(model_label(story, report), report.error_motions) for report in reports]
    return [*own, *(Series(one.label, one.report.error_motions) for one in overlays)]


def _curve_caption(story, overlays):
    text = (f'The six error motions of the table after VDI/VDE 2617 (ISO 230-7), each with the band of its '
            f'expanded uncertainty U (k = {COVERAGE_FACTOR}).')
    if len(_reports(story)) > 1:
        text += ' Blue: with all that is claimed, the best account of the run; orange: without it.'
    return text + (' Other runs are drawn over it.' if overlays else '')


def _residual_rows(story):
    reports = _reports(story)
    when = ('before: ', 'after: ') if len(reports) > 1 else ('',)
    return [residual_pictures.Residuals(f'{word}{model_label(story, report)}', story.run, report.fit.residual)
            for word, report in zip(when, reports, strict=True)]


def _histogram_caption(noise):
    if noise is None:
        return 'How large the residuals are. The repeatability is not known, so no noise is drawn beside them.'
    return ('How large the residuals are, beside the curve that noise of the repeatability would give after '
            'the fit has taken its share.')


def _spectrum_picture(story):
    """Return the picture of spectra: what the last model leaves, and where each claimed effect stands."""
    run, final = story.run, story.final
    if not run.is_complete:
        return ()
    claimed = final.effects[len(story.model.terms):][:MOST_SPECTRA]
    rows = [SpectrumRow(f'left by the {base_name(story.model)}' if not story.model.terms else 'left by the model',
                        spectrum(run, story.report.fit.residual, story.model.base), True)]
    rows += [SpectrumRow(effect.name, spectrum(run, effect.displacement, final.model.base))
             for effect in claimed]
    return (Picture('spectrum', 'The same as waves of table and CMM position. Grey lines are what the base '
                    'model takes up whole: nothing can be seen there. Noise is even everywhere else; an effect '
                    'is seen by what it has off the grey lines.', spectrum_maps(rows, run.repeatability)),)


def _ladder_picture(story):
    rungs, run = story.rungs, story.run
    known, dof = run.repeatability, run.repeatability_dof
    spread = known / np.sqrt(2 * dof) if known is not None and dof else 0.0
    caption = 'The error after every effect that was added, in the fit and in readings that the fit did not use.'
    if known is not None:
        caption += (' A complete model ends at the repeatability; the grey band is what its own check leaves '
                    'open (k = 2).')
    return Picture('ladder', caption, stages.ladder(
        rung_names(rungs), [rung.report.fit.rms for rung in rungs], [rung.held_out for rung in rungs], known,
        spread))


def _candidate_picture(story):
    every = story.diagnosis.candidates[:MOST_CANDIDATES]
    if not every:
        return ()
    return (Picture('candidates', 'What each candidate does to the error in readings that were left out, '
                    'beside all that is claimed above it.', stages.candidates(
                        [one.effect for one in every], [one.held_out_before for one in every],
                        [one.held_out_after for one in every], [one.claimed for one in every],
                        story.run.repeatability)),)


def _visibility_picture(story):
    every = story.visibilities
    best = story.advice.best if story.advice else None
    differs = best is not None and best.label != story.advice.present.label
    shares = {one.name: one.typical_share for one in best.visibilities} if differs else {}
    return Picture(
        'visibility', 'The share of each effect that the residual of a run shows; the rest hides in table, '
        'plate and CMM. It depends on the order of measurement alone.', stages.visibility(
            [one.name for one in every],
            [np.nan if one.reason else one.typical_share for one in every],
            [shares.get(one.name, np.nan) for one in every] if differs else None,
            (f'this order: {order_of(story.run)}', f'recommended: {best.label}' if differs else '')))


def glance(story):
    """Return the bars of the first glance: residual before and after beside the repeatability."""
    reports, noise = _reports(story), story.run.repeatability
    sizes = [(f'Residual, {model_label(story, one)}', one.fit.rms, kind)
             for one, kind in zip(reports, ('before', 'after') if len(reports) > 1 else ('after',),
                                  strict=True)]
    if noise is not None:
        sizes.append(('Repeatability of a reading', noise, 'noise'))
    top = max(size for _, size, _ in sizes)
    return [Bar(label, f'{1e6 * size:.3g} µm', size / top, kind) for label, size, kind in sizes]


def spans(motions):
    """Return (what, span, U) of the error motions of the table as texts, the largest curve of each."""
    out = []
    for what, (low, high, unit) in KINDS.items():
        size = 1e6 * np.ptp(motions.values[:, low:high], axis=0)
        place = int(np.argmax(size))
        spread = 1e6 * COVERAGE_FACTOR * float(motions.u[:, low + place].max())
        digits = decimals(spread)
        out.append((what, f'{fixed(float(size[place]), digits)} {unit}', f'U {fixed(spread, digits)} {unit}'))
    return out


def findings(story):
    """Return (name, chance of noise, what it is, where to look) of each effect that is claimed."""
    out = []
    for name in story.diagnosis.missing:
        effect = MEANINGS.get(name)
        p = min((one.p for one in story.diagnosis.candidates if one.effect == name and one.claimed), default=0.0)
        out.append((name, chance(p), effect.meaning if effect else '', effect.look if effect else ''))
    return out


def conditions(story, source=None):
    """Return what was measured, when and how, as (name, text) rows."""
    run, fit = story.run, story.final.fit
    share = '' if run.is_complete else f' of {run.n**2}'
    rows = [('Run', run.run_id or run.source),
            ('Plate', f'n = {run.n} balls on R = {exact(1e3 * run.radius, 6)} mm; mean radius found '
                      f'{1e3 * fit.mean_radius:.6f} mm'),
            ('Readings', f'{run.size}{share} ball centres'),
            ('Order', order_of(run, source)),
            ('Log begun', source.begun if source and source.begun else 'not recorded'),
            ('Duration', duration(float(np.ptp(run.time)))),
            *([('Pauses', pauses(run))] if run.pauses else []),
            ('Temperature', _temperature(run)), ('Repeatability', _repeatability(run)),
            ('Table angles', f'at most {1e6 * np.abs(run.angle_deviation).max():.3g} µrad off nominal'),
            ('Uncertainties', f'from {1e6 * fit.sigma:.4g} µm per coordinate of a ball centre, as told by '
                              f'{fit.sigma_source}'),
            ('Model as asked', str(story.model)), ('Final model', str(story.final.model))]
    return rows


def _temperature(run):
    known = run.temperature[np.isfinite(run.temperature)]
    if not known.size:
        return 'not recorded'
    return (f'{known[0]:.3f} °C at the start, {known[-1]:.3f} °C at the end, between {known.min():.3f} and '
            f'{known.max():.3f} °C')


def _repeatability(run):
    if run.repeatability is None:
        return 'not known'
    dof = '' if run.repeatability_dof is None else f', {run.repeatability_dof:g} degrees of freedom'
    return f'{1e6 * run.repeatability:.4f} µm per coordinate{dof}'

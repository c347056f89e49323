# SPDX-License-Identifier: Apache-2.0
"""What a certificate states: identity, curves, summary, conditions, what is not known, where it comes from; no advice.

All follows from the files of the runs and from Inputs, so that a certificate can be made again and compared."""

import datetime
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rosette_ros.analysis import evaluate_jointly, result
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.run_to_run import joint_lines
from rosette_ros.core.model.least_squares import Fit, FittedEffect
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import ErrorMotions, Floats, Run
from rosette_ros.core.run.remarks import RemarkKind
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.error_summary import AxisError, doubt_of
from rosette_ros.core.uncertainty.hidden_effects import MOST_BALLS
from rosette_ros.core.uncertainty.uncertainty_budget import Budget, probability_of_u
from rosette_ros.io.budget_file import budget_inputs, environment_of
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.identity_file import Identity, words_of_entry
from rosette_ros.io.open_run import has_plate, joint_identity
from rosette_ros.io.reading_checks import known_temperatures, remark_on_radius
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.budget_results import beyond_words, environment_words
from rosette_ros.presentation.identity_words import conditions
from rosette_ros.presentation.joint_results import joint_head, joint_rows
from rosette_ros.presentation.report.joint_page import open_with_files
from rosette_ros.presentation.report.provenance import FileDigest, Source, open_source, order_of, software
from rosette_ros.presentation.report.run_page import touches_of
from rosette_ros.words.effect_words import capital, fixed
from rosette_ros.words.joint_words import note_words
from rosette_ros.words.reading_words import fact_words, notes_of, remark_words
from rosette_ros.words.result_words import ConclusionText, conclusion_text
from rosette_ros.words.verdict_words import verdict_text

PAPER = ('K. Kniel, M. Franke, F. Härtig, F. Keller, M. Stein: Detecting 6 DoF geometrical errors of rotary tables, '
         'Measurement (2019)')
DOI = 'https://doi.org/10.1016/j.measurement.2019.107366'
METHOD = ('Three-rosette method: each ball of a circular plate is measured at each position of the table; least '
          'squares separate the deviations of table, ball plate and CMM, none of which has to be calibrated before.')
DAY = datetime.timedelta(1)
"""Dates of a log are UTC, those of an identity local: so much they may differ."""
COMPENSATED = 'effects that the curves do not contain'
NEEDED = ('certificate.number', 'laboratory.country')
"""Entries without which there is no document."""
CONTENT_OF_U = 'contains the scatter of the readings and the uncertainty of the effects in the model'
OF_BUDGET = 'is that of the uncertainty budget, the root of the sum of its squares'
HEAT = ('plate_expansion', 'frame_expansion')
"""Sections of an inputs file that bring heat into U."""


Ask = Callable[[tuple[str, ...]], object]


@dataclass(frozen=True)
class Inputs:
    """What a certificate needs besides its runs; issued: the day; sharing: fields of Sharing that are declared.

    budget: what a file of budget inputs says, None where none is stated; columns: of tables of another program;
    files: names by SHA-256; programs: (name, version) of the software."""

    identity: Identity
    issued: str
    model: Mapping[str, Any] | None = None
    run_id: str | None = None
    is_joint: bool = False
    sharing: Mapping[str, Any] = field(default_factory=dict)
    budget: Mapping[str, Any] | None = None
    columns: ColumnMap | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    programs: tuple[tuple[str, str], ...] = field(default_factory=software)


@dataclass(frozen=True)
class Measured:
    """One run: what was measured, in words; days: first and last; temperatures: (N,) °C, known ones only."""

    name: str
    rows: tuple[tuple[str, str], ...]
    days: tuple[str, str] | None
    temperatures: Floats
    simulated: bool


@dataclass(frozen=True, eq=False)
class CurveSet:
    """Six curves with their errors in a line each; words: which table, which sense of turning; dof: of U."""

    words: str
    motions: ErrorMotions
    lines: tuple[AxisError, ...]
    dof: float

    @property
    def probability(self) -> float:
        """That U contains the true value."""
        return probability_of_u(self.dof)


@dataclass(frozen=True, eq=False)
class Certificate:
    """What a certificate states; budget: of U, None of several runs and of plates that are too large for one.

    conditions: of measuring, (name, text), '' where one is not stated; compensated: effects in the model of the
    curves, which do not contain them; time_unit: as of Run."""

    inputs: Inputs
    identity: Identity
    contradictions: tuple[str, ...]
    days: tuple[str, str]
    conditions: tuple[tuple[str, str], ...]
    runs: tuple[Measured, ...]
    sets: tuple[CurveSet, ...]
    verdict: VerdictText | ConclusionText | None
    evaluation: tuple[tuple[str, str], ...]
    unknown: tuple[str, ...]
    files: tuple[FileDigest, ...]
    budget: Budget | None = None
    compensated: tuple[FittedEffect, ...] = ()
    time_unit: str = 's'

    @property
    def is_simulated(self) -> bool:
        """Whether any of the runs is."""
        return any(run.simulated for run in self.runs)

    @property
    def is_limited(self) -> bool:
        """Whether conformity with a tolerance is decided."""
        return any(line.tolerance is not None and not line.doubt for curves in self.sets for line in curves.lines)

    @property
    def beside_conformity(self) -> str:
        """What a decision on conformity does not consider, in a sentence; '' where none is made."""
        if not self.is_limited:
            return ''
        return f'Conformity is decided with this U, which does not contain {lacking_in_u(self.budget)}.'

    @property
    def judgement(self) -> str:
        """Whether the model fits, in a sentence."""
        return self.verdict.sentence if self.verdict else 'Whether the model fits was not judged.'

    @property
    def missing(self) -> tuple[str, ...]:
        """Required entries that nobody stated, in words."""
        return tuple(map(words_of_entry, self.identity.missing))


NO_RESULT = frozenset((RemarkKind.NO_TEMPERATURE, RemarkKind.UNIT_OF_TEMPERATURE, RemarkKind.SAME_TEMPERATURE))
"""Remarks that a certificate does not repeat: it states the temperatures."""


def state(paths: Sequence[str | Path], inputs: Inputs,
          ask: Ask = lambda _: None) -> Certificate:
    """Return what a certificate of runs states; raises RosetteError where something that it cannot do without lacks.

    ask: is told the mandatory data that nobody stated, in words, before anything is calculated."""
    if not inputs.is_joint and not any(map(has_plate, paths)):
        return _of_one(paths[0], inputs, ask)
    return _of_several(paths, inputs, ask)


def _of_one(path: str | Path, inputs: Inputs, ask: Ask) -> Certificate:
    run, source = open_source(path, inputs.run_id, columns_of=inputs.columns)
    identity, contradictions = source.identity.with_changes(inputs.identity)
    limits, measured = identity.limits(run.rotation), _measured(run, source)
    days = _complete(identity, [measured], ask, inputs.issued)
    given = budget_inputs(inputs.budget) if inputs.budget else BudgetInputs()
    refit, untouched = touches_of(source)
    found = result(run, Model.from_mapping(dict(inputs.model), 'model') if inputs.model else None, given, refit)
    verdict = verdict_text(found.verdict) if found.verdict else None
    made = found.budget_with() if inputs.budget or run.n <= MOST_BALLS else None
    fit, curves = found.curves.fit, found.curves
    facts = [fact_words(one) for one in run.remarks if one.kind not in NO_RESULT]
    unknown = [*text.not_known(run, fit.gauge, facts), *(verdict.limits if verdict else ()), *untouched]
    which = (('Result', f'{curves.which}, as something is missing from the given model, '
              f'{text.model_words(found.fit.model)}'),) if found.beside else ()
    evaluation = (('Model', text.model_words(fit.model)), *which, ('Residual', text.residual_words(fit)),
                  ('Uncertainty', text.uncertainty_words(fit)),
                  ('Environment', environment_words(given.environment)))
    dof = float(made.effective_dof.min()) if made else fit.dof
    return _stated(inputs, identity, contradictions, days, [measured], [run.radius], [
        CurveSet('table', curves.motions, curves.lines(limits), dof)], verdict, evaluation, unknown, source.files, made,
                   fit)


def _of_several(paths: Sequence[str | Path], inputs: Inputs, ask: Ask) -> Certificate:
    opened = [open_with_files(path, inputs.run_id, inputs.columns) for path in paths]
    logged, contradictions = joint_identity([(path, inputs.run_id) for path in paths])
    identity, changed = logged.with_changes(inputs.identity)
    runs = [Measured(readings.name, (('Run', joint_head(readings)),), None, np.array([]), readings.simulated)
            if has_plate(path) else _measured(*open_source(path, inputs.run_id, columns_of=inputs.columns))
            for path, (readings, _) in zip(paths, opened, strict=True)]
    days = _complete(identity, runs, ask, inputs.issued)
    given = environment_of(inputs.budget)
    result = evaluate_jointly([run for run, _ in opened], inputs.sharing, given)
    conclusion = conclude(result)
    sets = [CurveSet(one.words, motions, lines, result.sigma_dof) for one, motions, lines in joint_lines(
        result, identity.limits(result.solution.model.runs[0].rotation), doubt_of(conclusion))]
    rows = dict(joint_rows(result))
    evaluation = (*((name, rows[name]) for name in ('Model', 'Residual', 'Uncertainty', 'Known')),
                  ('Environment', environment_words(given)))
    unknown = [f'Cannot be measured by these runs; removed from the curves: {rows["Not determined"]}.', *(
        f'{words if "run" in one.numbers else capital(words)}.'  # the name of a run stays as it is
        for one in result.notes for words in [note_words(one)])]
    radii = [float(radius) for one, _ in opened for radius in one.plate.radius]
    return _stated(inputs, identity, (*contradictions, *changed), days, runs, radii, sets,
                   conclusion_text(conclusion), evaluation, unknown,
                   tuple(dict.fromkeys(file for _, files in opened for file in files)))


def _complete(identity: Identity, runs: Sequence[Measured], ask: Ask, issued: str) -> tuple[str, str]:
    """Return the first and the last day; ask for the mandatory data that nobody stated, or raise InvalidData that
    names all of them where there is no document without one."""
    days = _days(identity, [run.days for run in runs if run.days], issued)
    lacking = [entry for entry in NEEDED if not identity[entry]]
    lacking += [] if days else ['measured.begin', 'measured.end']
    others = tuple(words_of_entry(entry) for entry in identity.missing if entry not in lacking)
    if lacking or days is None:
        also = f'; ISO/IEC 17025, 7.8.2 asks for these, too: {", ".join(others)}' if others else ''
        raise InvalidData(f'certificate: expected {", ".join(map(words_of_entry, lacking))}, found none; state '
                          f'{", ".join(lacking)} in the identity file (--identity FILE; fill in a copy of '
                          f'config/identity.yaml){also}')
    if others:
        ask(others)
    _check_issue(identity['certificate.date'], issued, days[1])
    return days


def _stated(inputs: Inputs, identity: Identity, contradictions: Sequence[str], days: tuple[str, str],
            runs: Sequence[Measured], radii: Sequence[float], sets: Sequence[CurveSet],
            verdict: VerdictText | ConclusionText | None, evaluation: tuple[tuple[str, str], ...],
            unknown: Iterable[str], files: Sequence[FileDigest], made: Budget | None = None,
            fit: Fit | None = None) -> Certificate:
    least = min(one.probability for one in sets)
    environment = budget_inputs(inputs.budget).environment if inputs.budget else None
    content = (f'U (k = 2, about {100 * least:.0f} %) {OF_BUDGET if made else CONTENT_OF_U}; it does not contain '
               f'effects that are not in the model{beyond_words(environment)}, nor {lacking_in_u(made)}.')
    further = [
        'The results relate only to the item calibrated, under the conditions stated.',
        'The temperature was not measured.' if not any(run.temperatures.size for run in runs) else '',
        *(f'Contradiction: {words}.' for words in contradictions), content]
    paths = {file.path: Path(file.path).name for file in files}

    def bare(sentence: str) -> str:  # a path says where a copy lay, not what was measured
        for path, name in paths.items():
            sentence = sentence.replace(str(Path(path).parent) + '/', '').replace(path, name)
        return sentence
    return Certificate(
        inputs, identity, tuple(contradictions), days, _conditions(identity, radii), tuple(runs), tuple(sets), verdict,
        tuple((name, bare(words)) for name, words in evaluation),
        tuple(bare(sentence) for sentence in (*unknown, *further) if sentence),
        tuple(FileDigest(inputs.files.get(file.sha256, Path(file.path).name), file.size, file.sha256)
              for file in files), made, fit.effects if fit else (), fit.run.time_unit if fit else 's')


def _conditions(identity: Identity, radii: Sequence[float]) -> tuple[tuple[str, str], ...]:
    """Return the conditions of measurement; radii: of the balls, m, the radial place where none is stated."""
    ends = ' to '.join(dict.fromkeys(map(text.millimetres, (min(radii), max(radii)))))
    on_the_balls = {'conditions.radial': f'on the circle of the ball centres, R = {ends}'}
    return tuple(conditions(Identity({**on_the_balls, **identity.entries})))


def _days(identity: Identity, known: Sequence[tuple[str, str]], issued: str) -> tuple[str, str] | None:
    """Return the first and the last day, of the runs or else as stated; raises InvalidData where both differ.

    Days of a recorder after the day of issue are those of a wrong clock, and the stated ones count."""
    stated = identity['measured.begin'], identity['measured.end'] or identity['measured.begin']
    if not known or (stated[0] and _is_after(max(end for _, end in known), issued)):
        return stated if stated[0] else None
    found = min(begin for begin, _ in known), max(end for _, end in known)
    for which, name, one, other in zip((0, 1), ('begin', 'end'), stated, found):
        if one and abs(datetime.date.fromisoformat(one) - datetime.date.fromisoformat(other)) > DAY:
            raise InvalidData(f'certificate: measured.{name}: the log says {found[which]}, the identity file {one}; '
                              'leave it out of the file')
    return found


def _is_after(day: str, issued: str) -> bool:
    return datetime.date.fromisoformat(day) > datetime.date.fromisoformat(issued) + DAY


def _check_issue(stated: str, issued: str, ended: str) -> None:
    """Raise InvalidData where the day of issue, stated or that of today, lies before the last day of measuring."""
    if stated and _is_after(ended, stated):
        raise InvalidData('certificate: certificate.date: expected a day of issue after the measurement, which ended '
                          f'{ended}, found {stated}; correct it in the identity file')
    if _is_after(ended, issued):
        raise InvalidData(f'certificate: measured.end: expected a day of measuring before that of issue, {issued}, '
                          'found '
                          f'{ended}; was the clock of the recorder wrong? State measured.begin and measured.end in '
                          'the identity file')


def _measured(run: Run, source: Source) -> Measured:
    if doubt := remark_on_radius(run.radius):
        raise InvalidData(f'{run.source}: expected readings whose unit is sure for a certificate, found: '
                          f'{remark_words(doubt)}')
    days = (source.begun[:10], source.ended[:10]) if source.begun and source.ended else None
    known = known_temperatures(run)
    degrees = [fixed(float(one), 3) for one in (known.min(), known.max())] if known.size else []
    rows = (
        ('Run', run.run_id or Path(run.source).name), ('Readings', text.run_size(run)),
        ('Sequence', text.sequence_words(order_of(run, source))), ('Table axis', text.axis_words(run.rotation)),
        ('First and last reading', f'{source.begun} to {source.ended}' if days else ''),
        ('Duration', text.run_duration(text.seconds_of(run))), ('Pauses', text.pauses(run)),
        ('Temperature', f'{degrees[0]} °C to {degrees[1]} °C' if degrees else 'not measured'),
        ('Table angles', text.angle_words(run)),
        ('Repeatability', text.repeatability_words(run.repeatability, run.repeatability_dof)),
        ('Notes', '; '.join(notes_of(run))))
    return Measured(rows[0][1], tuple(row for row in rows if row[1]), days, known, run.simulated)


def lacking_in_u(made: Budget | None) -> str:
    """Return in words which of heat and scale U does not contain."""
    heat = made is not None and all(section in made.inputs for section in HEAT)
    return 'the scale of the CMM' if heat else 'thermal expansion and the scale of the CMM'


def release(version: str) -> str:
    """Return a version as a DCC wants a release: v and at most four groups of digits."""
    found = re.match(r'(\d{1,3}\.){0,3}\d{1,3}(?!\d)', version)
    return f'v{found[0]}' if found else 'v0'

# SPDX-License-Identifier: Apache-2.0
"""What the studio calculates in other processes besides the functions of `analysis`; nothing of the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rosette_ros.analysis import RunResult, curves_over, evaluate_jointly
from rosette_ros.api.documents import certificate_files, certificate_of
from rosette_ros.core.diagnosis.diagnosis import Diagnosis
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.model.least_squares import Fit
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.block_ways import with_block
from rosette_ros.core.planning.next_readings import next_readings
from rosette_ros.core.run.errors import InvalidData, RosetteError
from rosette_ros.core.run.records import ErrorMotions, Run
from rosette_ros.core.uncertainty.budget_inputs import BudgetInputs
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.io.log_reader import read_log
from rosette_ros.io.open_run import is_log
from rosette_ros.io.plan_file import MeasuringPlan, format_plan
from rosette_ros.io.text_file import bare_name
from rosette_ros.presentation.error_results import TITLE, errors
from rosette_ros.presentation.plots.plan_plots import way_to_the_cause
from rosette_ros.presentation.plots.touch_plots import touch_residuals
from rosette_ros.presentation.report import open_source
from rosette_ros.presentation.report.page_parts import inline_svgs
from rosette_ros.presentation.report.provenance import Source, digest
from rosette_ros.presentation.report.run_page import NO_TOUCHES, touches_of, way_of
from rosette_ros.presentation.table_format import Table
from rosette_ros.presentation.touch_results import sphere_rows, sphere_table
from rosette_ros.studio.stated import Stated
from rosette_ros.studio.studio_session import OpenedRun
from rosette_ros.words.settling_words import next_words


@dataclass(frozen=True)
class ShownTouches:
    """What the touches of a run show: (name, text) rows, pictures (SVG) by their words, tables; missing: why not."""

    rows: tuple[tuple[str, str], ...] = ()
    pictures: Mapping[str, str] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    missing: tuple[str, ...] = ()


def read_upload(path: Path) -> tuple[Run, Source]:
    """Return Run and Source of an uploaded file; both name the file as the person knows it."""
    try:
        run, source = open_source(path)
    except RosetteError as error:
        raise type(error)(str(error).replace(f'{path.parent}/', '')) from None
    files = tuple(replace(one, path=path.name) for one in source.files)
    return run.replace(source=path.name), replace(source, path=path.name, files=files)


def budget_with_touches(fit: Fit, source: Source | None, inputs: BudgetInputs | None,
                        found: Diagnosis | None) -> Budget:
    """Return the budget of the result, with the scatter of touches where the log of the run has them; found: in it."""
    return RunResult(fit, found, inputs, touches_of(source)[0]).budget_with()


@dataclass(frozen=True)
class MadeCertificate:
    """A certificate as XML and as pages (PDF), and what it states; name: of the file; missing: mandatory data in words.
    """

    xml: bytes
    pages: bytes
    name: str
    judgement: str
    level: str
    tables: tuple[Table, ...]
    contradictions: tuple[str, ...]
    missing: tuple[str, ...]


def certified(run: Run, source: Source | None, model: Model, stated: Stated) -> MadeCertificate:
    """Return the certificate of a run under a model with what is stated; raises InvalidData where its file or data
    lack."""
    if source is None or not all(Path(one.path).is_file() and digest(one.path) == one for one in source.files):
        raise InvalidData(f'{run.run_id or run.source}: expected the file of the run as it was opened, whose hash a '
                          'certificate states, found none such; a run that was uploaded is opened again by its path on '
                          'the computer of the studio')
    missing = list[str]()
    made = certificate_of([source.path], model, source.run_id, stated.identity, stated.budget or None,
                          ask=missing.extend)
    name = bare_name(source.path)
    xml, pages = certificate_files(made, f'{name}.xml', Path(stated.folder))
    return MadeCertificate(xml, pages, name, made.judgement, made.verdict.level if made.verdict else '', tuple(
        errors(one.lines, TITLE.format(one.words)) for one in made.sets), made.contradictions, tuple(missing))


def shown_touches(source: Source | None) -> ShownTouches:
    """Return what the touches in the log of a run show."""
    refit, missing = touches_of(source)
    if refit is None:
        return ShownTouches(missing=tuple(missing or [NO_TOUCHES]))
    drawn = inline_svgs({'touch_residuals': touch_residuals(refit)})
    return ShownTouches(tuple(sphere_rows(refit)), {
        'Distance of each touch from its sphere; below, the radius of each sphere.': str(drawn['touch_residuals'])},
        (sphere_table(refit),))


def shown_way(run: Run, model: Model, source: Source) -> str:
    """Return how a run that was measured until it is known came to its cause, a picture (SVG)."""
    return str(inline_svgs({'way': way_to_the_cause(way_of(run, model, source), source.until)})['way'])


def next_plan(run: Run, model: Model) -> tuple[str, str]:
    """Return what settles the doubts of a run, in words, and as a plan file after its readings, '' where nothing
    does."""
    found = next_readings(run, model)
    plan = MeasuringPlan(with_block(run, found.targets), run.radius) if found.targets else None
    return ' '.join(next_words(found)), format_plan(plan) if plan else ''


def curves_by_name(runs: Sequence[tuple[str, Run]], model: Model) -> dict[str, ErrorMotions]:
    """Return the curves of named runs under a model, along the axes of the first."""
    return {name: curves_over(runs[0][1], run, model) for name, run in runs}


def joint_of(opened: Sequence[OpenedRun]) -> JointResult:
    """Return the JointResult of opened runs, with their table frames where their logs are still there."""
    runs = []
    for one in opened:
        path = Path(one.source.path) if one.source else None
        is_there = path is not None and path.exists() and is_log(path)
        runs.append(Readings.of(one.run, read_log(path).frame_of(one.run.run_id) if path and is_there else None))
    return evaluate_jointly(runs)

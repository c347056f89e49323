# SPDX-License-Identifier: Apache-2.0
"""Documents of runs: the report, and the digital calibration certificate."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rosette_ros.analysis import curves_over, summarise
from rosette_ros.analysis import result as result_of_run
from rosette_ros.api.cells import cell_of
from rosette_ros.api.evaluating import joint_result
from rosette_ros.api.measurement import Doing, Measurement, model_of, read, several, stated_inputs
from rosette_ros.api.result import loaded, plots
from rosette_ros.core.diagnosis.verdict import VerdictText
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import Run
from rosette_ros.io.budget_file import read_stated, refuse_examples, source_of
from rosette_ros.io.column_map import ColumnMap, option_words
from rosette_ros.io.identity_file import Identity, folder_of, read_identity
from rosette_ros.io.open_run import joint_identity
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.io.text_file import refuse_output, write_bytes, write_text
from rosette_ros.io.touch_log import open_refitted
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.result_words import ConclusionText, conclusion_text
from rosette_ros.words.verdict_words import verdict_text

if TYPE_CHECKING:
    from rosette_ros.certificate.statements import Certificate
    from rosette_ros.presentation.report.verification import Verification

ModelLike = Model | str | Path | None
Stated = Mapping[str, Any] | str | Path | None
Step = Callable[[str], object]
REPORT = 'rosette_ros.presentation.report'


@dataclass(frozen=True, eq=False)
class ReportPage:
    """A report before it is written: HTML, the verdict in words, figures and tables by name; run: where it is one."""

    html: str
    verdict: VerdictText | ConclusionText
    pictures: Mapping[str, Any]
    tables: Sequence[Table]
    run: Run | None = None


def report(runs: Any, model: ModelLike = None, path: str | Path = 'report.html', *, inputs: Stated = None,
           environment: str | None = None, share: str | Path | None = None, identity: str | Path | None = None,
           overlay: Sequence[Any] = (), refit_spheres: bool = False, annex: bool = False, force: bool = False) -> Path:
    """Write the report of a run, or of several as one, as one HTML page, and return its path.

    overlay: other runs whose curves are drawn over those of the run; annex: with all values and further figures; the
    others as of `evaluate`. Raises InvalidData where the file exists, unless `force`."""
    refuse_output(path, force)
    every = several(runs)
    if len(every) > 1 or every[0].has_plate or share:
        if model is not None or refit_spheres or overlay:
            raise InvalidData('report: expected no model, refit_spheres and overlay with several runs as one')
        page = joint_page(every, inputs, environment, share, identity, annex)
    else:
        page = run_page(every[0], model, inputs, environment, identity, overlay, refit_spheres, annex)
    write_text(path, page.html, force)
    return Path(path)


def run_page(measured: Measurement, model: ModelLike = None, inputs: Stated = None, environment: str | None = None,
             identity: str | Path | None = None, overlay: Sequence[Any] = (), refit_spheres: bool = False,
             annex: bool = False, whole: bool = False, command: str = '', step: Step = lambda name: None) -> ReportPage:
    """Return the report of one run; whole: with all figures and tables beside the page; step: told what is done."""
    page, origins = (loaded(f'{REPORT}.{name}', 'report') for name in ('run_page', 'provenance'))
    series = plots('result_plots').Series
    run, known, stated = measured.run, model_of(model), stated_inputs(inputs, environment)
    source = origins.open_source(measured.path, measured.run_id, identity or measured.stated, measured.columns)[1] if (
        measured.path) else None
    if refit_spheres:
        run = open_refitted(measured.path, measured.run_id)[0]
    overlays, files = list[Any](), list[Any]()
    for one in map(read, overlay):
        overlays.append(series(one.run.run_id or one.path, curves_over(run, one.run, known)))
        files += origins.open_source(one.path, one.run_id, None, one.columns)[1].files if one.path else ()
    files += [origins.digest(one) for one in (model, identity, inputs) if isinstance(one, str | Path)]
    if source:
        source = replace(source, files=(*source.files, *files))
    has_all = annex or whole
    summary = replace(summarise(run, known, step, has_ladder=has_all), environment=stated.environment if stated else
                      None)
    step('draw')
    result = page.result_of(summary, page.touches_of(source)[0], stated)
    pictures = page.pictures_of(summary, overlays, result, has_all, source)
    html = page.report_html(summary, source, command, overlays, pictures, stated, annex)
    tables = page.every_table(summary, source.identity if source else Identity(), result)
    return ReportPage(html, verdict_text(summary.verdict), pictures, tables, run)


def joint_page(every: Sequence[Measurement], inputs: Stated = None, environment: str | None = None,
               share: str | Path | None = None, identity: str | Path | None = None, annex: bool = False,
               command: str = '', doing: Doing = lambda words: nullcontext()) -> ReportPage:
    """Return the report of several runs as one."""
    page, origins = (loaded(f'{REPORT}.{name}', 'report') for name in ('joint_page', 'provenance'))
    with doing('evaluating'):
        result = joint_result(every, inputs, environment, share)
    known, contradictions = joint_identity([(one.path, one.run_id) for one in every if one.path], identity)
    files = [file for one in every if one.path for file in page.files_of(one.path, one.readings)]
    files += [origins.digest(one) for one in (share, identity, inputs) if isinstance(one, str | Path)]
    with doing('diagnosing'):
        cell = cell_of(every)
    pictures = page.joint_pictures(result, cell)
    html = page.joint_html(result, files, command, pictures, known, contradictions, annex, cell)
    return ReportPage(html, conclusion_text(conclude(result)), pictures, page.joint_tables(result, known, cell))


def verification_page(paths: Sequence[str | Path], maker: str | Path | None = None, model: ModelLike = None,
                      annex: bool = False, whole: bool = False, command: str = '',
                      doing: Doing = lambda words: nullcontext(), columns: ColumnMap | None = None) -> ReportPage:
    """Return the report on runs that must agree as in the paper; maker: table of the maker's corrections (CSV);
    columns: of tables of another program."""
    page = loaded(f'{REPORT}.verification', 'report')
    verified = verification_of(paths, maker, model, doing, columns)
    pictures = page.verification_pictures(verified, annex or whole)
    html = page.verification_html(verified, command, pictures, annex)
    return ReportPage(html, verified.verdict, pictures, page.verification_tables(verified))


def verification_of(paths: Sequence[str | Path], maker: str | Path | None = None, model: ModelLike = None,
                    doing: Doing = lambda words: nullcontext(), columns: ColumnMap | None = None) -> 'Verification':
    """Return the Verification of the results of runs by their paths; maker, columns: as of `verification_page`."""
    page, origins = (loaded(f'{REPORT}.{name}', 'report') for name in ('verification', 'provenance'))
    opened, known = [origins.open_source(path, columns_of=columns) for path in paths], model_of(model)
    table = page.read_maker(maker) if maker else None
    with doing('evaluating'):
        made: Verification = page.verify([(result_of_run(run, known), source) for run, source in opened], table)
    return made


def certify(runs: Any, path: str | Path, model: ModelLike = None, *, identity: str | Path | None = None,
            inputs: str | Path | None = None, environment: str | None = None, share: str | Path | None = None,
            pdf: str | Path | None = None, force: bool = False) -> Path:
    """Write a digital calibration certificate (DCC, XML) of a run or of several as one, and return its path.

    identity: a file (config/identity.yaml) that states who, what and where; pdf: pages for people, too. Raises
    InvalidData where a run was not read from a file, data lack, or a file exists, unless `force`."""
    every = several(runs)
    for one in every:
        if not one.path:
            raise InvalidData(f'{one.name}: expected a run of a file, whose hash a certificate states; write it first '
                              '(run.write) and read it')
        if one.columns != every[0].columns:
            raise InvalidData(f'{one.name}: expected the runs of one certificate with the same {option_words()}, found '
                              'others; write them as tables of ours (run.write) and read these')
    for target in (path, *([pdf] if pdf else [])):
        refuse_output(target, force)
    made = certificate_of([one.path for one in every], model, every[0].run_id, identity, inputs, environment, share,
                          len(every) > 1 or every[0].has_plate, columns=every[0].columns)
    write_certificate(made, path, pdf, identity, force)
    return Path(path)


def certificate_of(paths: Sequence[str | Path], model: ModelLike = None, run_id: str | None = None,
                   identity: Identity | str | Path | None = None, inputs: Stated = None,
                   environment: str | None = None, share: str | Path | None = None, is_joint: bool = False,
                   ask: Callable[[tuple[str, ...]], object] = lambda missing: None,
                   doing: Doing = lambda words: nullcontext(), columns: ColumnMap | None = None) -> 'Certificate':
    """Return what a certificate of runs states; identity, inputs: a file or what it says; ask: told the mandatory
    data that nobody stated; columns: of tables of another program."""
    statements = loaded('rosette_ros.certificate.statements', 'certificate')
    known = identity if isinstance(identity, Identity) else read_identity(identity) if identity else Identity()
    stated = statements.Inputs(
        known, known['certificate.date'] or date.today().isoformat(),
        None if model is None else model_of(model).to_mapping(), run_id, is_joint,
        read_sharing(share, len(paths)) if is_joint else {}, read_stated(inputs, environment), columns=columns)
    refuse_examples(stated.budget, source_of(inputs))
    with doing('evaluating'):
        made: Certificate = statements.state(paths, stated, ask)
    return made


def certificate_files(made: 'Certificate', name: str, folder: Path, pages: bool = True) -> tuple[bytes, bytes]:
    """Return a certificate as XML and, where they are asked for, as pages for people (PDF).

    name: of the XML, which is attached to the pages; folder: of the pictures that the identity names."""
    data = loaded('rosette_ros.certificate.dcc', 'certificate').to_xml(made)
    return data, loaded('rosette_ros.certificate.pages', '--pdf').to_pdf(made, data, name, folder) if pages else b''


def write_certificate(made: 'Certificate', path: str | Path, pdf: str | Path | None = None,
                      identity: str | Path | None = None, force: bool = False) -> None:
    """Write a certificate as XML and, where a name is given, as pages for people; both or, where one fails, none.

    identity: the file that it was made with, beside which its pictures lie."""
    data, pages = certificate_files(made, Path(path).name, folder_of(identity), bool(pdf))
    write_bytes(path, data, force)
    if pdf:
        write_bytes(pdf, pages, force)

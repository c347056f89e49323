# SPDX-License-Identifier: Apache-2.0
"""The page of several runs that were evaluated as one."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rosette_ros.core.joint.cell_diagnosis import CellDiagnosis
from rosette_ros.core.joint.conclusion import conclude
from rosette_ros.core.joint.joint_evaluation import JointResult
from rosette_ros.core.joint.readings import Readings
from rosette_ros.core.run.records import CURVES
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.io.column_map import ColumnMap
from rosette_ros.io.identity_file import Identity
from rosette_ros.io.log_reader import find_files
from rosette_ros.io.open_run import has_plate, is_log, open_readings
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation import joint_results as results
from rosette_ros.presentation.cell_results import (
    causes_in_runs,
    causes_of_runs,
    cell_causes,
    cell_runs,
    every_cause,
)
from rosette_ros.presentation.identity_words import NOTHING, identity_rows, signer, simulated_words
from rosette_ros.presentation.plots.cell_plots import causes_against_runs
from rosette_ros.presentation.plots.result_plots import Extra, Series, six_curves
from rosette_ros.presentation.report.page_parts import PAGES, inline_svgs
from rosette_ros.presentation.report.provenance import FileDigest, digest, software
from rosette_ros.presentation.table_format import Table
from rosette_ros.words.cell_words import cell_words
from rosette_ros.words.joint_words import note_words, part_words
from rosette_ros.words.reading_words import readings_notes
from rosette_ros.words.result_words import conclusion_text

CLOCKWISE_LESS = 'counter-clockwise less clockwise'


def open_with_files(path: Path | str, run_id: str | None = None,
                    columns_of: ColumnMap | None = None) -> tuple[Readings, tuple[FileDigest, ...]]:
    """Return the Readings of a log or table and the files they come from, and raise InvalidData, as `open_readings`."""
    run = open_readings(path, run_id, columns_of)
    return run, files_of(path, run)


def files_of(path: Path | str, run: Readings) -> tuple[FileDigest, ...]:
    """Return the files from which the Readings of a log or table come."""
    files = find_files(path).files if is_log(path) else (path, *([run.plate.source] if has_plate(path) else []))
    return tuple(map(digest, files))


def joint_html(result: JointResult, files: Sequence[FileDigest] = (), command: str = '',
               pictures: Mapping[str, Figure] | None = None, identity: Identity | None = None,
               contradictions: Sequence[str] = (), annexed: bool = False, cell: CellDiagnosis | None = None) -> str:
    """Return the report of a JointResult as one HTML text; pictures: where they are drawn already; annexed: as of
    `report_html`; cell: what the runs say of their cell, None where they are not of one."""
    identity = identity or Identity()
    pictures = pictures or joint_pictures(result, cell)
    runs = result.solution.model.runs
    simulated = [run.name for run in runs if run.simulated]
    return PAGES.get_template('joint.html.j2').render(
        result=result, iso=text.iso_range(runs[0].rotation), verdict=conclusion_text(conclude(result)),
        rows=dict(results.joint_rows(result)), runs=list(map(results.joint_head, runs)),
        known=part_words(result.knowledge.known), nothing=results.nothing_known(result),
        hidden=part_words(result.knowledge.hidden),
        files=tuple(dict.fromkeys(files)),
        notes=[*map(note_words, result.notes),
               *(f'{run.name}: {note}' for run in runs for note in readings_notes(run))],
        command=command,
        pictures=inline_svgs(pictures), tables={table.name: table for table in joint_tables(result, identity, cell)},
        cell=cell_words(cell) if cell else (),
        identity=identity_rows(identity, contradictions), signer=signer(identity), not_stated=NOTHING,
        values=[table.name for table in results.joint_curves(result)], k=COVERAGE_FACTOR, software=software(),
        numbers={name: place for place, name in enumerate(pictures, 1)},
        simulated=simulated_words(simulated, len(runs)),
        annexed=annexed, running=f'{len(runs)} runs as one, the first {runs[0].name}{" (SIMULATED)" * bool(simulated)}')


def joint_pictures(result: JointResult, cell: CellDiagnosis | None = None) -> dict[str, Figure]:
    """Return the figures of a joint evaluation by name: curves of every table and sense, reversals with means, causes
    against runs."""
    out = {'curves': six_curves([Series(one.words, motions) for one, motions in result.curves])}
    for place, one in enumerate(result.reversals):
        means = [Extra(curve, 'mean over the table angles', np.full(one.motions.angle.size, mean))
                 for curve, mean, known in zip(CURVES, one.mean, one.is_known, strict=True) if known]
        out[f'reversal{place + 1}' if place else 'reversal'] = six_curves(
            [Series(CLOCKWISE_LESS, one.motions)], f'Table {one.table}' if len(result.reversals) > 1 else '',
            extras=means)
    if cell and (found := causes_of_runs(cell)).causes:
        out['causes'] = causes_against_runs(found)
    return out


def joint_tables(result: JointResult, identity: Identity, cell: CellDiagnosis | None = None) -> tuple[Table, ...]:
    """Return the tables of a joint evaluation: errors, what is shared, means of reversals, curves, deviations, causes
    of the cell."""
    tolerances = identity.limits(result.solution.model.runs[0].rotation)
    causes = (cell_causes(cell), causes_in_runs(cell), cell_runs(cell)) if cell and every_cause(cell) else ()
    return (*results.joint_errors(result, tolerances), results.sharing_table(result),
            *results.joint_effects(result), *results.reversal_means(result), *results.joint_curves(result),
            *results.joint_deviations(result), *causes)

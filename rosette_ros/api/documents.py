# SPDX-License-Identifier: Apache-2.0
"""Documents of a run: the report, and the digital calibration certificate."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

from rosette_ros.analysis import summarise
from rosette_ros.api.measurement import model_of, read, several, stated_inputs
from rosette_ros.api.result import loaded
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.budget_file import read_stated, refuse_examples
from rosette_ros.io.identity_file import Identity, folder_of, read_identity
from rosette_ros.io.sharing_file import read_sharing
from rosette_ros.io.text_file import refuse_output, write_bytes, write_text

ModelLike = Model | str | Path | None
Stated = Mapping[str, Any] | str | Path | None


def report(run: Any, model: ModelLike = None, path: str | Path = 'report.html', *, inputs: Stated = None,
           environment: str | None = None, annex: bool = False, force: bool = False) -> Path:
    """Write the report of a run as one HTML page, and return its path; annex: with all values and further figures.

    inputs, environment: as of `evaluate`. Raises InvalidData where the file exists, unless `force`."""
    measured, page = read(run), loaded('rosette_ros.presentation.report', 'report')
    refuse_output(path, force)
    stated = stated_inputs(inputs, environment)
    source = None
    if measured.path:
        source = page.open_source(measured.path, measured.run_id)[1]
    summary = summarise(measured.run, model_of(model), has_ladder=annex)
    summary = replace(summary, environment=stated.environment if stated else None)
    write_text(path, page.report_html(summary, source, inputs=stated, annexed=annex), force)
    return Path(path)


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
    for target in (path, *([pdf] if pdf else [])):
        refuse_output(target, force)
    statements, dcc = (loaded(f'rosette_ros.certificate.{name}', 'certificate')
                       for name in ('statements', 'dcc'))
    known, is_joint = read_identity(identity) if identity else Identity(), len(every) > 1 or every[0].has_plate
    asked = statements.Inputs(
        known, known['certificate.date'] or date.today().isoformat(),
        None if model is None else model_of(model).to_mapping(), every[0].run_id, is_joint,
        read_sharing(share, len(every)) if is_joint else {}, read_stated(inputs, environment))
    refuse_examples(asked.budget, str(inputs))
    made = statements.state([one.path for one in every], asked)
    data = dcc.to_xml(made)
    pages = (loaded('rosette_ros.certificate.pages', 'certificate').to_pdf(
        made, data, Path(path).name, folder_of(identity)) if pdf else b'')
    write_bytes(path, data, force)
    if pdf:
        write_bytes(pdf, pages, force)
    return Path(path)

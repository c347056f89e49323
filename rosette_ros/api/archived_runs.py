# SPDX-License-Identifier: Apache-2.0
"""Runs of an archive that a question asks for."""

from pathlib import Path
from typing import TYPE_CHECKING

from rosette_ros.api.measurement import Measurement, read
from rosette_ros.api.result import loaded
from rosette_ros.archive.run_question import Question

if TYPE_CHECKING:
    from rosette_ros.archive.run_archive import RunArchive


def archived_runs(archive: 'str | Path | RunArchive', *, table: str = '', plate: str = '', cmm: str = '',
                  cell: str = '', place: str = '', level: str = '', since: str = '', until: str = '', effect: str = ''
                  ) -> list[Measurement]:
    """Return the runs of an archive, or of its folder, that are asked for, the earliest first, all where nothing is.

    table, plate, cmm: serial numbers; cell, place, level: as `rosette archive query` takes them; since, until: measured
    then or later, and before, such as '2026-04-12'; effect: in the model, or named by the diagnosis. The logs are read
    where they were found. Raises InvalidData where no run is asked for, or a log is there no more."""
    equal = {'table': table, 'plate': plate, 'cmm': cmm, 'cell': cell, 'place': place, 'level': level}
    question = Question({word: value for word, value in equal.items() if value}, since, until, effect)
    return [read(path, run_id=run_id or None) for path, run_id in places_asked_for(archive, question)]


def places_asked_for(archive: 'str | Path | RunArchive', question: Question) -> list[tuple[str, str]]:
    """Return path and run_id of each run of an archive that a question asks for; raises as `archived_runs`."""
    opened = loaded('rosette_ros.archive.run_archive', 'archive').RunArchive(archive) if isinstance(
        archive, str | Path) else archive
    found: list[tuple[str, str]] = loaded('rosette_ros.archive.archive_questions', 'archive').runs_asked_for(
        opened, question)
    return found

# SPDX-License-Identifier: Apache-2.0
"""What several runs say of their cell: tables, causes against runs, JSON."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rosette_ros.core.joint.cell_diagnosis import CauseInRun, CellCause, CellDiagnosis
from rosette_ros.core.run.number_words import micrometres
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.presentation.json_output import Json, plain
from rosette_ros.presentation.table_format import Table, column, words
from rosette_ros.words.cell_words import constants_words, law_words, moves_words, runs_words
from rosette_ros.words.motion_words import chance

CELL = 'rosette-cell-diagnosis/1'
KINDS = ('property', 'once', 'possible')
"""Of a cause: comes again, was there in single runs, may be a property."""


LEAST_SHOWN = 0.02
"""Probability from which on a cause has a dot in a run."""


@dataclass(frozen=True)
class CauseDot:
    """A cause in a run, by their places: its probability; size and standard uncertainty, m rms, None and NaN where it
    has none there."""

    cause: int
    run: int
    probability: float
    size: float | None = None
    u: float = math.nan


@dataclass(frozen=True)
class CausesOfRuns:
    """Causes against runs: causes in words, names of the runs, dots."""

    causes: tuple[str, ...]
    runs: tuple[str, ...]
    dots: tuple[CauseDot, ...]


def causes_of_runs(found: CellDiagnosis) -> CausesOfRuns:
    """Return the causes of a cell against its runs, with what all runs say together."""
    causes = [one for _, one in every_cause(found)]
    return CausesOfRuns(tuple(law_words(one.name) for one in causes), found.runs, tuple(
        CauseDot(place, run, each.p, None if math.isnan(each.size) else each.size, each.u)
        for place, one in enumerate(causes) for run, each in enumerate(one.in_runs)
        if each.judged and each.p >= LEAST_SHOWN))


def every_cause(found: CellDiagnosis) -> list[tuple[str, CellCause]]:
    """Return all causes that are told, each with its kind."""
    return [(kind, one) for kind, some in zip(KINDS, (found.properties, found.once, found.doubtful)) for one in some]


def cell_causes(found: CellDiagnosis) -> Table:
    """Return the causes of a cell, those first that come again."""
    every = every_cause(found)
    causes = [one for _, one in every]
    return Table('cell', 'Causes of the cell', (
        words('kind', 'kind', [kind for kind, _ in every]),
        column('probability', 'comes again', [one.again for one in causes], chance),
        words('moves', 'moving body, correlated with', map(moves_words, causes)),
        words('law', 'likeliest law', [law_words(one.name) for one in causes]),
        column('expected_runs', 'in runs', [one.expected for one in causes], runs_words),
        column('judged_runs', 'of', [one.judged for one in causes], str),
        column('rate', 'next run', [one.rate for one in causes], chance),
        words('constants', 'constants', [constants_words(one.constants) for one in causes])),
        levels=tuple('strong' if kind == KINDS[0] else '' for kind, _ in every)) if every else Table('cell', '', ())


def causes_in_runs(found: CellDiagnosis) -> Table:
    """Return each cause in each run, a row for each run: probability, by that run alone, size with U."""
    causes = _in_runs(found)
    return Table('causes_in_runs', 'The causes in each run', (
        words('run', 'run', found.runs),
        *(words(f'cause{place}', law_words(one.name), map(_in_run, one.in_runs)) for place, one in enumerate(causes, 1))
        ), note='Probability with what the other runs say (by this run alone); rms displacement over all coordinates '
        f'with U (k = {COVERAGE_FACTOR}); –: this run says nothing of it')


def cell_runs(found: CellDiagnosis) -> Table:
    """Return each cause in each run as numbers, a row for each cause and run, for files: where a run says nothing of a
    cause, only which they are."""
    every = [(run, cause.name, one) for cause in _in_runs(found) for run, one in zip(found.runs, cause.in_runs)]
    return Table('cell_runs', 'The causes in each run', (
        column('run', '', [run for run, _, _ in every]), column('effect', '', [name for _, name, _ in every]),
        column('probability', '', [one.p if one.judged else math.nan for _, _, one in every]),
        column('alone', '', [one.alone if one.judged else math.nan for _, _, one in every]),
        column('size_um', '', [1e6 * one.size for _, _, one in every], unit='µm'),
        column('u_um', '', [1e6 * one.u for _, _, one in every], unit='µm')))


def _in_runs(found: CellDiagnosis) -> list[CellCause]:
    """Return the causes that are told of each run."""
    return [one for kind, one in every_cause(found) if kind != KINDS[2]]


def _in_run(one: CauseInRun) -> str:
    if not one.judged:
        return '–'
    size = '' if math.isnan(one.size) else (f', {micrometres(one.size)} ± '
                                            f'{micrometres(COVERAGE_FACTOR * one.u)}')
    return f'{chance(one.p)} ({chance(one.alone)}){size}'


def cell_json(found: CellDiagnosis, sentences: Sequence[str], orders: Iterable[tuple[str, Sequence[str]]] = ()) -> Json:
    """Return what is said of a cell as JSON; orders: with what each would show of what is hidden."""
    return plain({
        'schema': CELL, 'level': found.level, 'sentences': list(sentences), 'runs': list(found.runs),
        'causes': [{'kind': kind, **_cause_json(found, one)} for kind, one in every_cause(found)],
        'explanations': [{'properties': one.names, 'probability': p} for p, one in found.rates.hypotheses if p > 1e-3],
        'hidden': list(found.hidden), 'orders': [{'order': order, 'shows': list(names)} for order, names in orders]})


def _cause_json(found: CellDiagnosis, one: CellCause) -> Json:
    return {
        'motions': one.bodies, 'variables': one.variables, 'property': one.again,
        'laws': [{'effect': name, 'property': p} for name, p in one.laws],
        'expected_runs': one.expected, 'judged_runs': one.judged, 'rate': one.rate, 'size_m': one.size,
        'size_spread': one.spread,
        'constants': [{'name': each.name, 'value': each.value, 'U': COVERAGE_FACTOR * each.u, 'unit': each.unit}
                      for each in one.constants],
        'changes': [{'condition': each.condition, 'slope_m': each.slope, 'U_m': COVERAGE_FACTOR * each.u, 'p': each.p}
                    for each in one.changes],
        'runs': [{'run': name, 'probability': each.p, 'alone': each.alone, 'size_m': each.size,
                  'U_m': COVERAGE_FACTOR * each.u, 'judged': each.judged}
                 for name, each in zip(found.runs, one.in_runs)]}

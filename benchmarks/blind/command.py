# SPDX-License-Identifier: Apache-2.0
"""Options, processes, JSON, comparison and page of the blind tests."""

import argparse
import json
import multiprocessing
import os
import sys
import time
import traceback
from pathlib import Path

from benchmarks.blind.answers import Record
from benchmarks.blind.cells import CELLS, cell_record, cell_table
from benchmarks.blind.regret import regret
from benchmarks.blind.table import table
from benchmarks.blind.trial import CAUSES, SETS, NotShown, Trial, trials
from rosette_ros.core.diagnosis.diagnosis import diagnose

OF_CELLS = 'cells'
BEGIN, END = '<!-- table of the blind tests -->', '<!-- end of the table -->'
"""What stands before and after the table in a page."""


def options(argv: list[str] | None) -> argparse.Namespace:
    """Return the options of the command."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.blind', description='Blind tests of the diagnosis.')
    parser.add_argument('--sets', nargs='+', choices=(*SETS, OF_CELLS), default=list(SETS), metavar='SET',
                        help=f'some of {", ".join(SETS)} (default: all), or {OF_CELLS} alone')
    parser.add_argument('--cells', type=int, default=CELLS, help=f'how many cells of {OF_CELLS} (default {CELLS})')
    parser.add_argument('--seeds', type=int, help='runs of each group (default: as each set has them)')
    parser.add_argument('--first-seed', type=int, default=1)
    parser.add_argument('-n', '--balls', dest='n', type=int, default=12)
    parser.add_argument('--causes', default=CAUSES, metavar='FILE', help='file of the causes of open and crossed')
    parser.add_argument('--share', default='1/1', metavar='K/M', help='every Mth run from the Kth on')
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path, metavar='FILE', help='write every run and what was said of it')
    parser.add_argument('--compare', type=Path, metavar='OLD.json', help='compare with what an earlier run wrote')
    parser.add_argument('--page', type=Path, metavar='FILE', help=f'write the table into a page, after {BEGIN}')
    arguments = parser.parse_args(argv)
    part, _, parts = arguments.share.partition('/')
    if not (part.isdigit() and parts.isdigit() and 1 <= int(part) <= int(parts)):
        parser.error(f'--share: expected K/M with 1 ≤ K ≤ M, found {arguments.share}')
    if OF_CELLS in arguments.sets and len(arguments.sets) > 1:
        parser.error(f'--sets: expected {OF_CELLS} alone, as its figures are others, found {" ".join(arguments.sets)}')
    arguments.part, arguments.parts = int(part), int(parts)
    return arguments


def work(trial: Trial) -> Record:
    """Return the record of one run; one that fails is told, one that shows nothing skipped."""
    try:
        run, truth = trial.run()
        began = time.perf_counter()
        found = diagnose(run, without=trial.left_out)
        seconds = time.perf_counter() - began
        return {**trial.judge(found, truth), 'regret': regret(run, truth.hidden), 'seconds': seconds}
    except NotShown as why:
        return {'trial': trial.name, 'skipped': str(why)}
    except Exception:
        return {'trial': trial.name, 'failed': traceback.format_exc()}


def main(argv: list[str] | None = None) -> int:
    """Diagnose the runs and print the table; return 1 where a run failed."""
    arguments = options(argv)
    if arguments.sets == [OF_CELLS]:
        return of_cells(arguments)
    old = json.loads(arguments.compare.read_text()) if arguments.compare else None
    todo = trials(arguments.sets, arguments.seeds, arguments.first_seed, arguments.causes,
                  arguments.n)[arguments.part - 1::arguments.parts]
    began = time.perf_counter()
    if arguments.jobs > 1:
        with multiprocessing.get_context('spawn').Pool(arguments.jobs) as pool:
            records = list(pool.imap(work, todo, chunksize=2))
    else:
        records = [work(trial) for trial in todo]
    failed = [record for record in records if 'failed' in record]
    skipped = sum('skipped' in record for record in records)
    records = [record for record in records if 'seconds' in record]
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=0, ensure_ascii=False))
    seconds = [record['seconds'] for record in records]
    mean = sum(seconds) / max(len(seconds), 1)
    text = (f'{len(records)} runs of {arguments.n} balls; a diagnosis took {mean:.2f} s, at most '
            f'{max(seconds, default=0):.2f} s.{f" {skipped} more would not show what they hide." if skipped else ""}'
            f'\n\n{table(records, old)}')
    print(text)
    print(f'\n{time.perf_counter() - began:.0f} s in {arguments.jobs} processes', file=sys.stderr)
    if arguments.page:
        write_page(arguments.page, text)
    for record in failed:
        print(f'failed: {record["trial"]}\n{record["failed"]}', file=sys.stderr)
    return int(bool(failed))


def of_cells(arguments: argparse.Namespace) -> int:
    """Diagnose cells and print their figures."""
    todo = [(cell, arguments.n) for cell in range(arguments.cells)][arguments.part - 1::arguments.parts]
    if arguments.jobs > 1:
        with multiprocessing.get_context('spawn').Pool(arguments.jobs) as pool:
            records = pool.starmap(cell_record, todo, chunksize=1)
    else:
        records = [cell_record(*one) for one in todo]
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=0, ensure_ascii=False))
    print(cell_table(records))
    return 0


def write_page(page: Path, text: str) -> None:
    """Write a table between the two marks of a page; raises ValueError where they are not there."""
    before, begin, rest = page.read_text().partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f'{page}: expected the lines {BEGIN} and {END}, between which the table is written')
    page.write_text(f'{before}{begin}\n{text}\n{end}{after}')

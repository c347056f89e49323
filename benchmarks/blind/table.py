# SPDX-License-Identifier: Apache-2.0
"""The table of the blind tests, of the records of their runs and, beside it, of the same runs before a change."""

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np
import scipy  # which loads its parts where they are used

from benchmarks.blind.answers import Record
from benchmarks.blind.noise_kinds import KINDS
from benchmarks.blind.runs import CROSSED
from benchmarks.blind.trial import OPEN_STRENGTHS, STRENGTHS
from rosette_ros.core.sight.limits import SURE

BINS = (0.5, 0.7, 0.9, 0.97, 1.0)
"""Edges of the stated probabilities."""
KNOWN = ('fair name', 'right variable')
REGRET = 0.1
"""By so much the log evidence of the truth may exceed that of the best hypothesis visited."""
Records = Sequence[Record]
Count = tuple[int, int]
"""How many of how many."""


def table(new: Records, old: Records | None = None) -> str:
    """Return the whole table in Markdown; old: records of an earlier version, of which those of the same runs count."""
    said = ''
    if old is not None:
        both = {record['trial'] for record in old} & {record['trial'] for record in new}
        new, old = ([record for record in side if record['trial'] in both] for side in (new, old))
        said = f'{len(both)} runs that both versions diagnosed.'
    parts = (said, *(part(new, old or ()) for part in (_results, _levels, _noise, _calibration)))
    return '\n\n'.join(filter(None, parts))


def interval(count: int, runs: int) -> str:
    """Return the exact (Clopper-Pearson) 95 % interval of a probability of which `count` of `runs` were seen."""
    if not runs:
        return ''
    found = scipy.stats.binomtest(count, runs).proportion_ci(0.95, 'exact')
    return f'{100 * found.low:.1f}–{100 * found.high:.1f} %'


def _cells(counts: Sequence[Count]) -> str:
    """Return count, share and interval in two cells for each version, new and old."""
    return ' | '.join(f'{count} of {runs} ({100 * count / runs:.1f} %) | {interval(count, runs)}' if runs else ' | '
                      for count, runs in counts)


def _markdown(head: Sequence[str], rows: Sequence[str]) -> str:
    """Return a table, '' without rows."""
    return '\n'.join((f'| {" | ".join(head)} |', '|---' * len(head) + '|', *rows)) if rows else ''


def _versions(old: Records, *heads: str) -> list[str]:
    """Return the heads of the columns, again for the old version where there is one."""
    return [*heads, *(f'{head}, before' for head in heads if old)]


def _results(new: Records, old: Records) -> str:
    """Return what was found in each set."""
    rows = []

    def row(what: str, wanted: str, classes: Sequence[str], name: str, strength: float | None = None) -> None:
        chosen = [[record['judged'] in classes for record in side if record['set'] == name
                   and (strength is None or record['strength'] == strength)] for side in (new, old)[:1 + bool(old)]]
        if chosen[0]:
            rows.append(f'| {what} | {wanted} | {_cells([(sum(side), len(side)) for side in chosen])} |')

    row('white noise: false names', 'at most 1 %', ('wrong name',), 'white')
    row('real noise: false names', 'at most 2 % of each kind', ('wrong name',), 'noise')
    for name, what, wanted in (('library', 'one effect', 'at least 97 % at 12 σ'), ('outliers', 'one outlier', '')):
        for strength in STRENGTHS:
            row(f'{what} of {strength:g} σ: right', wanted, ('right',), name, strength)
    row('two effects of 12 σ each: right', '', ('right',), 'pairs')
    row('three effects that share 12 σ: right', '', ('right',), 'three')
    for name, where, limits in (('open', 'open world', ('at most 5 %', 'at least 65 %')),
                                ('crossed', 'open world in each order', ('', '')),
                                ('left_out', 'an effect left out of the library', ('', ''))):
        for what, wanted, classes in zip(('wrong names', 'known'), limits, (('wrong name',), KNOWN)):
            for strength in OPEN_STRENGTHS:
                row(f'{where}, {strength:g} σ: {what}', '', classes, name, strength)
            row(f'{where}, all: {what}', wanted, classes, name)
    return _markdown(['runs', 'expected', *_versions(old, 'new', '95 %')], rows)


def _levels(new: Records, old: Records) -> str:
    """Return by set and order how often level 1 that is found is true, a certain law wrong, and the regret."""
    rows = []
    for name in ('library', 'open', 'crossed', 'left_out'):
        for order in (*CROSSED, 'all'):
            sides = [[one for one in side if one['set'] == name and order in (one['order'], 'all')]
                     for side in (new, old)[:1 + bool(old)]]
            if any(one.get(key) is not None for side in sides for one in side for key in ('levels', 'regret')):
                rows.append(f'| {name} | {order} | {" | ".join(map(_level_cells, sides))} |')
    heads = [what for one in ('level 1 true', 'complete', 'certain law wrong', 'known', f'regret above {REGRET:g}')
             for what in (one, '95 %')]
    return _markdown(['set', 'order', *heads, 'sum of regret', *(f'{one}, before' for one in (*heads, 'sum of regret')
                                                                 if old)], rows)


def _level_cells(records: Records) -> str:
    """Return counts of the runs of a set in an order; regret that is not known or negative does not count."""
    levels = [record['levels'] for record in records if record.get('levels') is not None]
    regret = [record['regret'] for record in records if record.get('regret') is not None]
    found = [one for some in levels for one in some if one['probability'] >= SURE]
    counts = [(sum(one['true'] for one in found), len(found)), (sum(one['complete'] for one in found), len(found)),
              (sum(any(one['law_certain'] and one['law_true'] is False for one in some) for some in levels),
               len(levels)),
              (sum(record['judged'] in ('right', *KNOWN) for record in records), len(records)),
              (sum(one > REGRET for one in regret), len(regret))]
    return f'{_cells(counts)} | {f"{sum(max(one, 0) for one in regret):.1f}" if regret else ""}'


def _noise(new: Records, old: Records) -> str:
    """Return false names and coverage by kind of noise."""
    sides = (new, old)[:1 + bool(old)]

    def row(what: str, kinds: Collection[str]) -> str:
        clean = [[one for one in side if one['set'] in ('white', 'noise') and one['noise'] in kinds] for side in sides]
        effect = [[one for one in side if one['set'] == 'coverage' and one['noise'] in kinds] for side in sides]
        names = [(sum(one['judged'] == 'wrong name' for one in side), len(side)) for side in clean]
        cells = ' | '.join(f'{_cells([count])} | {covered(one)} | {covered(other)}'
                           for count, one, other in zip(names, clean, effect))
        return f'| {what} | {cells} |' if any((*clean, *effect)) else ''

    rows = [*(row(kind, (kind,)) for kind in KINDS), row('all', KINDS)]
    heads = _versions(old, 'false names', '95 %', 'within U, clean', 'within U, effect of 12 σ')
    return _markdown(['noise', *heads], [*filter(None, rows)])


def covered(records: Records) -> str:
    """Return the share of the points of the curves within U, and twice its standard error from run to run."""
    shares = [100 * float(np.mean(record['covered'])) for record in records]
    if len(shares) < 2:
        return ''
    return f'{np.mean(shares):.1f} ± {2 * np.std(shares, ddof=1) / np.sqrt(len(shares)):.1f} %'


def _calibration(new: Records, old: Records) -> str:
    """Return how often claims and levels 1 of a stated probability are true."""
    rows = []
    for what, sets, key in (
            ('all sets', (), 'claims'), ('open world', ('open',), 'claims'), ('level 1, all sets', (), 'levels'),
            ('level 1, open world', ('open', 'crossed'), 'levels'), ('level 1, left out', ('left_out',), 'levels')):
        sides = [[claim for record in side if not sets or record['set'] in sets for claim in record.get(key) or ()
                  if claim['probability'] is not None] for side in (new, old)[:1 + bool(old)]]
        for low, high in pairwise(BINS):
            inside = [[one for one in side if low <= one['probability'] < high or high == one['probability'] == 1]
                      for side in sides]
            if any(inside):
                true = [(sum(one['true'] for one in side), len(side)) for side in inside]
                cells = [f'{_mean(side)} | {_cells([count])}' for side, count in zip(inside, true)]
                rows.append(f'| {what} | {low:g}–{high:g} | {" | ".join(cells)} |')
    return _markdown(['claims', 'probability', *_versions(old, 'mean stated', 'true', '95 %')], rows)


def _mean(claims: Records) -> str:
    return f'{np.mean([one["probability"] for one in claims]):.3f}' if claims else ''
